"""Open MCAP files, whole or torn, and hand out their messages by channel."""

import errno
import mmap
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from elastic_arm.codegen.parallel import ahead
from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.spans import Bytes, Offsets, by_value, column
from elastic_arm.recording.storage.mcap_scan import (
    LATEST_NS,
    RECORD_HEAD,
    McapBlock,
    Record,
    Scan,
    give_back,
    indexed,
    repeated,
    scan,
)
from elastic_arm.recording.storage.metadata import (
    INSIDE,
    StoredFile,
    Topic,
    plain_data,
    stated_currents,
    stated_gains,
)
from elastic_arm.recording.storage.unpacking import PACKED_FILES, unpack_chunk, unpack_file

MAGIC = b"\x89MCAP0\r\n"
# first and last time, plain size, checksum, length of the compression's name
_CHUNK_HEAD = struct.Struct("<QQQII")
_PARSED: dict[int, Any] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.STATISTICS: records.Statistics,
}
# What reading a record raises whose bytes are not what its kind promises.
_BAD_RECORD = (McapError, ValueError, KeyError, IndexError, OverflowError, struct.error)
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL)  # besides messages


class _RecordStream(ReadDataStream):
    """The content of a record; the library would take a text that is cut off for a whole one."""

    def read(self, length: int) -> bytes:
        """Return the next bytes, all of them."""
        data = super().read(length)
        if len(data) < length:
            raise ValueError(f"expected {length} bytes, found {len(data)}")
        return data


class Chunk(NamedTuple):
    """The bytes of a chunk, how they are packed, and its message indexes in the file."""

    begin: int
    end: int
    size: int
    crc: int
    compression: str
    start_ns: int
    end_ns: int
    indexes: list[Record]
    torn: bool = False  # where the file ends within it


