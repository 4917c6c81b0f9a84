"""Records among the bytes of an MCAP file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from elastic_arm.recording.spans import column, progression
from elastic_arm.recording.storage.mcap_scan import McapBlock, Record, indexed, repeated, scan

RECORDS = st.lists(
    st.tuples(st.sampled_from([3, 4, 5, 5, 5, 5]), st.integers(1, 3), st.integers(0, 40)),
    max_size=300,
)


@given(RECORDS, st.integers(1, 30), st.integers(0, 60))
def test_every_record_is_found_once(
    kinds: list[tuple[int, int, int]], repeats: int, torn: int
) -> None:
    """Any run of records, however often it repeats and wherever it is torn, is found whole, in
    order, and no more."""
    content = b""
    begins = []
    others = []
    for opcode, channel, extra in kinds * repeats:
        if opcode == 5:
            begins.append(len(content))
            body = channel.to_bytes(2, "little") + bytes(20 + extra)
        else:
            others.append((opcode, len(content) + 9))
            body = bytes(extra)
        content += bytes([opcode]) + len(body).to_bytes(8, "little") + body
    end = max(len(content) - torn, 0)
    ends = {
        begin: begin + 9 + int.from_bytes(content[begin + 1 : begin + 9], "little")
        for begin in begins
    }
    whole = [begin for begin in begins if ends[begin] <= end]
    found = scan(np.frombuffer(content, np.uint8), 0, end)
    assert found.messages.tolist() == whole
    assert [(r.opcode, r.begin) for r in found.others] == [
        o for o in others if o[1] <= found.end and o[1] <= end
    ]


@given(st.lists(st.integers(0, 50), min_size=1, max_size=20))
def test_progressions_are_told_from_other_offsets(offsets: list[int]) -> None:
    """A slice stands for offsets only if it gives exactly them."""
    given_offsets = np.array(offsets, np.int64)
    result = progression(given_offsets)
    if isinstance(result, slice):
        np.testing.assert_array_equal(np.arange(51)[result], given_offsets)
    else:
        np.testing.assert_array_equal(result, given_offsets)


def message(channel: int, size: int, claimed: int | None = None) -> bytes:
    length = 22 + size if claimed is None else claimed
    return b"\x05" + length.to_bytes(8, "little") + channel.to_bytes(2, "little") + bytes(20 + size)


def by_channel(content: bytes) -> McapBlock:
    plain = np.frombuffer(content, np.uint8)
    found = scan(plain, 0, len(plain)).messages
    channels = column(plain, "<u2", found, 9)
    return McapBlock(
        plain, {int(c): found[channels == c] for c in dict.fromkeys(channels.tolist())}
    )


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
    """Any part of any number of rounds; another record among them, or a head that differs, is never
    taken for one."""
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
            assert (
                found.where(channel) == expected.where(channel)
                or len(expected.messages[channel]) < 2
            )


def by_indexes(plain: bytes, offsets: dict[int, list[int]]) -> McapBlock | None:
    """What :func:`indexed` makes of a chunk whose indexes name these records."""
    file = b""
    indexes = []
    for channel, where in offsets.items():
        pairs = np.stack([np.zeros(len(where), "<u8"), np.array(where, "<u8")], axis=1).tobytes()
        begin = len(file)
        file = file + channel.to_bytes(2, "little") + len(pairs).to_bytes(4, "little") + pairs
        indexes.append(Record(7, begin, len(file)))
    return indexed(np.frombuffer(file, np.uint8), indexes, np.frombuffer(plain, np.uint8), 0)


@given(
    st.lists(st.tuples(st.integers(1, 3), st.integers(0, 40)), min_size=1, max_size=50),
    st.integers(0, 49),
)
def test_indexes_are_believed_if_every_byte_is_a_records(
    kinds: list[tuple[int, int]], missing: int
) -> None:
    """The messages that a walk finds; none if one is missing from the indexes."""
    content = b"".join(message(*kind) for kind in kinds)
    offsets = {c: where.tolist() for c, where in by_channel(content).messages.items()}
    found = by_indexes(content, offsets)
    assert {c: where.tolist() for c, where in found.messages.items()} == offsets
    channel = kinds[missing % len(kinds)][0]
    offsets[channel].pop(missing % len(offsets[channel]))
    assert by_indexes(content, offsets) is None


@pytest.mark.parametrize("inner", [1, 2])
def test_a_record_within_another_does_not_make_up_for_a_gap(inner: int) -> None:
    """A message among the bytes of another, on its channel or not, and as many bytes behind that
    are no record."""
    within = message(inner, 5)
    outer = message(1, 60)
    plain = outer[:50] + within + outer[50 + len(within) :] + bytes(len(within))
    offsets = {1: [0, 50]} if inner == 1 else {1: [0], 2: [50]}
    assert by_indexes(plain, offsets) is None


def test_lengths_that_overflow_together_are_refused() -> None:
    """Two of 2^63 - 1 bytes add up to -2, which a third record and its neighbours can make the
    chunk's length."""
    long = message(1, 0, 2**63 - 1)
    outer = message(1, 2 * len(long))
    plain = outer[:31] + 2 * long + bytes(2 * 9 - 2)
    assert by_indexes(plain, {1: [0, 31, 62]}) is None
    assert by_indexes(plain, {1: [0, 2**63 - 1]}) is None


def test_a_regular_message_within_another_does_not_make_up_for_a_gap() -> None:
    """Three channels, each equally spaced, that take no turns: the first would go on among the
    bytes of the third."""
    a = message(1, 59)
    b = message(2, 0)
    c = message(3, 29)
    before = by_channel(a + b + a + c + b + c)
    hidden = bytearray(a + b + a + c + b + c + bytes(len(a)))
    at = 2 * (len(a) + len(b))
    hidden[at : at + 11] = a[:11]
    assert repeated(before, np.frombuffer(bytes(hidden), np.uint8), 0) is None
