"""Bags that claim too much, or what cannot be: one line each, at once, within the limits on
memory."""

import os
import sqlite3
import struct
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from mcap.opcode import Opcode

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from elastic_arm.recording.inspection.repair import repair_bag
from elastic_arm.recording.storage.bag import METADATA, open_bag
from elastic_arm.recording.storage.messages import read_topics
from tests.helpers.bags import stamps, states, two_sided, write_sqlite
from tests.helpers.hostile_mcap import HUGE, chunk, index, mcap, message, quickly, record, text

ZSTD = zstandard.ZstdCompressor().compress(message())
# a frame header of 2^40 bytes
CLAIMS = b"\x28\xb5\x2f\xfd" + b"\xe0" + struct.pack("<Q", 2**40) + ZSTD[-20:]
MCAP_FILES: dict[str, bytes] = {
    "a chunk that claims 2^63 bytes, zstd": mcap(chunk(ZSTD, HUGE, "zstd")),
    "a chunk that claims 2^63 bytes, lz4": mcap(chunk(lz4.frame.compress(message()), HUGE, "lz4")),
    "a chunk that claims 2^40 bytes": mcap(chunk(ZSTD, 2**40, "zstd")),
    "a zstd frame that claims 2^40 bytes": mcap(chunk(CLAIMS, len(message()), "zstd")),
    "an lz4 bomb": mcap(chunk(lz4.frame.compress(bytes(50_000_000), store_size=False), 100, "lz4")),
    "a chunk longer than its record": mcap(chunk(message(), len(message()), length=HUGE)),
    "a chunk of the year 2400": mcap(chunk(message(), len(message()), start=2**64 - 1)),
    "an unknown compression": mcap(chunk(message(), len(message()), "x" * 1000)),
    "a message shorter than its head": mcap(record(Opcode.MESSAGE, b"abc")),
    "a short message in a chunk": mcap(chunk(record(Opcode.MESSAGE, b"abc"), 12)),
    "a record that claims 2^63 bytes": mcap(record(Opcode.MESSAGE, b"abc", HUGE)),
    "a record in a chunk that does": mcap(chunk(record(Opcode.MESSAGE, b"abc", HUGE), 12)),
    "an index of odd length": mcap(chunk(message(), len(message())), index(b"odd")),
    "an index beyond the chunk": mcap(
        chunk(message(), len(message())), index(struct.pack("<QQ", 1, 2**40))
    ),
    "an index of 2^63": mcap(chunk(message(), len(message())), index(struct.pack("<QQ", 1, HUGE))),
    "a torn channel": mcap(record(Opcode.CHANNEL, struct.pack("<HH", 2, 1) + text("/u", 2**31))),
    "statistics of 2^60 messages": mcap(
        chunk(message(data=bytes([0, 1]) + bytes(10)), 43),
        record(
            Opcode.STATISTICS,
            struct.pack("<QHIIIIQQI", 2**60, 1, 1, 0, 0, 1, 0, 0, 10)
            + struct.pack("<HQ", 1, 2**60),
        ),
    ),
}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "bag", two_sided(np.random.default_rng(0), 300))


@pytest.mark.parametrize("name", MCAP_FILES)
def test_hostile_mcap_files_are_refused_at_once(tmp_path: Path, name: str) -> None:
    """Lengths, counts and offsets that cannot be are damage, whoever asks."""
    file = tmp_path / "a.mcap"
    file.write_bytes(MCAP_FILES[name])
    for work in (read_recording, check_bag, bag_info, read_topics):
        found = quickly(lambda work=work: work(file))  # type: ignore[misc]
    report = quickly(lambda: check_bag(file))
    assert not getattr(report, "ok", False), found


def edited(bag: Path, **fields: object) -> Path:
    """Change metadata.yaml of a bag."""
    content = yaml.safe_load((bag / METADATA).read_text())
    content["rosbag2_bagfile_information"].update(fields)
    (bag / METADATA).write_text(yaml.safe_dump(content))
    return bag


