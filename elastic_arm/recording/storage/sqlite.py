"""Bags that rosbag2 stored with SQLite (.db3): plain, or compressed as a file with zstd.

Read through Python's own sqlite3, as rosbags does, but block by block, with limits for what a
hostile or damaged file claims, and with the log that a killed recorder left.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.spans import by_value, place
from elastic_arm.recording.storage.mcap_scan import MESSAGE_HEAD, RECORD_HEAD, McapBlock
from elastic_arm.recording.storage.metadata import StoredFile, Topic
from elastic_arm.recording.storage.unpacking import PACKED_FILES, unpack_file

_MAGIC = b"SQLite format 3\0"
# The library decodes its own messages, which quote what is damaged.
_DAMAGED = (sqlite3.Error, UnicodeDecodeError)
_BYTES = 64 * limits.MEGABYTE  # from which on a block is handed out, however few rows it has
_REMEDY = "Give a rosbag2 folder, an .mcap or a .db3 file."
# By timestamp: an index holds that order, so that nothing is sorted. Rows of one timestamp come as
# they were written. A message above the limit comes as its length: SQLite tells it without reading
# the message.
_MESSAGES = (
    "SELECT topic_id, timestamp, CASE WHEN length(data) <= ? THEN data ELSE length(data) END FROM"
    " messages WHERE typeof(data) = 'blob' AND typeof(timestamp) = 'integer' AND typeof(topic_id) ="
    " 'integer' ORDER BY timestamp, id"
)


@dataclass
class SqliteFile(StoredFile):
    """A .db3 file. To count its messages takes as long as to read them."""

    # its plain content where the file is compressed; None where SQLite reads the file itself
    image: bytearray | None = None

    def packing(self) -> set[str]:
        """Return how the file is packed."""
        return {"none" if self.image is None else "zstd"}

    def blocks(self, strict: bool = True) -> Iterator[McapBlock]:
        """Yield the messages in the order of their timestamps."""
        rows: list[tuple[int, int, bytes]] = []
        size = 0
        most = limits.chunk_bytes()
        try:
            with closing(self.connect()) as database:
                for row in database.execute(_MESSAGES, (most,)):
                    if isinstance(row[2], int):
                        raise sqlite3.DataError(f"a message of {row[2]} bytes; the limit is {most}")
                    rows.append(row)
                    size += len(row[2])
                    if len(rows) == 16384 or size > _BYTES:  # rows of a block
                        yield _block(rows)
                        rows.clear()
                        size = 0
        except _DAMAGED as error:
            problem = f"{self.path}: the database is damaged ({error})"
            if strict:
                raise RecordingError(
                    problem,
                    f"Save the undamaged parts with: elastic-arm bag check --repair {self.path}",
                ) from None
            if problem not in self.damage:  # as after an earlier look
                self.damage.append(problem)
        if rows:
            yield _block(rows)

    def connect(self) -> sqlite3.Connection:
        """Open the database for reading alone."""
        if self.image is not None:
            database = sqlite3.connect(":memory:", check_same_thread=False)
            database.deserialize(self.image)
        else:
            # A killed recorder may leave a write-ahead log that holds the last messages. Without
            # one the file is whole as it is, and is read without locks: it may lie on a medium that
            # cannot be written.
            log = self.path.with_name(f"{self.path.name}-wal")
            options = "mode=ro" if log.exists() and log.stat().st_size else "mode=ro&immutable=1"
            uri = f"{self.path.resolve().as_uri()}?{options}"
            database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        # which need not be a text
        database.text_factory = lambda content: content.decode(errors="replace")
        return database


def open_sqlite(path: Path) -> SqliteFile:
    """Open a .db3 file."""
    file = SqliteFile(path)
    if path.suffix in PACKED_FILES:
        file.image = unpack_file(path, limits.unpacked_bytes() // 2)  # of which SQLite takes a copy
        head = bytes(file.image[: len(_MAGIC)])
    else:
        with open(path, "rb") as opened:
            head = opened.read(len(_MAGIC))
    if not head:
        raise RecordingError(f"{path} is empty", "Record again: nothing was written.")
    if head != _MAGIC:
        raise RecordingError(f"{path} is not an SQLite file", _REMEDY)
    try:
        with closing(file.connect()) as database:
            file.channels = _channels(database, path)
    except _DAMAGED as error:
        raise RecordingError(f"{path} is damaged ({error})", "Record again.") from None
    return file


def _channels(database: sqlite3.Connection, path: Path) -> dict[int, Topic]:
    """Read the table of topics, whose columns grew with the versions of rosbag2."""
    # A view or a virtual table would compute what it holds, without end if its author likes.
    query = "SELECT name FROM sqlite_master WHERE type <> 'table' OR sql LIKE 'create virtual%'"
    computed = {str(name).lower() for (name,) in database.execute(query)}
    if computed & {"messages", "topics", "message_definitions"}:
        raise RecordingError(
            f"{path} is an SQLite file but not a bag: its tables are computed", _REMEDY
        )
    if not {"id", "topic_id", "timestamp", "data"} <= _columns(database, "messages"):
        raise RecordingError(f"{path} is an SQLite file but not a bag", _REMEDY)
    there = _columns(database, "topics")
    wanted = ("id", "name", "type", "offered_qos_profiles", "type_description_hash")
    chosen = ", ".join(name if name in there else "''" for name in wanted)
    definitions = {}
    if _columns(database, "message_definitions"):
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        definitions = {
            str(name): (str(encoding), str(text))
            for name, encoding, text in database.execute(query)
        }
    channels = {}
    for number, *texts in database.execute(f"SELECT {chosen} FROM topics ORDER BY id"):
        name, type_name, qos, type_hash = map(str, texts)
        encoding, text = definitions.get(type_name, ("", ""))
        channels[number] = Topic(name, type_name, text, type_hash, qos, encoding)
        if len(channels) > limits.CHANNELS:
            raise RecordingError(
                f"{path} describes more than {limits.CHANNELS} topics", "Record fewer topics."
            )
    return channels


def _columns(database: sqlite3.Connection, table: str) -> set[str]:
    return {row[1] for row in database.execute(f"PRAGMA table_info({table})")}


def _block(rows: Sequence[tuple[int, int, bytes]]) -> McapBlock:
    """Lay rows into bytes as the records of an MCAP file are."""
    channel, stamps, data = zip(*rows, strict=True)
    size = np.fromiter(map(len, data), np.int64, len(data))
    stamp_ns = np.array(stamps, np.int64)
    head = bytearray(MESSAGE_HEAD)
    buffer = np.frombuffer(head + head.join(data), np.uint8)
    begin = np.cumsum(size + MESSAGE_HEAD) - size - MESSAGE_HEAD
    for at, items in ((1, size + MESSAGE_HEAD - RECORD_HEAD), (15, stamp_ns), (23, stamp_ns)):
        place(buffer, begin, at, items)
    where = by_value(np.array(channel, np.int64))
    return McapBlock(
        buffer, {number: begin[rows] for number, rows in where.items()}, int(stamp_ns[-1])
    )
