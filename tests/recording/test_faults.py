"""Bad bags: each fault is named with its place and remedy, found by the check, and mended where it can be."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.messages import read_messages, read_topics
from elastic_arm.recording.stream_writer import StreamWriter
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    assert_equal,
    joint_state,
    side,
    stamps,
    states,
    two_sided,
    write_foreign,
)

ROOT = Path(__file__).parents[2]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def both(stamp_ns: np.ndarray) -> list[tuple[str, str, int, bytes]]:
    """Messages of both sides at the same stamps."""
    return states("/joint_states", stamp_ns) + states("/motor_states", stamp_ns)


def codes(path: Path, **options: object) -> set[str]:
    """Codes of all findings but the notes."""
    return {finding.code for finding in check_bag(path, **options).findings if finding.severity != "note"}


def test_a_clean_bag_has_no_findings(tmp_path: Path, rng: np.random.Generator) -> None:
    """Nothing is found where nothing is wrong."""
    report = check_bag(write_recording(tmp_path / "bag", two_sided(rng, 3000)))
    assert report.findings == []
    assert report.ok


def with_nan(tmp_path: Path) -> Path:
    messages = both(stamps(200))
    bad = joint_state(int(stamps(200)[120]), JOINTS, [1, 2, 3], [1, float("nan"), 3], [1, 2, 3])
    messages[120] = ("/joint_states", JOINT_STATE, int(stamps(200)[120]), bad)
    return write_foreign(tmp_path / "bag", messages)


def logged_in_turn(stamp_ns: np.ndarray) -> list[tuple[str, str, int, bytes]]:
    """Messages whose arrival times advance whatever their stamps do."""
    arrivals = stamps(len(stamp_ns))
    return [(t, k, int(log), d) for (t, k, _, d), log in zip(states("/motor_states", stamp_ns), arrivals, strict=True)]


def backwards(tmp_path: Path) -> Path:
    jumped = stamps(200)
    jumped[150:] -= 80_000_000
    return write_foreign(tmp_path / "bag", logged_in_turn(jumped))


def repeated(tmp_path: Path) -> Path:
    twice = stamps(200)
    twice[77] = twice[76]
    return write_foreign(tmp_path / "bag", logged_in_turn(twice))


@pytest.mark.parametrize(
    ("make", "code", "words"),
    [
        (with_nan, "nan", ("/joint_states", "velocity", "joint_2", "0.120000 s")),
        (backwards, "backwards", ("/motor_states", "back in time", "0.149000 s")),
        (repeated, "duplicate", ("/motor_states", "repeats the stamp", "0.076000 s")),
    ],
)
def test_fault_is_named_found_and_mended(
    tmp_path: Path, make: Callable[[Path], Path], code: str, words: tuple[str, ...]
) -> None:
    """Reading refuses, naming topic, field, joint and time; the check finds it; the repaired copy can be used."""
    bag = make(tmp_path)
    before = {file: file.read_bytes() for file in bag.iterdir()}
    with pytest.raises(RecordingError) as caught:
        read_recording(bag)
    for word in (*words, "check --repair"):
        assert word in str(caught.value)
    assert code in codes(bag)
    mended = repair_bag(bag)
    assert mended.dropped
    assert check_bag(mended.path).usable
    read_recording(mended.path)
    assert {file: file.read_bytes() for file in bag.iterdir()} == before


def test_repair_drops_the_fewest_messages(tmp_path: Path) -> None:
    """One stamp from the far future costs one message, not all that follow it."""
    wild = stamps(300)
    wild[100] += 10**12
    mended = repair_bag(write_foreign(tmp_path / "bag", logged_in_turn(wild)))
    assert mended.kept == 299
    np.testing.assert_array_equal(read_recording(mended.path).motor.stamp_ns, np.delete(stamps(300), 100))


def test_repair_copies_everything_else(tmp_path: Path, rng: np.random.Generator) -> None:
    """A repaired copy of a sound bag holds every message, topic and type of it."""
    given = Recording(JOINTS, side(rng, stamps(500)), side(rng, stamps(500)), robot_description="<robot/>")
    bag = write_recording(tmp_path / "bag", given)
    mended = repair_bag(bag, tmp_path / "copy")
    assert_equal(read_recording(mended.path), given)
    assert [m[:5] for m in read_messages(mended.path)] == [m[:5] for m in read_messages(bag)]
    assert read_topics(mended.path) == read_topics(bag)


def test_gaps_rates_and_drift_are_found(tmp_path: Path, rng: np.random.Generator) -> None:
    """Lost samples, a change of rate, and clocks that drift apart are each warned of."""
    holed = np.delete(stamps(2000), slice(500, 540))
    mixed = np.concatenate([stamps(1000), stamps(1000, 2_000_000, int(stamps(1001)[-1]))])
    slow = stamps(5000) + (np.arange(5000) * 200).astype(np.int64)  # 200 us a second
    for name, link, motor, code in (
        ("holed", holed, holed, "gaps"),
        ("mixed", mixed, mixed, "mixed_rates"),
        ("drifting", stamps(5000), slow, "drift"),
    ):
        bag = write_recording(tmp_path / name, Recording(JOINTS, side(rng, link), side(rng, motor)))
        assert codes(bag) == {code}, name
    gap = next(f for f in check_bag(tmp_path / "holed").findings if f.code == "gaps")
    assert "about 40 samples lost" in gap.message
    assert gap.time == pytest.approx(0.499)


def test_jitter_alone_is_no_fault(tmp_path: Path, rng: np.random.Generator) -> None:
    """Stamps that jitter by a tenth of the interval are noted, not complained of."""
    jittered = stamps(3000) + rng.normal(scale=1e5, size=3000).astype(np.int64)
    bag = write_recording(tmp_path / "bag", Recording(JOINTS, side(rng, jittered), side(rng, jittered)))
    assert codes(bag) == set()


def test_missing_topics_are_named(tmp_path: Path) -> None:
    """A bag without joint states is refused, with what it holds instead and what to do."""
    bag = write_foreign(tmp_path / "bag", [(f"/arm{t}", k, s, d) for t, k, s, d in states("/joints", stamps(20))])
    with pytest.raises(RecordingError, match=r"/arm/joints \(sensor_msgs/msg/JointState\).*--channels"):
        read_recording(bag)
    assert "no_joint_states" in codes(bag)


def test_unknown_joints_are_named(tmp_path: Path) -> None:
    """Joints that the robot does not have are named, with those that were recorded."""
    bag = write_foreign(tmp_path / "bag", both(stamps(100)))
    with pytest.raises(RecordingError, match="joint elbow was not recorded; there are joint_1, joint_2, joint_3"):
        read_recording(bag, joints=["joint_1", "elbow"])
    assert {"unknown_joint", "missing_joint"} <= codes(bag, joints=["joint_1", "elbow"])


def test_a_field_filled_now_and_then_is_named(tmp_path: Path) -> None:
    """Effort in some messages only: two publishers; said with topic and field."""
    messages = both(stamps(50))
    messages[10] = ("/joint_states", JOINT_STATE, messages[10][2], joint_state(messages[10][2], JOINTS, [1, 2, 3]))
    with pytest.raises(RecordingError, match="/joint_states: field velocity is empty"):
        read_recording(write_foreign(tmp_path / "bag", messages))


def test_wrong_type_is_named(tmp_path: Path) -> None:
    """/joint_states of another type is refused by both names."""
    from elastic_arm.recording import message_types

    store = message_types.typestore()
    text = bytes(store.serialize_cdr(store.types["std_msgs/msg/String"]("x"), "std_msgs/msg/String"))
    bag = write_foreign(tmp_path / "bag", [("/joint_states", "std_msgs/msg/String", int(t), text) for t in stamps(5)])
    with pytest.raises(RecordingError, match="has type std_msgs/msg/String, not sensor_msgs/msg/JointState"):
        read_recording(bag)


@pytest.mark.parametrize(
    ("content", "words"), [(b"", "is empty"), (b"no bag at all", "is no MCAP file"), (None, "does not exist")]
)
def test_what_is_no_bag_is_refused(tmp_path: Path, content: bytes | None, words: str) -> None:
    """Empty, foreign and missing files are each called what they are."""
    file = tmp_path / "x.mcap"
    if content is not None:
        file.write_bytes(content)
    for use in (read_recording, check_bag, repair_bag):
        with pytest.raises(RecordingError, match=words):
            use(file)


@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_a_truncated_bag_is_read_up_to_the_tear(tmp_path: Path, rng: np.random.Generator, share: float) -> None:
    """A file cut off anywhere gives all whole chunks before the cut, says so, and can be made whole."""
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


def test_a_flipped_bit_is_found(tmp_path: Path, rng: np.random.Generator) -> None:
    """A chunk whose checksum fails is refused by its place; the repair saves the others."""
    file = write_recording(tmp_path / "bag", two_sided(rng, 20_000), "none") / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"chunk at byte .* is damaged .*checksum"):
        read_recording(file.parent)
    assert "damaged" in codes(file.parent)
    mended = read_recording(repair_bag(file.parent).path)
    assert 0.5 < len(mended.link) / 20_000 < 1


RECORDER = """
import sys, time
from elastic_arm.recording.stream_writer import StreamWriter
from tests.helpers.bags import joint_state
writer = StreamWriter(sys.argv[1])
writer.add_topic("/motor_states", "sensor_msgs/msg/JointState")
writer.add_topic("/robot_description", "std_msgs/msg/String")
while True:
    now = time.time_ns()
    writer.write("/motor_states", joint_state(now, ["a", "b"], [1, 2], [3, 4], [5, 6]), now)
    print(now, flush=True)
    time.sleep(0.001)