@dataclass
class McapFile(StoredFile):
    """An MCAP file: what is in it, and its messages block by block."""

    buffer: Bytes = field(default_factory=lambda: np.empty(0, np.uint8))
    chunks: list[Chunk] = field(default_factory=list)  # in file order
    statistics: records.Statistics | None = None  # from the summary; None where there is none
    notes: list[Record] = field(default_factory=list)  # where metadata records lie
    # messages outside of chunks
    loose: Offsets = field(default_factory=lambda: np.empty(0, np.int64))
    # name, definition and its language
    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    _before: McapBlock | None = None  # the chunk before, if all its bytes are messages

    def packing(self) -> set[str]:
        """Return how its chunks are packed."""
        kinds = {chunk.compression or "none" for chunk in self.chunks}
        return kinds | ({"unchunked"} if len(self.loose) else set())

    def check_lengths(self) -> None:
        claimed = (chunk.size for chunk in self.chunks if chunk.compression)
        total = sum(size for size in claimed if size <= limits.chunk_bytes())
        limit = limits.unpacked_bytes()
        if total > limit:
            raise RecordingError(
                f"{self.path} unpacks to {total // limits.MEGABYTE} MB, the limit is"
                f" {limit // limits.MEGABYTE} MB",
                "If you trust it, raise the limit: set ELASTIC_ARM_MAX_UNPACKED_MB.",
            )

    def currents(self) -> tuple[str, ...]:
        """Return what rosbag2's metadata in the file states."""
        return stated_currents(self._information())

    def firmware_gains(self) -> dict[str, float]:
        """Return what rosbag2's metadata in the file states."""
        return stated_gains(self._information())

    def _information(self) -> object:
        """Return rosbag2's metadata in the file; None where there is none."""
        for _, begin, end in self.notes:
            try:
                record = records.Metadata.read(
                    _RecordStream(BytesIO(self.buffer[begin:end].tobytes()))
                )
            except _BAD_RECORD:
                continue  # of another program, or damaged: the messages do without it
            if record.name == INSIDE[0]:
                return plain_data(record.metadata.get(INSIDE[1], ""))
        return None

    def expected(self, channel: int) -> int:
        """Return what the summary promises."""
        return (
            self.statistics.channel_message_counts.get(channel, 0)
            if self.statistics is not None
            else 0
        )

    def blocks(self, strict: bool = True) -> Iterator[McapBlock]:
        """Yield the messages block by block in file order.

        Threads unpack slow chunks ahead.
        """
        self._before = None
        starts = np.array([*(chunk.start_ns for chunk in self.chunks), LATEST_NS], np.int64)
        first, *horizons = np.minimum.accumulate(starts[::-1])[::-1].tolist()
        if len(self.loose):
            yield self._block(self.buffer, Scan(self.loose, [], len(self.buffer)), first)
        for chunk, unpacked, horizon in zip(
            self.chunks, self._unpacked_chunks(), horizons, strict=True
        ):
            block = (
                unpacked
                if isinstance(unpacked, RecordingError)
                else self._chunk_block(chunk, unpacked, horizon)
            )
            if not isinstance(block, RecordingError):
                yield block
            elif strict:
                raise block
            elif block.problem not in self.damage:  # as after an earlier look
                self.damage.append(block.problem)
            give_back(
                self.buffer, chunk.begin, chunk.indexes[-1].end if chunk.indexes else chunk.end
            )

    def _unpacked_chunks(self) -> Iterator[Bytes | RecordingError]:
        """Yield the plain bytes of each chunk, or why there are none."""
        # Unpacking and the checksum are all that is handed over: they do without the interpreter,
        # which many small steps in two threads would keep taking from each other. Checksums and
        # lz4, which take no longer than the way of the bytes from one core to another, are not
        # worth it.
        slow = any(chunk.compression == "zstd" for chunk in self.chunks)
        yield from (ahead if slow else map)(self._unpack, self.chunks)

    def _unpack(self, chunk: Chunk) -> Bytes | RecordingError:
        try:
            packed = self.buffer[chunk.begin : chunk.end]
            plain = unpack_chunk(packed, chunk.compression, chunk.size, torn=chunk.torn)
        except (RuntimeError, ValueError, MemoryError, zstandard.ZstdError) as error:
            return self._chunk_error(chunk, str(error))
        if chunk.torn:
            return plain
        if len(plain) != chunk.size or (chunk.crc and zlib.crc32(plain.data) != chunk.crc):
            return self._chunk_error(chunk, "its checksum does not match")
        return plain

    def _chunk_block(
        self, chunk: Chunk, plain: Bytes, horizon_ns: int
    ) -> McapBlock | RecordingError:
        try:
            self._before = repeated(self._before, plain, horizon_ns) or indexed(
                self.buffer, chunk.indexes, plain, horizon_ns
            )
            if self._before is not None:
                return self._before
            found = scan(plain, 0, len(plain))
            self._parse([record for record in found.others if record.opcode in _IN_CHUNKS], plain)
        except _BAD_RECORD as error:
            return self._chunk_error(chunk, f"an invalid record in it: {error}")
        if found.end < len(plain) and not chunk.torn:
            return self._chunk_error(chunk, f"bytes after {found.end} in it are not MCAP records")
        return self._block(plain, found, horizon_ns)

    def _chunk_error(self, chunk: Chunk, reason: str) -> RecordingError:
        return RecordingError(
            f"{self.path}: the chunk at byte {chunk.begin} is damaged ({reason})",
            f"Save the undamaged parts with: elastic-arm bag check --repair {self.path}",
        )

    def _block(self, buffer: Bytes, found: Scan, horizon_ns: int) -> McapBlock:
        rows = by_value(column(buffer, "<u2", found.messages, 9))
        return McapBlock(
            buffer, {channel: found.messages[where] for channel, where in rows.items()}, horizon_ns
        )

    def _parse(self, others: list[Record], buffer: Bytes) -> None:
        if sum(record.opcode in _IN_CHUNKS for record in others) > limits.RECORDS:
            raise ValueError(f"more than {limits.RECORDS} descriptions of channels")
        for found in others:
            opcode, begin, end = found
            if opcode == Opcode.CHUNK:
                self.chunks.append(_chunk(buffer, begin, end))
            elif opcode == Opcode.MESSAGE_INDEX and self.chunks:
                self.chunks[-1].indexes.append(found)
            elif opcode == Opcode.METADATA:
                self.notes.append(found)
            elif opcode in _PARSED:
                self._keep(
                    _PARSED[opcode].read(_RecordStream(BytesIO(buffer[begin:end].tobytes())))
                )

    def _keep(self, record: records.McapRecord) -> None:
        match record:
            case records.Schema():
                self.schemas[record.id] = (
                    record.name,
                    record.data.decode(errors="replace"),
                    record.encoding,
                )
            case records.Channel():
                stated = record.metadata
                name, text, encoding = self.schemas.get(record.schema_id, ("", "", ""))
                hashed = stated.get("topic_type_hash", "")
                qos = stated.get("offered_qos_profiles", "")
                self.channels[record.id] = Topic(record.topic, name, text, hashed, qos, encoding)
                if len(self.channels) > limits.CHANNELS:
                    raise ValueError(f"more than {limits.CHANNELS} channels")
            case records.Statistics():
                self.statistics = record


