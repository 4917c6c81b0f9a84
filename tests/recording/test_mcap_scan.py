"""Records among the bytes of an MCAP file."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from elastic_arm.recording.spans import column, progression
from elastic_arm.recording.storage.mcap_blocks import McapBlock, repeated
from elastic_arm.recording.storage.mcap_scan import scan

RECORDS = st.lists(st.tuples(st.sampled_from([3, 4, 5, 5, 5, 5]), st.integers(1, 3), st.integers(0, 40)), max_size=300)


@given(RECORDS, st.integers(1, 30), st.integers(0, 60))
def test_every_record_is_found_once(kinds: list[tuple[int, int, int]], repeats: int, torn: int) -> None:
    """Any run of records, however often it repeats and wherever it is torn, is found whole, in order, and no more."""
    content, begins, others = b"", [], []
    for opcode, channel, extra in kinds * repeats:
        if opcode == 5:
            begins.append(len(content))
            body = channel.to_bytes(2, "little") + bytes(20 + extra)
        else:
            others.append((opcode, len(content) + 9))
            body = bytes(extra)
        content += bytes([opcode]) + len(body).to_bytes(8, "little") + body
    end = max(len(content) - torn, 0)
    ends = {begin: begin + 9 + int.from_bytes(content[begin + 1 : begin + 9], "little") for begin in begins}
    whole = [begin for begin in begins if ends[begin] <= end]
    found = scan(np.frombuffer(content, np.uint8), 0, end)
    assert found.messages.tolist() == whole
    assert [(r.opcode, r.begin) for r in found.others] == [o for o in others if o[1] <= found.end and o[1] <= end]


@given(st.lists(st.integers(0, 50), min_size=1, max_size=20))
def test_progressions_are_told_from_other_offsets(offsets: list[int]) -> None:
    """A slice stands for offsets only if it gives exactly them."""
    given_offsets = np.array(offsets, np.int64)
    result = progression(given_offsets)
    if isinstance(result, slice):
        np.testing.assert_array_equal(np.arange(51)[result], given_offsets)
    else:
        np.testing.assert_array_equal(result, given_offsets)


def message(channel: int, size: int) -> bytes:
    return b"\x05" + (22 + size).to_bytes(8, "little") + channel.to_bytes(2, "little") + bytes(20 + size)


def by_channel(content: bytes) -> McapBlock:
    plain = np.frombuffer(content, np.uint8)
    found = scan(plain, 0, len(plain)).messages
    channels = column(plain, "<u2", found, 9)
    return McapBlock(plain, {int(c): found[channels == c] for c in dict.fromkeys(channels.tolist())})


@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=4),
    st.integers(2, 20),
    st.integers(0, 60),
    st.sampled_from(["none", "other", "head"]),
    st.integers(0, 10**6),
)
def test_a_chunk_like_the_one_before_has_the_messages_that_a_walk_finds(
    sizes: list[int], rounds: int, count: int, change: str, where: int
) -> None:
    """Any part of any number of rounds; another record among them, or a head that differs, is never taken for one."""
    turn = [message(channel, size) for channel, size in enumerate(sizes)]
    before = by_channel(b"".join(turn * rounds))
    records = (turn * 60)[:count]
    heads = np.concatenate([[0], np.cumsum([len(record) for record in records])]).astype(int)
    if change == "other":
        records.insert(where % (count + 1), b"\x03" + (7).to_bytes(8, "little") + bytes(7))
    content = bytearray(b"".join(records))
    if change == "head" and count:
        content[int(heads[where % count]) + where % 11] ^= 1 << where % 8
    found = repeated(before, np.frombuffer(bytes(content), np.uint8), 0)
    if change == "none" and count >= len(turn):
        assert found is not None
    if change == "other" or (change == "head" and count):
        assert found is None
    if found is not None:
        expected = by_channel(bytes(content))
        assert {c: m.tolist() for c, m in found.messages.items()} == {
            c: m.tolist() for c, m in expected.messages.items()
        }
        for channel in found.messages:
            np.testing.assert_array_equal(found.spans(channel).size, expected.spans(channel).size)
            assert found.where(channel) == expected.where(channel) or len(expected.messages[channel]) < 2
