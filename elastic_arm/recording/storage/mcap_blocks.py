"""The messages of a chunk of an MCAP file, by channel, and where they lie without a walk from record to record."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from mcap.opcode import Opcode

from elastic_arm.recording.spans import Bytes, Offsets, Spans, column, progression, shifted
from elastic_arm.recording.storage.mcap_scan import HEAD_WORDS, MESSAGE_HEAD, RECORD_HEAD, Record

LATEST_NS = 2**63 - 1


@dataclass(frozen=True)
class McapBlock:
    """The messages of one chunk, of an unchunked file, or of rows laid out as such."""

    buffer: Bytes  # plain bytes
    messages: dict[int, Offsets]  # where the message records begin, by channel
    horizon_ns: int = LATEST_NS  # no message of a later block was logged before this
    _where: dict[int, Offsets | slice] = field(default_factory=dict)
    _sizes: dict[int, Offsets] = field(default_factory=dict)

    def counts(self) -> dict[int, int]:
        """Return how many messages of each channel there are."""
        return {channel: len(offsets) for channel, offsets in self.messages.items()}

    def where(self, channel: int) -> Offsets | slice:
        """The records of a channel; a slice where they are equally spaced."""
        if channel not in self._where:
            self._where[channel] = progression(self.messages[channel])
        return self._where[channel]

    def sizes(self, channel: int) -> Offsets:
        """(N,) lengths of the records of a channel, without their heads."""
        if channel not in self._sizes:
            self._sizes[channel] = column(self.buffer, "<u8", self.where(channel), 1).astype(np.int64)
        return self._sizes[channel]

    def log_ns(self, channel: int) -> Offsets:
        """(N,) log times of the messages of a channel."""
        return column(self.buffer, "<u8", self.where(channel), 15).astype(np.int64)

    def publish_ns(self, channel: int) -> Offsets:
        """(N,) times at which the messages of a channel were sent."""
        return column(self.buffer, "<u8", self.where(channel), 23).astype(np.int64)

    def spans(self, channel: int) -> Spans:
        """Return where the messages of a channel lie, behind the heads of their records."""
        sizes = self.sizes(channel) - (MESSAGE_HEAD - RECORD_HEAD)
        return Spans(self.buffer, shifted(self.where(channel), MESSAGE_HEAD), sizes)


def repeated(before: McapBlock | None, plain: Bytes, horizon_ns: int) -> McapBlock | None:
    """Return the messages of a chunk if they come as regularly as in the one before, and fill it; None if they do not.

    Their heads alone are read: that spares most of what there is to do with indexes.
    """
    if before is None or not _in_turn(before):
        return None
    block = McapBlock(plain, {}, horizon_ns)
    covered = 0
    for channel in before.messages:
        where, size = before.where(channel), int(before.sizes(channel)[0])
        if not isinstance(where, slice) or where.start + RECORD_HEAD + size > len(plain):
            return None
        last = len(plain) - RECORD_HEAD - size
        again = slice(where.start, where.start + (last - where.start) // where.step * where.step + 1, where.step)
        for dtype, at in HEAD_WORDS:
            if not (column(plain, dtype, again, at) == column(before.buffer, dtype, where, at)[0]).all():
                return None
        block.messages[channel], block._where[channel] = np.arange(again.start, again.stop, again.step), again
        block._sizes[channel] = np.full(len(block.messages[channel]), size)
        covered += len(block.messages[channel]) * (RECORD_HEAD + size)
    return block if covered == len(plain) else None


def _in_turn(block: McapBlock) -> bool:
    """Whether the channels send one message each in every round, and the first ones lie end to end over a round."""
    places = [(block.where(channel), int(block.sizes(channel)[0])) for channel in block.messages]
    turn = sorted((where.start, size, where.step) for where, size in places if isinstance(where, slice))
    at = 0
    for start, size, _ in turn:
        if start != at:
            return False
        at += RECORD_HEAD + size
    return len(turn) == len(places) and all(step == at for _, _, step in turn)


def indexed(file: Bytes, indexes: list[Record], plain: Bytes, horizon_ns: int) -> McapBlock | None:
    """Return the messages of a chunk by its indexes; None unless these account for every byte of it.

    Where topics come in no regular turn this spares the walk from record to record.
    """
    block = McapBlock(plain, {}, horizon_ns)
    for _, begin, end in indexes:
        channel = int.from_bytes(file[begin : begin + 2], "little")
        offsets = np.frombuffer(file[begin + 6 : end].tobytes(), "<u8")[1::2].astype(np.int64)
        if not len(offsets):
            continue
        offsets = offsets if (offsets[1:] > offsets[:-1]).all() else np.unique(offsets)
        if channel in block.messages or offsets[0] < 0 or offsets[-1] > len(plain) - MESSAGE_HEAD:
            return None
        block.messages[channel] = offsets
        where = block.where(channel)
        heads = (column(plain, "u1", where) == Opcode.MESSAGE) & (column(plain, "<u2", where, 9) == channel)
        if not heads.all():
            return None
        # Lengths of up to 2^63 - 1 are claimed: none may be added to anything before it is known to be small.
        size = block.sizes(channel)
        if size.min() < MESSAGE_HEAD - RECORD_HEAD or size.max() > len(plain):
            return None
    return block if _end_to_end(block) else None


def _end_to_end(block: McapBlock) -> bool:
    """Whether the records lie end to end from the first byte to the last.

    They do if as many end as begin at every byte between: then exactly one lies over each.
    """
    begins = [*block.messages.values(), np.array([len(block.buffer)])]
    ends = [np.array([0]), *(where + RECORD_HEAD + block.sizes(channel) for channel, where in block.messages.items())]
    return np.array_equal(np.sort(np.concatenate(begins)), np.sort(np.concatenate(ends)))