ALIASES = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(12)
)
METADATA_TEXTS = {
    "an alias bomb": ALIASES + "rosbag2_bagfile_information: *m\n",
    "an alias of itself": "rosbag2_bagfile_information: &a [*a]",
    "a date that is none": "rosbag2_bagfile_information: {version: 2001-99-99}",
    "an integer of 5000 digits": f"rosbag2_bagfile_information: {{message_count: {'9' * 5000}}}",
    "an integer of 5000 hexadecimal digits": (
        f"rosbag2_bagfile_information: {{message_count: 0x{'f' * 5000}}}"
    ),
    "an integer of many parts": f"rosbag2_bagfile_information: {{message_count: 59{':59' * 3000}}}",
    "a truth that is none": "rosbag2_bagfile_information: {a: !!bool perhaps}",
    "a number that is none": "rosbag2_bagfile_information: {message_count: 0x_}",
    "deep brackets": "rosbag2_bagfile_information: " + "[" * 100_000,
    "a tag of Python": "rosbag2_bagfile_information: !!python/object/apply:os.system [true]",
    "no fields": "rosbag2_bagfile_information: 5",
    "a list": "[1, 2]",
    "UTF-32": "rosbag2_bagfile_information: {}".encode("utf-32").decode("latin-1"),
}


@pytest.mark.parametrize("name", METADATA_TEXTS)
def test_hostile_metadata_is_damage_and_the_messages_are_read(bag: Path, name: str) -> None:
    """The files of the bag are read all the same, and the damage is noted."""
    (bag / METADATA).write_bytes(METADATA_TEXTS[name].encode("latin-1"))
    opened = quickly(lambda: open_bag(bag))
    assert any(METADATA in words for words in opened.damage)  # type: ignore[attr-defined]
    assert len(read_recording(bag).link) == 300  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "fields",
    [
        {"relative_file_paths": 5},
        {"relative_file_paths": [5, None]},
        {"relative_file_paths": ["../../etc/passwd"]},
        {"relative_file_paths": ["/etc/passwd"]},
        {"relative_file_paths": ["a\0b"]},
        {"message_count": "many"},
        {"message_count": [1]},
        {"compression_mode": ["message"]},
    ],
)
def test_fields_of_the_wrong_kind_are_damage(bag: Path, fields: dict[str, object]) -> None:
    """Names that lead out of the bag's folder are not followed; wrong kinds are named."""
    report = check_bag(edited(bag, **fields))
    assert "compression_mode" in fields or not report.ok
    assert len(read_recording(bag).link) == 300  # type: ignore[arg-type]


@pytest.mark.parametrize("storage", ["mcap", "db3"])
def test_the_limits_are_configurable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, storage: str
) -> None:
    """A file that unpacks to more than $ELASTIC_ARM_MAX_UNPACKED_MB is refused, and read once that
    is raised."""
    bag = write_recording(tmp_path / "bag", two_sided(np.random.default_rng(0), 5000), "zstd")
    file = bag / "bag_0.mcap"
    if storage == "db3":
        folder = write_sqlite(tmp_path / "sqlite", states("/joint_states", stamps(5000)))
        plain = next(folder.glob("*.db3"))
        file = plain.with_name("a.db3.zstd")
        file.write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "1")
    with pytest.raises(RecordingError, match="ELASTIC_ARM_MAX_UNPACKED_MB"):
        read_recording(file)
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "100")
    assert len(read_recording(file).link) == 5000  # type: ignore[arg-type]
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "much")
    with pytest.raises(RecordingError, match="whole megabytes"):
        limits.unpacked_bytes()


