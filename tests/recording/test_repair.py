"""A repaired copy holds all that can be used."""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, read_recording, write_recording
from elastic_arm.recording.foreign.channels import ChannelMap
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.mcap import open_mcap
from elastic_arm.recording.storage.messages import read_messages, read_topics
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    assert_equal,
    both,
    codes,
    joint_state,
    side,
    stamps,
    states,
    two_sided,
    write_foreign,
)


def with_nan(tmp_path: Path) -> Path:
    messages = both(stamps(200))
    bad = joint_state(int(stamps(200)[120]), JOINTS, [1, 2, 3], [1, float("nan"), 3], [1, 2, 3])
    messages[120] = ("/joint_states", JOINT_STATE, int(stamps(200)[120]), bad)
    return write_foreign(tmp_path / "bag", messages)


def test_a_number_that_is_none_is_named_found_and_mended(tmp_path: Path) -> None:
    """Reading refuses, naming topic, field, joint and time; the check finds it; the repaired copy
    can be used."""
    bag = with_nan(tmp_path)
    before = {file: file.read_bytes() for file in bag.iterdir()}
    with pytest.raises(RecordingError) as caught:
        read_recording(bag)
    for word in ("/joint_states", "velocity", "joint_2", "0.120000 s", "check --repair"):
        assert word in str(caught.value)
    assert "nan" in codes(bag)
    mended = repair_bag(bag)
    assert mended.kept == 399 and mended.dropped
    assert check_bag(mended.path).usable
    read_recording(mended.path)
    assert {file: file.read_bytes() for file in bag.iterdir()} == before


def test_a_repair_never_drops_a_good_message(tmp_path: Path) -> None:
    """Not those of other joints, nor those of half of the joints, nor those out of order or with a
    stamp twice."""
    taken = stamps(400)
    swapped = taken.reshape(-1, 2)[:, ::-1].ravel()
    swapped[77] = swapped[76]
    halves = [
        m
        for part in (JOINTS[:1], JOINTS[1:], ["finger"])
        for m in states("/joint_states", swapped, part)
    ]
    bag = write_foreign(
        tmp_path / "bag", [(t, k, int(taken[i % 400]), d) for i, (t, k, _, d) in enumerate(halves)]
    )
    mended = repair_bag(bag)
    assert (mended.kept, mended.dropped) == (1200, [])


def test_arms_in_namespaces_are_repaired(tmp_path: Path) -> None:
    """Of each arm the messages with numbers that are none are left out."""
    given = [m for arm in ("/left", "/right") for m in states(f"{arm}/joint_states", stamps(100))]
    topic, kind, log, _ = given[130]
    given[130] = (
        topic,
        kind,
        log,
        joint_state(log, JOINTS, [0.0, np.nan, 0.0], [0.0] * 3, [0.0] * 3),
    )
    mended = repair_bag(write_foreign(tmp_path / "bag", given))
    assert mended.kept == 199 and "1 of 100 messages on /right/joint_states" in mended.dropped[0]


def test_topics_of_a_channel_map_are_repaired(tmp_path: Path) -> None:
    """Messages with numbers that are none in a mapped field are left out, and those with them
    elsewhere stay."""
    given = states("/drives", stamps(100))
    for row, field in ((30, 0), (60, 2)):
        numbers = [[0.0, np.nan, 0.0] if k == field else [0.0] * 3 for k in range(3)]
        given[row] = (*given[row][:3], joint_state(given[row][2], JOINTS, *numbers))
    bag = write_foreign(tmp_path / "bag", given)
    source = {"motor": {"position": {"topic": "/drives"}}}
    channels = ChannelMap.model_validate({"joints": dict.fromkeys(JOINTS, source)})
    mended = repair_bag(bag, channels=channels)
    assert mended.kept == 99 and "1 of 100 messages on /drives" in mended.dropped[0]
    assert (
        check_bag(mended.path, channels=channels).usable
        and not check_bag(bag, channels=channels).usable
    )


