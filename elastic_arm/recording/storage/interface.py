"""What a storage format offers: the files of a bag as blocks of messages, whatever their format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from elastic_arm.recording.spans import Offsets, Spans
from elastic_arm.recording.storage.metadata import Topic

LATEST_NS = 2**63 - 1


class Block(Protocol):
    """Messages of a file that are in memory together; channels are numbers that stand for its topics."""

    @property
    def horizon_ns(self) -> int:
        """No message of a later block was logged before this."""

    def counts(self) -> Mapping[int, int]:
        """Return how many messages of each channel there are."""

    def spans(self, channel: int) -> Spans:
        """Return where the messages of a channel lie, in file order."""

    def log_ns(self, channel: int) -> Offsets:
        """(N,) when the messages of a channel were received, ns."""

    def publish_ns(self, channel: int) -> Offsets:
        """(N,) when they were sent, ns; the log times where the format does not hold it."""


class BagFile(Protocol):
    """A file of a bag, opened."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def damage(self) -> list[str]:
        """What is wrong with it."""

    @property
    def size(self) -> int:
        """Bytes on disk."""

    def packing(self) -> set[str]:
        """Return how its messages are packed: "none", "lz4", "zstd", "unchunked"."""

    def remarks(self) -> list[str]:
        """Return what cannot be known of the file, and is no damage."""

    def currents(self) -> tuple[str, ...]:
        """Return the torque channels that the file states to be motor currents times a torque constant."""

    def topics(self) -> list[Topic]:
        """Return its topics, as far as they are known so far; some formats describe a few inside blocks alone."""

    def topic(self, channel: int) -> Topic:
        """Return the topic of a channel."""

    def expected(self, channel: int) -> int:
        """Return how many messages a channel holds, where that is known without reading them; otherwise 0."""

    def blocks(self, strict: bool = True) -> Iterator[Block]:
        """Yield the messages, block by block."""
