"""Small bags that unpack to much, or whose messages hold what no arm has: one line, at once, in
little memory."""

import sqlite3
import struct
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import zstandard

from elastic_arm.recording import limits, message_types, read_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.series import Decoder
from elastic_arm.recording.storage.bag import open_bag
from tests.helpers.bags import JOINT_STATE, START_NS, joint_state, stamps, states, write_sqlite
from tests.helpers.hostile_mcap import at, channel, chunk, file, mcap, quickly, record, schema, text

DEFINITION, _ = message_types.definition(JOINT_STATE)
HEADERS = (
    "std_msgs/Header header\nfloat64 data\n{line}\nMSG: std_msgs/Header\na/Stamp"
    " stamp\n{line}\nMSG: a/Stamp\n{{}}"
)
HEADERS = HEADERS.format(line="=" * 80)


def packed(*parts: bytes, topics: Sequence[str] = ("/joint_states",)) -> bytes:
    """A file of joint states in one chunk, packed."""
    plain = b"".join(parts)
    described = (channel(number, topic) for number, topic in enumerate(topics, start=1))
    whole = chunk(zstandard.ZstdCompressor().compress(plain), len(plain), "zstd")
    return file(schema(JOINT_STATE, DEFINITION), *described, whole)


def named(names: Sequence[str], row: int = 0, number: int = 1) -> bytes:
    """The record of a message that names its joints so."""
    stamp = START_NS + row * 1_000_000
    return at(stamp, joint_state(stamp, names, np.arange(float(len(names)))), number)


def with_numbers(count: int) -> bytes:
    """The record of a message of three joints and so many positions, all zero."""
    data = joint_state(START_NS, ("a", "b", "c"))
    return at(START_NS, data[:-12] + struct.pack("<II", count, 0) + bytes(8 * count + 8))


def with_empty_names(count: int) -> bytes:
    """The record of a message of so many empty names."""
    data = joint_state(START_NS, ())
    return at(START_NS, data[:-16] + struct.pack("<I", count) + bytes(4 * count + 12))