def test_repair_copies_everything_else(tmp_path: Path, rng: np.random.Generator) -> None:
    """A repaired copy of a sound bag holds every message, topic and type of it."""
    given = Recording(
        JOINTS, side(rng, stamps(500)), side(rng, stamps(500)), robot_description="<robot/>"
    )
    bag = write_recording(tmp_path / "bag", given)
    mended = repair_bag(bag, tmp_path / "copy")
    assert_equal(read_recording(mended.path), given)
    assert [m[:5] for m in read_messages(mended.path)] == [m[:5] for m in read_messages(bag)]
    assert read_topics(mended.path) == read_topics(bag)


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_a_truncated_bag_is_read_up_to_the_tear(
    tmp_path: Path, rng: np.random.Generator, share: float
) -> None:
    """A file cut off anywhere gives all whole chunks before the cut, says so, and can be made
    whole."""
    given = two_sided(rng, 20_000)
    file = write_recording(tmp_path / "bag", given) / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    torn = read_recording(file.parent)
    count = len(torn.link)
    assert share - 0.3 < count / 20_000 <= 1
    np.testing.assert_array_equal(torn.link.position, given.link.position[:count])
    assert any("no summary at the end" in note for note in torn.notes)
    assert "damaged" in codes(file.parent)
    assert_equal(read_recording(repair_bag(file.parent).path), torn)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_torn_chunk_is_read_up_to_the_tear(
    tmp_path: Path, rng: np.random.Generator, compression: str
) -> None:
    """A file that has one chunk, cut off within it, gives the messages before the cut, and can be
    made whole."""
    given = two_sided(rng, 2_000)
    file = write_recording(tmp_path / "bag", given, compression) / "bag_0.mcap"  # type: ignore[arg-type]
    (chunk,) = open_mcap(file).chunks
    file.write_bytes(file.read_bytes()[: (chunk.begin + chunk.end) // 2])
    torn = read_recording(file)
    assert torn.motor is not None and given.motor is not None
    assert 600 < len(torn.motor) < 1_400
    np.testing.assert_array_equal(torn.motor.position, given.motor.position[: len(torn.motor)])
    assert_equal(read_recording(repair_bag(file, tmp_path / "whole").path), torn)
    file.write_bytes(file.read_bytes()[: chunk.begin - 4])  # within the head of the chunk
    with pytest.raises(RecordingError, match="contains no messages at all"):
        read_recording(file)


def test_a_flipped_bit_is_found(tmp_path: Path, rng: np.random.Generator) -> None:
    """A chunk whose checksum fails is refused by its place; the repair saves the others."""
    file = write_recording(tmp_path / "bag", two_sided(rng, 20_000), "none") / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    chunk = open_mcap(file).chunks[2]
    content[(chunk.begin + chunk.end) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"chunk at byte .* is damaged .*checksum"):
        read_recording(file.parent)
    assert "damaged" in codes(file.parent)
    mended = read_recording(repair_bag(file.parent).path)
    assert 0.5 < len(mended.link) / 20_000 < 1


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_flipped_bits_in_packed_chunks_are_found(tmp_path: Path, compression: str) -> None:
    """Of forty single bits none changes what is read without an error; nearly all of them are
    errors."""
    given = two_sided(np.random.default_rng(1), 3_000)
    file = write_recording(tmp_path / "bag", given, compression) / "bag_0.mcap"  # type: ignore[arg-type]
    content = file.read_bytes()
    rng = np.random.default_rng(2)
    found = 0
    spans = [(chunk.begin, chunk.end) for chunk in open_mcap(file).chunks]
    for begin, end in rng.choice(spans, 40).tolist():
        changed = bytearray(content)
        changed[int(rng.integers(begin, end))] ^= 1 << int(rng.integers(8))
        file.write_bytes(changed)
        try:
            assert_equal(read_recording(file.parent), given)
        except RecordingError as error:
            assert "is damaged" in error.problem
            found += 1
    assert found >= 38
