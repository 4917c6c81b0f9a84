"""MCAP files record by record, with whatever lengths and counts they are to claim; and how fast
they are refused."""

import struct
import time
from collections.abc import Callable

from mcap.opcode import Opcode

from elastic_arm.errors import RecordingError
from elastic_arm.recording.storage.mcap import MAGIC

HUGE = 2**63


def record(opcode: int, content: bytes, size: int | None = None) -> bytes:
    """One record of MCAP, with any length."""
    return struct.pack("<BQ", opcode, len(content) if size is None else size) + content


def text(value: str, size: int | None = None) -> bytes:
    """A string of MCAP."""
    return struct.pack("<I", len(value.encode()) if size is None else size) + value.encode()


def message(channel: int = 1, data: bytes = b"") -> bytes:
    """A message's record."""
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, 1, 1) + data)


def chunk(
    packed: bytes, size: int, kind: str = "", start: int = 0, length: int | None = None
) -> bytes:
    """A chunk's record, with whatever it claims."""
    head = struct.pack("<QQQI", start, start, size, 0) + text(kind)
    return record(
        Opcode.CHUNK, head + struct.pack("<Q", len(packed) if length is None else length) + packed
    )


def schema(type_name: str, definition: str, encoding: str = "ros2msg") -> bytes:
    """The description of a type."""
    named = struct.pack("<H", 1) + text(type_name) + text(encoding) + text(definition)
    return record(Opcode.SCHEMA, named)


def channel(number: int, topic: str, **notes: str) -> bytes:
    """The description of a channel of the type."""
    said = b"".join(text(key) + text(value) for key, value in notes.items())
    named = (
        struct.pack("<HH", number, 1)
        + text(topic)
        + text("cdr")
        + struct.pack("<I", len(said))
        + said
    )
    return record(Opcode.CHANNEL, named)


def at(log_ns: int, data: bytes, channel: int = 1) -> bytes:
    """A message's record with its time."""
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, log_ns, log_ns) + data)


def file(*parts: bytes) -> bytes:
    """A whole file of these records alone."""
    return (
        MAGIC
        + record(Opcode.HEADER, text("ros2") + text(""))
        + b"".join(parts)
        + record(Opcode.FOOTER, bytes(20))
        + MAGIC
    )


SCHEMA = schema("a/msg/T", "float64 x")
CHANNEL = channel(1, "/t")


def mcap(*parts: bytes) -> bytes:
    """A whole file of one topic with one number."""
    return file(SCHEMA, CHANNEL, *parts)


def index(offsets: bytes) -> bytes:
    """The index of a chunk's messages."""
    return record(Opcode.MESSAGE_INDEX, struct.pack("<HI", 1, len(offsets)) + offsets)


def quickly(work: Callable[[], object]) -> object:
    """Do it within five seconds of the processor, and fail on anything but a RecordingError of one
    short line."""
    begin = time.process_time()
    try:
        return work()
    except RecordingError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1500
        return str(error)
    finally:
        assert time.process_time() - begin < 5.0