"""


def test_a_killed_recorder_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    """SIGKILL in the middle of writing loses less than a second; the rest is read and repaired."""
    bag = tmp_path / "bag"
    with subprocess.Popen([sys.executable, "-c", RECORDER, str(bag)], stdout=subprocess.PIPE, cwd=ROOT) as process:
        written = [int(process.stdout.readline())]
        while written[-1] - written[0] < 2_500_000_000:
            written.append(int(process.stdout.readline()))
        process.send_signal(signal.SIGKILL)
        written += [int(line) for line in process.stdout if line.endswith(b"\n")]
    assert not (bag / "metadata.yaml").exists()
    kept = read_recording(bag).motor.stamp_ns
    assert written[-1] - kept[-1] < 1_000_000_000
    np.testing.assert_array_equal(kept, written[: len(kept)])
    assert {"missing_metadata", "damaged"} <= codes(bag)
    mended = repair_bag(bag)
    assert check_bag(mended.path).usable
    np.testing.assert_array_equal(read_recording(mended.path).motor.stamp_ns, kept)


def test_the_stream_writer_keeps_every_byte(tmp_path: Path) -> None:
    """Messages come out as they went in: bytes, topics, both times, in log order; the bag is in order."""
    given = [(t, k, s, d) for t, k, s, d in both(stamps(1500))]
    given.sort(key=lambda message: message[2])
    with StreamWriter(tmp_path / "bag", chunk_bytes=20_000) as writer:
        for topic in ("/joint_states", "/motor_states"):
            writer.add_topic(topic, JOINT_STATE)
        for topic, _, log_ns, data in given:
            writer.write(topic, data, log_ns, log_ns - 5)
        assert writer.counts == {"/joint_states": 1500, "/motor_states": 1500}
    assert [tuple(m) for m in read_messages(tmp_path / "bag")] == [(s, s - 5, t, k, d) for t, k, s, d in given]
    assert check_bag(tmp_path / "bag").ok


def test_the_stream_writer_flushes_by_the_clock(tmp_path: Path) -> None:
    """What is older than the flush interval is in the file before the writer is closed."""
    now = [0.0]
    writer = StreamWriter(tmp_path / "bag", flush_every=0.5, clock=lambda: now[0])
    writer.add_topic("/motor_states", JOINT_STATE)
    for topic, _, log_ns, data in states("/motor_states", stamps(600)):
        writer.write(topic, data, log_ns)
        now[0] += 0.001
    assert len(read_recording(tmp_path / "bag").motor) >= 500
    now[0] += 1.0
    writer.tick()
    assert len(read_recording(tmp_path / "bag").motor) == 600
    writer.close()


def test_a_recording_can_be_closed_at_any_time(tmp_path: Path) -> None:
    """Closing just when the disk is due to be synced writes the rest and finishes the bag."""
    now = [0.0]
    writer = StreamWriter(tmp_path / "bag", sync_every=5.0, clock=lambda: now[0])
    writer.add_topic("/motor_states", JOINT_STATE)
    for topic, _, log_ns, data in states("/motor_states", stamps(600)):
        writer.write(topic, data, log_ns)
    now[0] = 100.0
    writer.close()
    assert len(read_recording(tmp_path / "bag").motor) == 600
    assert (tmp_path / "bag" / "metadata.yaml").exists()


FULL_DISK = """
import resource, sys
from elastic_arm.errors import RecordingError
from elastic_arm.recording.stream_writer import StreamWriter
from tests.helpers.bags import joint_state, stamps
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
writer = StreamWriter(sys.argv[1], compression="none", chunk_bytes=10_000)
writer.add_topic("/motor_states", "sensor_msgs/msg/JointState")
try:
    for now in stamps(2000).tolist():
        writer.write("/motor_states", joint_state(now, ["a", "b"], [1, 2], [3, 4], [5, 6]), now)