REFUSED: dict[str, tuple[Callable[[], bytes], str]] = {
    "three million empty names": (
        lambda: packed(with_empty_names(3_000_000)),
        "3000000 texts; the limit is 10000",
    ),
    "four million positions": (
        lambda: packed(with_numbers(4_000_000)),
        "4000000 numbers; the limit is 10000",
    ),
    "records of nine bytes": (
        lambda: file(record(0x80, b"") * 260_000),
        "records other than messages",
    ),
    "such records in a chunk": (
        lambda: mcap(
            chunk(
                zstandard.ZstdCompressor().compress(record(0x80, b"") * 210_000), 1_890_000, "zstd"
            )
        ),
        "records other than messages",
    ),
    "a channel again and again": (
        lambda: file(channel(1, "/t") * 201_000),
        "descriptions of channels",
    ),
    "channels without end": (
        lambda: file(*(channel(number, f"/t{number}") for number in range(65_535))),
        "more than 5000 channels",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_too_much_is_refused_at_once(tmp_path: Path, name: str) -> None:
    """Few bytes that make much work are met by the limits of limits.py, before the memory is
    taken."""
    bag = tmp_path / "a.mcap"
    make, reason = REFUSED[name]
    bag.write_bytes(make())
    found = quickly(lambda: read_recording(bag))
    assert isinstance(found, str)
    assert reason in found
    quickly(lambda: check_bag(bag))
    quickly(lambda: bag_info(bag))


def test_a_table_is_reserved_by_its_bytes(tmp_path: Path) -> None:
    """A thousand messages as long as the longest would not fit into the memory."""
    bag = tmp_path / "a.mcap"
    fields = "".join(f"float64[] x{number}\n" for number in range(500))
    data = (
        bytes([0, 1, 0, 0])
        + (struct.pack("<II", limits.COLUMNS, 0) + bytes(8 * limits.COLUMNS)) * 500
    )
    rows = at(START_NS, data) + at(START_NS + 1, data)
    whole = chunk(zstandard.ZstdCompressor().compress(rows), len(rows), "zstd")
    bag.write_bytes(file(schema("a/msg/T", fields), channel(1, "/x"), whole))
    (opened,) = open_bag(bag).files
    tracemalloc.start()
    decoder = Decoder("/x", "a/msg/T")
    for block in opened.blocks():
        decoder.add(opened, 1, block)
    assert tracemalloc.get_traced_memory()[1] < 3_000_000_000
    tracemalloc.stop()
    assert decoder.series().width("x499") == limits.COLUMNS


@pytest.mark.parametrize(
    "names", [("9" * 5000, "1", "2"), ("1" * 300_000 + "x", "j1", "j2"), ("j²", "j1", "j3")]
)
def test_names_of_many_digits_are_names(tmp_path: Path, names: tuple[str, ...]) -> None:
    """They count no joints, so the order is that of the messages; and no digit is looked at
    twice."""
    bag = tmp_path / "a.mcap"
    bag.write_bytes(packed(*(named(names, row) for row in range(20))))
    assert quickly(lambda: read_recording(bag).joints) == names
    quickly(lambda: check_bag(bag))


def test_many_names_in_two_orders_are_matched_at_once(tmp_path: Path) -> None:
    """Up to the limit of names, the places of names are looked up and not searched."""
    names = [f"j{number}" for number in range(limits.COLUMNS)]
    bag = tmp_path / "a.mcap"
    rows = (named(names[:: 1 - 2 * (row % 2)], row) for row in range(4))
    bag.write_bytes(
        packed(
            *rows,
            *(named(names[::-1], row, 2) for row in range(4)),
            topics=("/joint_states", "/motor_states"),
        )
    )
    recording = quickly(lambda: read_recording(bag))
    np.testing.assert_array_equal(recording.link.position[0], recording.link.position[1][::-1])  # type: ignore[attr-defined]
    quickly(lambda: check_bag(bag))


def test_thousands_of_channels_are_read_in_one_pass(tmp_path: Path) -> None:
    """Each message is looked at once, not once for every channel."""
    topics = [f"/t{number}" for number in range(limits.CHANNELS)]
    bag = tmp_path / "a.mcap"
    bag.write_bytes(
        packed(*(named(("a",), 0, number + 1) for number in range(len(topics))), topics=topics)
    )
    assert len(quickly(lambda: bag_info(bag)).topics) == len(topics)  # type: ignore[attr-defined]
    report = quickly(lambda: check_bag(bag))
    assert all(len(finding.message) < 1100 for finding in report.findings)  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["float64", "uint64", "int64", "float32", "int32[2]"])
def test_stamps_of_another_type_are_none(tmp_path: Path, kind: str) -> None:
    """A bag may define std_msgs/Header as it likes."""
    definition = HEADERS.format(f"{kind} sec\n{kind} nanosec\n")
    rows = b"".join(at(START_NS + row, bytes([0, 1, 0, 0]) + bytes(40)) for row in range(20))
    bag = tmp_path / "a.mcap"
    channels = tmp_path / "map.yaml"
    bag.write_bytes(file(schema("a/msg/T", definition), channel(1, "/x"), chunk(rows, len(rows))))
    channels.write_text("joints: {a: {link: {position: {topic: /x, field: data, index: 0}}}}\n")
    assert "no header stamp" in str(quickly(lambda: read_recording(bag, channels)))


def test_messages_without_a_byte_are_refused(tmp_path: Path) -> None:
    """In a database, and in a chunk."""
    folder = write_sqlite(tmp_path / "bag", states("/joint_states", stamps(10)))
    database_file = next(folder.glob("*.db3"))
    with sqlite3.connect(database_file) as database:
        database.execute("UPDATE messages SET data = x''")
    database.close()
    chunked = tmp_path / "a.mcap"
    chunked.write_bytes(packed(*[at(START_NS, b"")] * 10))
    for bag in (database_file, chunked):
        assert "is not plain CDR" in str(quickly(lambda bag=bag: read_recording(bag)))  # type: ignore[misc]
        quickly(lambda bag=bag: check_bag(bag))  # type: ignore[misc]


def test_a_long_message_of_a_database_is_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is never read: SQLite tells its length."""
    folder = write_sqlite(tmp_path / "bag", states("/joint_states", stamps(10)))
    database_file = next(folder.glob("*.db3"))
    with sqlite3.connect(database_file) as database:
        database.execute("UPDATE messages SET data = zeroblob(3000000) WHERE id = 8")
    database.close()
    monkeypatch.setenv("ELASTIC_ARM_MAX_CHUNK_MB", "1")
    assert "a message of 3000000 bytes" in str(quickly(lambda: read_recording(database_file)))
    assert not check_bag(database_file).ok


@pytest.mark.parametrize(
    "scalar", ["!!bool perhaps", "0x" + "f" * 100_000, ":".join(["59"] * 3000), "!!int ''"]
)
def test_yaml_within_a_bag_that_is_none_counts_as_none(tmp_path: Path, scalar: str) -> None:
    """Quality of service in a channel, and rosbag2's metadata within the file."""
    qos = channel(1, "/joint_states", offered_qos_profiles=f"- {{depth: {scalar}}}")
    said = text("serialized_metadata") + text(f"a: {scalar}")
    inside = record(0x0C, text("rosbag2") + struct.pack("<I", len(said)) + said)
    bag = tmp_path / "a.mcap"
    rows = b"".join(named(("a", "b"), row) for row in range(20))
    bag.write_bytes(file(schema(JOINT_STATE, DEFINITION), qos, chunk(rows, len(rows)), inside))
    assert len(quickly(lambda: read_recording(bag)).link) == 20  # type: ignore[attr-defined]
    assert quickly(lambda: repair_bag(bag, tmp_path / "copy")).kept == 20  # type: ignore[attr-defined]
