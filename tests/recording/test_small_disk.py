"""Bags on a real file system that is full, or that may only be read."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zstandard

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.stream_writer import StreamWriter
from tests.helpers.bags import stamps, states, two_sided, write_sqlite
from tests.helpers.small_disk import fill, make_read_only, mounted


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 200 kB."""
    with mounted(tmp_path / "disk", 200) as folder:
        yield folder


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_full_disk_loses_nothing_that_was_written(disk: Path, compression: str) -> None:
    """Where the disk takes no more the error says so, and what was written before it is read again,
    in order."""
    writer = StreamWriter(disk / "bag", compression, chunk_bytes=10_000)  # type: ignore[arg-type]
    writer.add_topic("/motor_states", "sensor_msgs/msg/JointState")
    with pytest.raises(RecordingError, match="No space left on device") as caught:
        for topic, _, log_ns, data in states("/motor_states", stamps(20_000)):
            writer.write(topic, data, log_ns)
    count = int(str(caught.value).split("The ")[1].split()[0])
    kept = read_recording(disk / "bag").motor
    np.testing.assert_array_equal(kept.stamp_ns, stamps(20_000)[: len(kept)])
    # A chunk that was cut in half may give some messages more than those promised.
    assert count <= len(kept) <= count + 100
    assert count > 300


def test_a_recording_that_does_not_fit_is_refused(disk: Path, rng: np.random.Generator) -> None:
    """Writing a recording at once ends with the system's reason, and so does mending a bag onto a
    full disk."""
    with pytest.raises(RecordingError, match="No space left on device"):
        write_recording(disk / "bag", two_sided(rng, 5000), "none")
    fill(disk)
    write_recording(disk.parent / "sound", two_sided(rng, 500))
    with pytest.raises(RecordingError, match="No space left on device"):
        repair_bag(disk.parent / "sound", disk / "mended")


def test_nothing_is_made_on_a_disk_that_may_only_be_read(
    disk: Path, rng: np.random.Generator
) -> None:
    """Both writers are refused by path and reason."""
    make_read_only(disk)
    for write in (lambda path: write_recording(path, two_sided(rng, 20)), StreamWriter):
        with pytest.raises(
            RecordingError, match=r"disk/bag.* cannot be written: Read-only file system"
        ):
            write(disk / "bag")


def test_bags_are_read_where_nothing_can_be_written(disk: Path, rng: np.random.Generator) -> None:
    """MCAP, SQLite and packed SQLite bags on a disk that may only be read are read, checked and
    summed up."""
    write_recording(disk / "mcap", two_sided(rng, 120))
    database = next(
        write_sqlite(disk / "sqlite", states("/joint_states", stamps(60))).glob("*.db3")
    )
    (disk / "packed.db3.zstd").write_bytes(
        zstandard.ZstdCompressor().compress(database.read_bytes())
    )
    make_read_only(disk)
    for name, count in (("mcap", 120), ("sqlite", 60), ("packed.db3.zstd", 60)):
        recording = read_recording(disk / name)
        side = recording.motor or recording.link
        assert side is not None and len(side) == count, name
        check_bag(disk / name)
        assert bag_info(disk / name).messages >= count