except RecordingError as error:
    print(error)
"""


def test_a_full_disk_loses_nothing_that_was_written(tmp_path: Path) -> None:
    """When no more can be written the error says so, and everything written before is read again."""
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path / "bag")], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "cannot be written further: File too large" in done.stdout
    assert "messages written before are kept" in done.stdout
    count = int(done.stdout.split("The ")[1].split()[0])
    np.testing.assert_array_equal(read_recording(tmp_path / "bag").motor.stamp_ns, stamps(count))
    assert count > 300


def test_an_unwritable_folder_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """A place where nothing can be made is refused by its path and the system's reason."""
    (tmp_path / "file").write_text("no folder")
    for write in (lambda p: write_recording(p, two_sided(rng, 20)), StreamWriter):
        with pytest.raises(RecordingError, match=r"file/bag.* cannot be written: Not a directory"):
            write(tmp_path / "file" / "bag")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_refused(tmp_path: Path) -> None:
    """A folder that may not be written is refused with the system's reason."""
    tmp_path.chmod(0o500)
    with pytest.raises(RecordingError, match="Permission denied"):
        StreamWriter(tmp_path / "bag")


def test_recordings_that_cannot_be_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """Empty recordings, stamps that do not advance and columns that do not fit the joints are refused on writing."""
    with pytest.raises(RecordingError, match="holds no samples"):
        write_recording(tmp_path / "a", Recording(JOINTS))
    with pytest.raises(RecordingError, match="/joint_states jumps back in time"):
        write_recording(tmp_path / "b", Recording(JOINTS, link=side(rng, stamps(20)[::-1].copy())))
    with pytest.raises(RecordingError, match="link position has 2 columns for 3 joints"):
        Recording(JOINTS, link=side(rng, stamps(20), 2))
    with pytest.raises(RecordingError, match="position has shape"):
        Side(stamps(20), position=np.zeros((19, 3)))
    assert not any(tmp_path.iterdir())