def open_mcap(path: Path) -> McapFile:
    """Open an MCAP file; a torn one too, with its damage noted."""
    try:
        if path.suffix in PACKED_FILES:  # rosbag2's file compression
            buffer = np.frombuffer(unpack_file(path, limits.unpacked_bytes()), np.uint8)
        else:
            with path.open(
                "rb"
            ) as opened:  # of the file only those bytes stand in memory that are looked at
                size = path.stat().st_size
                content = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
            buffer = np.frombuffer(content, np.uint8)
    except OSError as error:
        remedy = "Check the path and its permissions."
        if error.errno == errno.ENOMEM:
            remedy = (
                f"It needs {path.stat().st_size / 1e6:.0f} MB of address space: raise"
                " the limit (ulimit -v)."
            )
        raise RecordingError(f"{path} cannot be read: {error}", remedy) from None
    if not len(buffer):
        raise RecordingError(f"{path} is empty", "Record again: nothing was written.")
    if buffer[:8].tobytes() != MAGIC:
        raise RecordingError(
            f"{path} is not an MCAP file", "Give a rosbag2 folder, an .mcap or a .db3 file."
        )
    file = McapFile(path, buffer=buffer)
    whole = len(buffer) >= 16 and buffer[-8:].tobytes() == MAGIC
    try:
        most = limits.RECORDS + len(buffer) // limits.RECORD_BYTES
        found = scan(buffer, 8, len(buffer) - 8 if whole else len(buffer), most)
        file._parse(found.others, buffer)
        give_back(buffer, 0, len(buffer))
    except _BAD_RECORD as error:
        raise RecordingError(f"{path} has a damaged record ({error})", "Record again.") from None
    file.loose = found.messages
    if not whole:
        torn = len(buffer) - found.end
        if torn and buffer[found.end] == Opcode.CHUNK:  # what is in it is read up to the tear
            with suppress(*_BAD_RECORD):
                file.chunks.append(_chunk(buffer, found.end + RECORD_HEAD, len(buffer), torn=True))
        file.damage.append(
            f"{path}: no summary at the end"
            + (f" and a truncated record of {torn} bytes" if torn else "")
        )
    elif found.end < len(buffer) - 8:
        file.damage.append(f"{path}: bytes after {found.end} are not MCAP records")
    return file


def _chunk(buffer: Bytes, begin: int, end: int, *, torn: bool = False) -> Chunk:
    start_ns, end_ns, size, crc, name_size = _CHUNK_HEAD.unpack(
        buffer[begin:end][: _CHUNK_HEAD.size].tobytes()
    )
    at = begin + _CHUNK_HEAD.size + name_size + 8
    compression = buffer[begin + _CHUNK_HEAD.size : at - 8].tobytes().decode()
    packed = int.from_bytes(buffer[at - 8 : at], "little")
    if at > end or (at + packed > end and not torn):
        raise ValueError(f"a chunk at byte {begin} that is longer than its record")
    if max(start_ns, end_ns) > LATEST_NS:
        raise ValueError(f"a chunk at byte {begin} with times after the year 2262")
    return Chunk(at, min(at + packed, end), size, crc, compression, start_ns, end_ns, [], torn)
