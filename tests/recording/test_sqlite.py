"""Bags stored with SQLite are read as MCAP ones are: whole, bare, compressed, old and torn."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.messages import read_messages, read_topics
from tests.helpers.bags import (
    JOINT_STATE,
    assert_equal,
    both,
    stamps,
    states,
    write_foreign,
    write_sqlite,
)

SHARED = Path(__file__).parents[3] / "shared" / "data" / "ur10"


def older(file: Path) -> None:
    """Take from a .db3 what versions of rosbag2 before Iron did not write: definitions, hashes,
    schema, metadata."""
    database = sqlite3.connect(file)
    for table in ("message_definitions", "schema", "metadata"):
        database.execute(f"DROP TABLE {table}")
    database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    database.commit()
    database.close()


def test_the_same_recording_comes_from_both_storages(tmp_path: Path) -> None:
    """A bag of 18 000 messages in a .db3 gives the very arrays that the same messages in an MCAP
    file give."""
    messages = both(stamps(9_000))
    one = write_foreign(tmp_path / "mcap", messages)
    other = write_sqlite(tmp_path / "sqlite", messages)
    assert_equal(read_recording(other), read_recording(one))
    assert list(read_messages(other)) == list(read_messages(one))
    assert [t[:3] for t in map(vars_of, read_topics(other))] == [
        t[:3] for t in map(vars_of, read_topics(one))
    ]
    assert check_bag(other).ok


def vars_of(topic: object) -> tuple[str, ...]:
    """The fields of a topic in their order."""
    return tuple(vars(topic).values())


@pytest.mark.parametrize("bare", [False, True], ids=["without metadata.yaml", "the file alone"])
def test_an_old_bag_without_metadata_or_definitions_is_read(tmp_path: Path, bare: bool) -> None:
    """Message types that the file does not define are the standard ones; the repair writes a bag
    that has all."""
    folder = write_sqlite(tmp_path / "bag", both(stamps(300)))
    (folder / "metadata.yaml").unlink()
    older(folder / "bag.db3")
    path = folder / "bag.db3" if bare else folder
    recording = read_recording(path)
    np.testing.assert_allclose(
        recording.link.position, np.arange(300)[:, None] + [0, 0.1, 0.2], rtol=0, atol=1e-12
    )
    assert (bag_info(path).messages, bag_info(path).compression) == (600, ["none"])
    assert check_bag(path).usable
    # Said once: that reading notes it as well is no second finding.
    assert [finding.code for finding in check_bag(path).findings] == (
        [] if bare else ["missing_metadata"]
    )
    mended = repair_bag(path)
    assert mended.path.name == "bag_repaired"
    assert_equal(read_recording(mended.path), recording)
    with AnyReader([mended.path]) as reader:
        assert {connection.msgtype for connection in reader.connections} == {JOINT_STATE}


def test_a_file_compressed_as_a_whole_is_read(tmp_path: Path) -> None:
    """rosbag2's file compression (.db3.zstd) is unpacked in memory."""

    def packed(writer: Writer) -> None:
        writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)

    folder = write_sqlite(tmp_path / "bag", both(stamps(300)), packed)
    assert (folder / "bag.db3.zstd").exists()
    assert_equal(
        read_recording(folder), read_recording(write_sqlite(tmp_path / "plain", both(stamps(300))))
    )
    assert bag_info(folder).compression == ["zstd"]


def test_messages_compressed_one_by_one_are_refused_with_the_way_out(tmp_path: Path) -> None:
    """rosbag2's message compression is refused, naming the conversion."""

    def packed(writer: Writer) -> None:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)

    with pytest.raises(RecordingError, match="ros2 bag convert"):
        read_recording(write_sqlite(tmp_path / "bag", both(stamps(10)), packed))


def test_rows_out_of_order_come_out_by_their_timestamps(tmp_path: Path) -> None:
    """A recorder writes what it receives late behind later rows; messages come out in the order of
    their times."""
    messages = both(stamps(9_000))
    shuffled = [messages[i] for i in np.random.default_rng(1).permutation(len(messages))]
    folder = write_sqlite(tmp_path / "bag", shuffled)
    assert [m.log_ns for m in read_messages(folder)] == [m[2] for m in messages]
    np.testing.assert_array_equal(read_recording(folder).link.stamp_ns, stamps(9_000))


def test_rows_in_a_write_ahead_log_are_read(tmp_path: Path) -> None:
    """What a killed recorder left in the write-ahead log beside the file counts."""
    folder = write_sqlite(tmp_path / "bag", states("/motor_states", stamps(100)))
    live = sqlite3.connect(folder / "bag.db3")
    live.execute("PRAGMA journal_mode=WAL")
    (topic,) = live.execute("SELECT id FROM topics").fetchone()
    for _, _, log_ns, data in states("/motor_states", stamps(150)[100:]):
        live.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            (topic, log_ns, data),
        )
    live.commit()
    assert len(read_recording(folder / "bag.db3").motor) == 150
    live.close()


def test_a_torn_file_is_read_up_to_the_tear(tmp_path: Path) -> None:
    """A damaged database is refused by name; check finds it and the repair saves what can be
    read."""
    folder = write_sqlite(tmp_path / "bag", both(stamps(9_000)))
    file = folder / "bag.db3"
    content = bytearray(file.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 100_000] = bytes(100_000)
    file.write_bytes(content)
    with pytest.raises(RecordingError, match="database is damaged"):
        read_recording(folder)
    assert "damaged" in {finding.code for finding in check_bag(folder).findings}
    kept = read_recording(repair_bag(folder).path)
    assert 0.1 < len(kept.link) / 9_000 < 1
    np.testing.assert_array_equal(kept.link.stamp_ns, stamps(9_000)[: len(kept.link)])


def test_a_database_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    """A SQLite file without the tables of a bag is no bag."""
    sqlite3.connect(tmp_path / "x.db3").execute("CREATE TABLE notes (text)").connection.close()
    with pytest.raises(RecordingError, match="not a bag"):
        read_recording(tmp_path / "x.db3")


def test_a_folder_with_both_formats_and_no_metadata_is_refused(tmp_path: Path) -> None:
    """A bag beside its own conversion would count twice: the file to read must be named."""
    messages = both(stamps(20))
    folder = write_sqlite(tmp_path / "bag", messages)
    next(write_foreign(tmp_path / "other", messages).glob("*.mcap")).rename(folder / "bag.mcap")
    (folder / "metadata.yaml").unlink()
    with pytest.raises(RecordingError, match=r"\.mcap and \.db3"):
        read_recording(folder)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recordings of a real UR10")
def test_bags_of_a_real_robot_are_read() -> None:
    """A UR10's bag, as it arrived without metadata.yaml, has its six joints at 125 Hz."""
    recording = read_recording(SHARED / "ur10_exciting_trajectory.db3")
    assert recording.n == 6
    assert len(recording.motor) == 3441
    assert 1 / np.median(np.diff(recording.samples().t)) == pytest.approx(125, rel=0.01)
