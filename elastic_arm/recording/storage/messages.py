"""Yield the messages of a bag one by one in the order in which they were logged, as raw bytes, for
replaying and copying."""

import heapq
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from elastic_arm.recording.spans import offsets_of
from elastic_arm.recording.storage.bag import BagFile, open_bag
from elastic_arm.recording.storage.mcap_scan import McapBlock
from elastic_arm.recording.storage.metadata import Topic


class Message(NamedTuple):
    """A message: when it was logged and published, its topic and type, its CDR bytes."""

    log_ns: int
    publish_ns: int
    topic: str
    type_name: str
    data: bytes


def read_messages(
    path: str | Path | Sequence[str | Path],
    topics: Collection[str] | None = None,
    strict: bool = True,
) -> Iterator[Message]:
    """Yield the messages of one or several bags in the order in which they were logged.

    The chunks of a file are sorted one by one, and only chunks that overlap in time are in memory
    together.
    """
    paths = [path] if isinstance(path, str | Path) else list(path)
    files = [file for each in paths for file in open_bag(each).files]
    yield from heapq.merge(
        *(_of_file(file, topics, strict) for file in files), key=lambda message: message.log_ns
    )


def read_topics(path: str | Path) -> list[Topic]:
    """Return the topics of a bag, with the definitions and qualities of service that it holds."""
    return topics_of(open_bag(path).files)


def topics_of(files: Sequence[BagFile]) -> list[Topic]:
    """Return the topics of opened files.

    If a file does not list all of them, its messages are searched.
    """
    found: dict[str, Topic] = {}
    for file in files:
        if not all(topic.type_name for topic in file.channels.values()) or not file.channels:
            for _ in file.blocks(strict=False):
                pass
        for topic in file.channels.values():
            found.setdefault(topic.name, topic)
    return list(found.values())


def _of_file(file: BagFile, topics: Collection[str] | None, strict: bool) -> Iterator[Message]:
    waiting: list[tuple[int, int, int, Message]] = []
    for number, block in enumerate(file.blocks(strict)):
        for offset, message in _of_block(file, block, topics):
            heapq.heappush(waiting, (message.log_ns, number, offset, message))
        while waiting and waiting[0][0] < block.horizon_ns:
            yield heapq.heappop(waiting)[-1]
    while waiting:
        yield heapq.heappop(waiting)[-1]


def _of_block(
    file: BagFile, block: McapBlock, topics: Collection[str] | None
) -> Iterator[tuple[int, Message]]:
    for channel in block.counts():
        topic = file.topic(channel)
        if topics is not None and topic.name not in topics:
            continue
        spans = block.spans(channel)
        view = spans.buffer.data
        columns = (
            offsets_of(spans.begin),
            spans.size,
            block.log_ns(channel),
            block.publish_ns(channel),
        )
        for begin, size, log_ns, publish_ns in zip(
            *(part.tolist() for part in columns), strict=True
        ):
            data = bytes(view[begin : begin + size])
            yield begin, Message(log_ns, publish_ns, topic.name, topic.type_name, data)
