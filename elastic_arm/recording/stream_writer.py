"""Write a bag while it happens: what is older than a moment is on disk, whatever becomes of the
process."""

import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import message_types
from elastic_arm.recording.storage.mcap_scan import message_head
from elastic_arm.recording.storage.mcap_sink import Compression, McapSink, pack
from elastic_arm.recording.storage.metadata import Topic, offered_qos
from elastic_arm.recording.writing import finish_bag


class StreamWriter(AbstractContextManager["StreamWriter"]):
    """A bag being recorded, message by message, from raw CDR bytes.

    Messages gather in a chunk; it is written when it is `flush_every` seconds old or holds
    `chunk_bytes`. A killed process loses that one chunk. A power cut loses what the system had not
    carried to the disk yet: every `sync_every` seconds it is flushed, in a thread of its own, as
    that can take longer than a queue of messages lasts.
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
    ) -> None:
        self.path = Path(path)
        if os.path.exists(self.path):  # of a name that is too long Path.exists raises
            raise RecordingError(
                f"{self.path} already exists",
                "Choose another name; existing files are never overwritten.",
            )
        self._sink = McapSink(self.path / f"{self.path.name}_0.mcap", compression)
        self._flush_every = flush_every
        self._sync_every = sync_every
        self._chunk_bytes = chunk_bytes
        self._clock = clock
        self._ids: dict[str, int] = {}
        self.counts: dict[str, int] = {}  # messages taken so far, by topic
        self._syncer = ThreadPoolExecutor(1)
        self._syncing: Future[None] | None = None
        self._flushed = self._synced = clock()
        self._begin_chunk()

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str | None = None,
        type_hash: str = "",
        qos: str | None = None,
    ) -> None:
        """Announce a topic before its first message."""
        if name in self._ids:
            return
        if definition is None:
            definition, type_hash = (
                message_types.definition(type_name) if message_types.known(type_name) else ("", "")
            )
        offered = offered_qos(name) if qos is None else qos
        self._ids[name] = self._sink.add_topic(
            Topic(name, type_name, definition, type_hash, offered)
        )
        self.counts[name] = 0

    def write(self, topic: str, data: bytes, log_ns: int, publish_ns: int | None = None) -> None:
        """Take a message."""
        channel = self._ids[topic]
        sequence = self.counts[topic]
        self.counts[topic] += 1
        sent = log_ns if publish_ns is None else publish_ns
        times, offsets = self._index.setdefault(channel, ([], []))
        times.append(log_ns)
        offsets.append(self._size)
        head = message_head(len(data), channel, sequence, log_ns, sent)
        self._parts += (head, data)
        self._size += len(head) + len(data)
        if self._size >= self._chunk_bytes:
            self.flush()
        else:
            self.tick()

    def tick(self) -> None:
        """Write what is due. Call it now and then while no message comes."""
        if self._clock() - self._flushed >= self._flush_every:
            self.flush()

    def flush(self) -> None:
        """Write the chunk gathered so far.

        The system carries it to the disk if that is due.
        """
        self._write_chunk()
        idle = self._syncing is None or self._syncing.done()
        if idle and self._flushed - self._synced >= self._sync_every:
            if self._syncing is not None:
                self._syncing.result()
            self._synced = self._flushed
            self._syncing = self._syncer.submit(self._sink.sync)

    def close(self) -> None:
        """Write the rest, the summary and metadata.yaml."""
        self._syncer.shutdown()
        try:
            self._write_chunk()
            finish_bag(self._sink)
        finally:
            self._sink.close()

    def __exit__(self, *_: object) -> None:
        """Close the bag; also after an error, as what was recorded is worth keeping."""
        self.close()

    def _write_chunk(self) -> None:
        self._flushed = self._clock()
        if not self._size:
            return
        index = {
            id: (np.array(times), np.array(offsets)) for id, (times, offsets) in self._index.items()
        }
        plain = b"".join(self._parts)
        self._begin_chunk()
        self._sink.write(pack(plain, index, self._sink.compression))

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._index: dict[int, tuple[list[int], list[int]]] = {}
        self._size = 0
