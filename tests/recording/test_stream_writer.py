"""A bag that is written while it happens keeps what it was given, whatever becomes of the
process."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.messages import read_messages
from elastic_arm.recording.storage.stream_writer import StreamWriter
from tests.helpers.bags import JOINT_STATE, both, codes, stamps, states, two_sided

ROOT = Path(__file__).parents[2]


RECORDER = """
import sys, time
from elastic_arm.recording.storage.stream_writer import StreamWriter
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
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(bag)], stdout=subprocess.PIPE, cwd=ROOT
    ) as process:
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
    """Messages come out as they went in: bytes, topics, both times, in log order; the bag is in
    order."""
    given = [(t, k, s, d) for t, k, s, d in both(stamps(1500))]
    given.sort(key=lambda message: message[2])
    with StreamWriter(tmp_path / "bag", chunk_bytes=20_000) as writer:
        for topic in ("/joint_states", "/motor_states"):
            writer.add_topic(topic, JOINT_STATE)
        for topic, _, log_ns, data in given:
            writer.write(topic, data, log_ns, log_ns - 5)
        assert writer.counts == {"/joint_states": 1500, "/motor_states": 1500}
    assert [tuple(m) for m in read_messages(tmp_path / "bag")] == [
        (s, s - 5, t, k, d) for t, k, s, d in given
    ]
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


def test_an_unwritable_folder_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """A place where nothing can be made is refused by its path and the system's reason."""
    (tmp_path / "file").write_text("no folder")
    for write in (lambda p: write_recording(p, two_sided(rng, 20)), StreamWriter):
        with pytest.raises(RecordingError, match=r"file/bag.* cannot be written: Not a directory"):
            write(tmp_path / "file" / "bag")
