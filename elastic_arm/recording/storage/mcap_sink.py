"""Write MCAP files chunk by chunk: every chunk on disk is readable, whatever happens after.

The records are those of the library `mcap`. The writer of rosbags serves bags that are written in
one go: it takes message by message in one thread, has no checksums and no lz4, does not have the
system carry chunks to the disk, and leaves a torn record where the disk is full.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Literal

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from elastic_arm.errors import RecordingError
from elastic_arm.recording.storage.mcap import MAGIC
from elastic_arm.recording.storage.mcap_scan import Offsets
from elastic_arm.recording.storage.metadata import FileSummary, Topic
from elastic_arm.version import __version__

Compression = Literal["none", "lz4", "zstd"]
COMPRESSIONS: tuple[Compression, ...] = ("none", "lz4", "zstd")
_COMPRESSED: dict[Compression, Callable[[bytes | memoryview], bytes | memoryview]] = {
    "none": lambda plain: plain,
    "lz4": lz4.frame.compress,
    "zstd": lambda plain: zstandard.ZstdCompressor(level=-1).compress(plain),
}


@dataclass(frozen=True)
class Packed:
    """A chunk ready to be written, with log times and places of its messages by channel."""

    data: bytes | memoryview
    size: int
    crc: int
    index: dict[int, tuple[Offsets, Offsets]]


def pack(
    plain: bytes | memoryview, index: dict[int, tuple[Offsets, Offsets]], compression: Compression
) -> Packed:
    """Compress the records of a chunk.

    Threads may share the work: it leaves the interpreter's lock.
    """
    return Packed(_COMPRESSED[compression](plain), len(plain), zlib.crc32(plain), index)


class McapSink:
    """An MCAP file being written."""

    def __init__(self, path: Path, compression: Compression) -> None:
        if compression not in COMPRESSIONS:
            raise RecordingError(
                f"unknown compression {compression!r}", f"Choose one of {', '.join(COMPRESSIONS)}."
            )
        self.path = path
        self.compression: Compression = compression
        self.topics: list[Topic] = []
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._end = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(path, "xb", buffering=0)  # noqa: SIM115 – closed by close()
        except FileExistsError:
            raise RecordingError(
                f"{path} already exists",
                "Choose another name; existing files are never overwritten.",
            ) from None
        except OSError as error:
            raise RecordingError(
                f"{path} cannot be written: {error.strerror}", "Choose another folder."
            ) from None
        self._write(MAGIC + _bytes(Header("ros2", f"elastic_arm {__version__}")))

    def add_topic(self, topic: Topic) -> int:
        """Announce a topic; returns its channel id."""
        if topic.type_name not in self._schemas:
            encoding = "ros2idl" if topic.definition.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
            schema = Schema(
                len(self._schemas) + 1, topic.definition.encode(), encoding, topic.type_name
            )
            self._schemas[topic.type_name] = schema
            self._write(_bytes(schema))
        metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        channel = Channel(
            len(self._channels) + 1, topic.name, "cdr", metadata, self._schemas[topic.type_name].id
        )
        self._channels.append(channel)
        self.topics.append(topic)
        self._write(_bytes(channel))
        return channel.id

    def write(self, chunk: Packed) -> None:
        """Write a chunk and its message indexes, whole or not at all."""
        if not chunk.index:
            return
        times = np.concatenate([own for own, _ in chunk.index.values()])
        start = int(times.min())
        end = int(times.max())
        name = b"" if self.compression == "none" else self.compression.encode()
        head = struct.pack(
            f"<QQQII{len(name)}sQ",
            start,
            end,
            chunk.size,
            chunk.crc,
            len(name),
            name,
            len(chunk.data),
        )
        begin = self._end
        length = 9 + len(head) + len(chunk.data)
        indexes = [_message_index(channel, *entries) for channel, entries in chunk.index.items()]
        *places, behind = accumulate(map(len, indexes), initial=begin + length)
        self._write(struct.pack("<BQ", Opcode.CHUNK, length - 9) + head, chunk.data, *indexes)
        self._counts.update({channel: len(own) for channel, (own, _) in chunk.index.items()})
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=begin,
                compression=name.decode(),
                compressed_size=len(chunk.data),
                message_end_time=end,
                message_index_length=behind - begin - length,
                message_index_offsets=dict(zip(chunk.index, places, strict=True)),
                message_start_time=start,
                uncompressed_size=chunk.size,
            )
        )

    def summary(self) -> FileSummary:
        """Return what was written so far."""
        return FileSummary(
            self.path.name,
            min((chunk.message_start_time for chunk in self._chunks), default=0),
            max((chunk.message_end_time for chunk in self._chunks), default=0),
            {channel.topic: self._counts[channel.id] for channel in self._channels},
        )

    def add_metadata(self, name: str, content: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _bytes(Metadata(name, content))
        self._metadata.append(MetadataIndex(self._end, len(record), name))
        self._write(record)

    def sync(self) -> None:
        """Have the system carry what was written to the disk itself."""
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._failed(error) from None

    def finish(self) -> None:
        """Write the summary and close the file."""
        try:
            self._write(_bytes(DataEnd(0)))
            self._write(self._summary_section())
            self.sync()
        finally:
            self._file.close()

    def close(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.close()

    def _summary_section(self) -> bytes:
        written = self.summary()
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=written.end_ns,
            message_start_time=written.start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        content = b""
        offsets = b""
        for opcode, members in groups:
            section = b"".join(_bytes(record) for record in members)
            if section:
                start = self._end + len(content)
                offsets += _bytes(
                    SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(section))
                )
            content += section
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, self._end, self._end + len(content))
        crc = zlib.crc32(content + offsets + footer)
        return content + offsets + _bytes(Footer(self._end, self._end + len(content), crc)) + MAGIC

    def _write(self, *parts: bytes | memoryview) -> None:
        begin = self._end
        try:
            for part in parts:
                rest = memoryview(part)
                while len(rest):
                    rest = rest[self._file.write(rest) :]
                self._end += len(part)
        except OSError as error:
            # A torn record is taken back, so that the file ends with a whole one.
            self._end = begin
            self._file.seek(begin)
            self._file.truncate(begin)
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{self.path} cannot be written further: {error.strerror}",
            f"The {self._counts.total()} messages written so far are kept; free space or"
            " choose another disk.",
        )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def _message_index(channel: int, times: Offsets, offsets: Offsets) -> bytes:
    entries = np.column_stack([times, offsets]).astype("<u8")
    return (
        struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
        + entries.tobytes()
    )
