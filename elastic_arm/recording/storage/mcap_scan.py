"""The records of MCAP: lay messages as such, and find those of a byte string without a Python step per message.

An MCAP file, and each chunk in it once decompressed, is a run of records: one byte of kind, eight of length, content.
Recorders write their topics in turn, so the same few records come round and round: after a short walk the round is
known, and whole arrays of rounds are checked at once. Where the pattern breaks the walk goes on.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from elastic_arm.recording import limits
from elastic_arm.recording.spans import Bytes, Offsets, Spans, column, place, progression, shifted

RECORD_HEAD = 9  # kind and length
MESSAGE_HEAD = 31  # kind, length, channel, sequence, log time, publish time
LATEST_NS = 2**63 - 1
_MESSAGE = struct.Struct("<BQHIQQ")
_HEAD = struct.Struct("<BQ")
# Kind, length and channel, which are the same in each round: eleven bytes as two overlapping words.
_HEAD_WORDS = (("<u4", 0), ("<u8", 3))
_SHORTEST = MESSAGE_HEAD - RECORD_HEAD  # of a message's record
_WALK = 24  # messages walked before a round is looked for
_LONGEST_ROUND = 8


def message_head(size: int, channel: int, sequence: int, log_ns: int, publish_ns: int) -> bytes:
    """Return the head of a message's record."""
    length = MESSAGE_HEAD - RECORD_HEAD + size
    return _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, log_ns, publish_ns)


def lay_messages(
    buffer: Bytes, offsets: Offsets, message: bytes, *, channel: int, first: int, stamp_ns: Offsets
) -> Offsets | slice:
    """Lay records that all hold the same message into a buffer, and return where the messages begin."""
    where = progression(offsets)
    record = message_head(len(message), channel, 0, 0, 0) + message
    place(buffer, where, 0, np.frombuffer(record, f"V{len(record)}"))
    place(buffer, where, 11, np.arange(first, first + len(offsets), dtype="<u4"))
    place(buffer, where, 15, stamp_ns)
    place(buffer, where, 23, stamp_ns)
    return shifted(where, MESSAGE_HEAD)


class Record(NamedTuple):
    """A record that is no message: its kind, and where its content begins and ends."""

    opcode: int
    begin: int
    end: int


@dataclass(frozen=True)
class Scan:
    """The records of a byte string."""

    messages: Offsets  # where each message record begins, in order
    others: list[Record]  # all other records, in order
    end: int  # where the last whole record ends: less than requested if the bytes are torn
    in_turn: bool = True  # whether most messages come in rounds, and need no walk from record to record


def scan(buffer: Bytes, begin: int, end: int, most: int = limits.RECORDS) -> Scan:
    """Find all records between `begin` and `end`; stops before a torn one, or one that is shorter than its kind."""
    view = buffer.data
    found: list[Offsets] = []
    walked: list[int] = []
    others: list[Record] = []
    at, look, leaps = begin, _WALK, 0
    while at + RECORD_HEAD <= end:
        opcode, size = _HEAD.unpack_from(view, at)
        after = at + RECORD_HEAD + size
        if opcode == 0 or after > end or (opcode == Opcode.MESSAGE and size < _SHORTEST):
            break
        if opcode == Opcode.MESSAGE:
            walked.append(at)
            if len(walked) == look:
                found.append(np.array(walked, np.int64))
                leapt = _leap(buffer, walked[-_WALK:], after, end)
                # A pattern that does not hold is not worth looking for at every turn.
                look = min(4 * look, 4096) if len(leapt) < look else _WALK
                leaps += len(leapt)
                if len(leapt):
                    found.append(leapt)
                    after = int(leapt[-1]) + RECORD_HEAD + _HEAD.unpack_from(view, int(leapt[-1]))[1]
                walked = []
        else:
            others.append(Record(opcode, at + RECORD_HEAD, after))
            if len(others) > most:
                raise ValueError(f"more than {most} records that are no messages")
            # A round must not leap over what is no message, so the walk begins anew behind it.
            if walked:
                found.append(np.array(walked, np.int64))
                walked = []
        at = after
    messages = np.concatenate([*found, np.array(walked, np.int64)])
    return Scan(messages, others, at, 2 * leaps > len(messages))


def _leap(buffer: Bytes, walked: list[int], at: int, end: int) -> Offsets:
    """Return the messages that follow at `at` as long as they repeat the round of the `walked` ones."""
    starts = np.array([*walked, at], np.int64)
    keys = [column(buffer, dtype, starts[:-1], at) for dtype, at in _HEAD_WORDS]
    steps = np.diff(starts)
    for length in range(1, _LONGEST_ROUND + 1):
        if all(np.array_equal(part[length:], part[:-length]) for part in (*keys, steps)):
            break
    else:
        return np.empty(0, np.int64)
    slots = np.concatenate([[0], np.cumsum(steps[-length:])])
    stride = int(slots[-1])
    rounds, most, batch = 0, (end - at) // stride, 8192  # 8192 rounds checked at first; more each time they hold
    while rounds < most:
        count = min(batch, most - rounds)
        first = at + rounds * stride
        held = count
        for index, slot in enumerate(slots[:-1], start=_WALK - length):
            spot = slice(first + int(slot), first + int(slot) + (count - 1) * stride + 1, stride)
            for part, (dtype, offset) in zip(keys, _HEAD_WORDS, strict=True):
                equal = column(buffer, dtype, spot, offset) == part[index]
                held = min(held, count if equal.all() else int(np.argmin(equal)))
        rounds += held
        if held < count:
            break
        batch *= 4
    return (at + stride * np.arange(rounds)[:, None] + slots[None, :-1]).ravel()


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