def test_a_chunk_above_the_limit_is_damage(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """$ELASTIC_ARM_MAX_CHUNK_MB bounds one chunk."""
    monkeypatch.setenv("ELASTIC_ARM_MAX_CHUNK_MB", "0")
    assert "ELASTIC_ARM_MAX_CHUNK_MB" in str(quickly(lambda: read_recording(bag)))


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x"


@pytest.mark.parametrize("table", ["messages", "topics"])
def test_tables_that_are_computed_are_refused(tmp_path: Path, table: str) -> None:
    """A view in place of a table would compute rows without end."""
    folder = write_sqlite(tmp_path / "bag", states("/joint_states", stamps(10)))
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
        database.execute(f"DROP TABLE {table}")
        values = ", ".join(f"x AS {name}" for name in columns)
        database.execute(f"CREATE VIEW {table} AS SELECT {values} FROM ({ENDLESS} FROM n)")
    database.close()
    assert "computed" in str(quickly(lambda: read_recording(file)))


@pytest.mark.parametrize("column", ["topic_id", "timestamp", "data"])
@pytest.mark.parametrize("value", ["NULL", "'text'", "1.5"])
def test_messages_with_a_column_of_another_type_are_left_out(
    tmp_path: Path, column: str, value: str
) -> None:
    """Half of the rows have no number, or no bytes, where one belongs: the other half is read."""
    folder = write_sqlite(tmp_path / "bag", states("/joint_states", stamps(10)))
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        sql = database.execute("SELECT sql FROM sqlite_master WHERE name = 'messages'").fetchone()[
            0
        ]
        database.execute("ALTER TABLE messages RENAME TO old")
        database.execute(
            sql.replace("NOT NULL", "").replace("INTEGER PRIMARY KEY", "").replace("INTEGER", "")
        )
        database.execute("INSERT INTO messages SELECT * FROM old")
        database.execute(f"UPDATE messages SET {column} = {value} WHERE id % 2")
    database.close()
    quickly(lambda: check_bag(file))
    recording = read_recording(file)
    assert len(recording.link) == 5


@pytest.mark.parametrize("name", ["pipe.mcap", "pipe.db3", "pipe"])
def test_pipes_are_refused(tmp_path: Path, name: str) -> None:
    """A pipe is not waited for, also where it lies in a bag's folder."""
    os.mkfifo(tmp_path / name)
    assert "pipe or a device" in str(quickly(lambda: open_bag(tmp_path / name)))
    if name != "pipe":
        assert "pipe or a device" in str(quickly(lambda: open_bag(tmp_path)))
    assert "pipe or a device" in str(quickly(lambda: open_bag("/dev/zero")))


def test_a_repair_leaves_out_times_that_cannot_be_and_quality_that_is_none(tmp_path: Path) -> None:
    """A message of the year 2400 is not copied, and hostile quality of service is replaced by
    none."""
    qos = text("offered_qos_profiles") + text("\0" + "[" * 5000)
    described = (
        struct.pack("<HH", 2, 1) + text("/u") + text("cdr") + struct.pack("<I", len(qos)) + qos
    )
    late = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, HUGE, HUGE))
    file = tmp_path / "a.mcap"
    file.write_bytes(mcap(record(Opcode.CHANNEL, described), message(2), late))
    repair = repair_bag(file, tmp_path / "copy")
    assert repair.kept == 1
    assert "1 messages logged or sent after the year 2262" in repair.dropped
    assert (tmp_path / "copy" / METADATA).exists()


def test_errors_of_sqlite_that_are_no_text_are_one_line(tmp_path: Path) -> None:
    """The library quotes damaged names in its errors, and fails to decode them."""
    folder = write_sqlite(tmp_path / "bag", states("/joint_states", stamps(10)))
    file = next(folder.glob("*.db3"))
    content = file.read_bytes()
    for name in (b"CREATE TABLE messages", b"CREATE TABLE topics"):
        file.write_bytes(content.replace(name, name[:13] + b"\xff\xfe\x80" + name[16:]))
        assert isinstance(quickly(lambda: read_recording(file)), str)
        quickly(lambda: check_bag(file))
