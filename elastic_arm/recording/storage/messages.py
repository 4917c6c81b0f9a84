"""The messages of a bag one by one, in the order they were logged, as raw bytes: for replaying and copying."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.records import Schema

from elastic_arm.recording.storage.bag import open_bag
from elastic_arm.recording.storage.mcap import Block, McapFile
from elastic_arm.recording.storage.mcap_scan import MESSAGE_HEAD, column
from elastic_arm.recording.storage.metadata import Topic


class Message(NamedTuple):
    """A message: when it was logged and published, its topic and type, its CDR bytes."""

    log_ns: int
    publish_ns: int
    topic: str
    type_name: str
    data: bytes


def read_messages(
    path: str | Path | Sequence[str | Path], topics: Collection[str] | None = None, strict: bool = True
) -> Iterator[Message]:
    """Yield the messages of one or several bags in the order they were logged.

    Within a file chunks are taken as they follow each other, and each is sorted; only chunks that overlap in time
    are held together, so memory stays small.

    Parameters
    ----------
    path
        A bag, or several that are merged.
    topics
        Those wanted; all by default.
    strict
        Raise for a damaged chunk; otherwise skip it.

    Raises
    ------
    RecordingError
        If a bag cannot be read.
    """
    paths = [path] if isinstance(path, str | Path) else list(path)
    files = [file for each in paths for file in open_bag(each).files]
    yield from heapq.merge(*(_of_file(file, topics, strict) for file in files), key=lambda message: message.log_ns)


def read_topics(path: str | Path) -> list[Topic]:
    """Return the topics of a bag, with the definitions and qualities of service that it holds.

    Raises
    ------
    RecordingError
        If the bag cannot be read.
    """
    found: dict[str, Topic] = {}
    for file in open_bag(path).files:
        if any(channel.schema_id not in file.schemas for channel in file.channels.values()) or not file.channels:
            for _ in file.blocks(strict=False):
                pass
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id, Schema(0, b"", "", ""))
            offered = channel.metadata.get("offered_qos_profiles", "")
            type_hash = channel.metadata.get("topic_type_hash", "")
            definition = schema.data.decode(errors="replace")
            found.setdefault(channel.topic, Topic(channel.topic, schema.name, definition, type_hash, offered))
    return list(found.values())


def _of_file(file: McapFile, topics: Collection[str] | None, strict: bool) -> Iterator[Message]:
    starts = np.array([chunk.start_ns for chunk in file.chunks], np.int64)
    # No later block begins before this: what is older can go out.
    horizon = np.minimum.accumulate(starts[::-1])[::-1].tolist()
    if not len(file.loose):
        horizon = horizon[1:]
    waiting: list[tuple[int, int, int, Message]] = []
    for number, block in enumerate(file.blocks(strict)):
        for offset, message in _of_block(file, block, topics):
            heapq.heappush(waiting, (message.log_ns, number, offset, message))
        while number < len(horizon) and waiting and waiting[0][0] < horizon[number]:
            yield heapq.heappop(waiting)[-1]
    while waiting:
        yield heapq.heappop(waiting)[-1]


def _of_block(file: McapFile, block: Block, topics: Collection[str] | None) -> Iterator[tuple[int, Message]]:
    view = block.buffer.data
    for channel_id, offsets in block.messages.items():
        topic, type_name = file.topic(channel_id)
        if topics is not None and topic not in topics:
            continue
        published = column(block.buffer, "<u8", offsets, 23)
        columns = (offsets, block.sizes(channel_id), block.log_ns(channel_id), published)
        for offset, size, log_ns, publish_ns in zip(*(part.tolist() for part in columns), strict=True):
            data = bytes(view[offset + MESSAGE_HEAD : offset + MESSAGE_HEAD + size])
            yield offset, Message(log_ns, publish_ns, topic, type_name, data)
