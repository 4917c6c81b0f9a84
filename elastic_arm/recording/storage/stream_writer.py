"""Write a bag during recording: messages older than a moment are on the disk, even if the process
is killed.

The library `mcap` creates chunks, checksums, indexes and the summary.
"""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Literal

import yaml
from mcap.writer import CompressionType, Writer

from elastic_arm.errors import RecordingError
from elastic_arm.output_files import write_result
from elastic_arm.recording import message_types
from elastic_arm.recording.storage.bag import METADATA
from elastic_arm.recording.storage.metadata import (
    INSIDE,
    METADATA_KEY,
    Topic,
    metadata,
    offered_qos,
)
from elastic_arm.version import __version__

Compression = Literal["none", "lz4", "zstd"]
COMPRESSIONS: tuple[Compression, ...] = ("none", "lz4", "zstd")


class _WholeWrites:
    """A file that writes each piece of bytes completely or not at all, so that it ends with a
    record."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = open(path, "xb", buffering=0)  # noqa: SIM115 – closed by close()
        self.failed = False  # what follows a piece that is missing is of no use
        self.tell = self._file.tell
        self.flush = self._file.flush
        self.close = self._file.close
        self.fileno = self._file.fileno

    def write(self, data: bytes) -> int:
        """Write bytes, and take them back where the disk is full."""
        begin = self._file.tell()
        rest = memoryview(data)
        try:
            while len(rest):
                rest = rest[self._file.write(rest) :]
        except OSError:
            self.failed = True
            self._file.truncate(begin)
            raise
        return len(data)


class StreamWriter(AbstractContextManager["StreamWriter"]):
    """Records a bag message by message, from raw CDR bytes.

    Messages are collected in a chunk, which is written when it is `flush_every` seconds old or
    `chunk_bytes` long. A killed process loses only this chunk. After a power cut, data that the
    system had not yet written to the disk are also lost: every `sync_every` seconds they are
    flushed, in a separate thread, because this may take longer than a queue of messages lasts.

    `currents` are the torque channels that are motor currents times a torque constant;
    `firmware_gains` are those of servos, by joint.
    """

    def __init__(
        self,
        path: str | Path,
        compression: Compression = "zstd",
        *,
        flush_every: float = 0.25,
        sync_every: float = 5.0,
        chunk_bytes: int = 1 << 20,
        clock: Callable[[], float] = time.monotonic,
        currents: Sequence[str] = (),
        firmware_gains: Mapping[str, float] | None = None,
    ) -> None:
        self.path = Path(path)
        if compression not in COMPRESSIONS:
            raise RecordingError(
                f"unknown compression {compression!r}", f"Choose one of {', '.join(COMPRESSIONS)}."
            )
        if os.path.exists(self.path):  # of a name that is too long Path.exists raises
            raise RecordingError(
                f"{self.path} already exists",
                "Choose another name; existing files are never overwritten.",
            )
        self._name = f"{self.path.name}_0.mcap"
        try:
            self._file = _WholeWrites(self.path / self._name)
        except OSError as error:
            raise RecordingError(
                f"{self.path / self._name} cannot be written: {error.strerror}",
                "Choose another folder.",
            ) from None
        # When a chunk ends is decided here.
        self._writer = Writer(
            self._file,  # type: ignore[arg-type]
            chunk_size=2**63,
            compression=CompressionType[compression.upper()],
        )
        self._flush_every = flush_every
        self._sync_every = sync_every
        self._chunk_bytes = chunk_bytes
        self._clock = clock
        self._currents = currents
        self._firmware_gains = firmware_gains
        self._topics: list[Topic] = []
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.counts: dict[str, int] = {}  # messages taken so far, by topic
        self._first_ns: int | None = None
        self._last_ns = 0
        self._pending = 0  # bytes of messages in the chunk
        self._kept = 0  # messages in the file
        self._syncer = ThreadPoolExecutor(1)
        self._syncing: Future[None] | None = None
        self._flushed = self._synced = clock()
        self._to_disk(lambda: self._writer.start("ros2", f"elastic_arm {__version__}"))

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str | None = None,
        type_hash: str = "",
        qos: str | None = None,
    ) -> None:
        """Announce a topic before its first message."""
        if name in self._channels:
            return
        if definition is None:
            known = message_types.known(type_name)
            definition, type_hash = message_types.definition(type_name) if known else ("", "")
        offered = offered_qos(name) if qos is None else qos
        if type_name not in self._schemas:
            encoding = "ros2idl" if definition.startswith("=" * 80 + "\nIDL: ") else "ros2msg"
            self._schemas[type_name] = self._writer.register_schema(
                type_name, encoding, definition.encode()
            )
        stated = {"offered_qos_profiles": offered, "topic_type_hash": type_hash}
        self._channels[name] = self._writer.register_channel(
            name, "cdr", self._schemas[type_name], stated
        )
        self._topics.append(Topic(name, type_name, definition, type_hash, offered))
        self.counts[name] = 0

    def write(self, topic: str, data: bytes, log_ns: int, publish_ns: int | None = None) -> None:
        """Take a message."""
        sent = log_ns if publish_ns is None else publish_ns
        self._writer.add_message(self._channels[topic], log_ns, data, sent, self.counts[topic])
        self.counts[topic] += 1
        self._first_ns = log_ns if self._first_ns is None else min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)
        self._pending += len(data)
        if self._pending >= self._chunk_bytes:
            self.flush()
        else:
            self.tick()

    def tick(self) -> None:
        """Write what is due. Call it regularly while no messages arrive."""
        if self._clock() - self._flushed >= self._flush_every:
            self.flush()

    def flush(self) -> None:
        """Write the current chunk.

        If it is due, the system is asked to write it to the disk.
        """
        self._write_chunk()
        idle = self._syncing is None or self._syncing.done()
        if idle and self._flushed - self._synced >= self._sync_every:
            if self._syncing is not None:
                self._syncing.result()
            self._synced = self._flushed
            self._syncing = self._syncer.submit(self._to_disk, self._sync)

    def close(self) -> None:
        """Write the rest, the summary and metadata.yaml; nothing after the disk was full."""
        try:
            if not self._file.failed:
                self._write_chunk()
                self._finish()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without completing it."""
        self._syncer.shutdown()
        self._file.close()

    def __exit__(self, *_: object) -> None:
        """Close the bag, also after an error, to keep what was recorded."""
        self.close()

    def _write_chunk(self) -> None:
        self._flushed = self._clock()
        self._pending = 0
        self._to_disk(self._writer.flush)
        self._kept = sum(self.counts.values())

    def _finish(self) -> None:
        span = (self._first_ns or 0, self._last_ns)
        information = metadata(
            self._name, self._topics, self.counts, span, self._currents, self._firmware_gains
        )
        record, key = INSIDE
        # The same inside the file, for readers that are given it without its folder.
        inside = {key: yaml.safe_dump(information, sort_keys=False), "ROS_DISTRO": "jazzy"}
        self._to_disk(lambda: self._writer.add_metadata(record, inside))
        self._to_disk(self._writer.finish)
        self._to_disk(self._sync)
        text = yaml.safe_dump({METADATA_KEY: information}, sort_keys=False)
        remedy = "Free space, then run check --repair."
        write_result(self.path / METADATA, text, RecordingError, remedy)

    def _sync(self) -> None:
        os.fsync(self._file.fileno())

    def _to_disk(self, write: Callable[[], None]) -> None:
        """Perform an action that fails if the disk is full."""
        try:
            write()
        except OSError as error:
            raise RecordingError(
                f"{self.path / self._name} cannot be written further: {error.strerror}",
                f"The {self._kept} messages written so far are kept; free space or"
                " choose another disk.",
            ) from None
