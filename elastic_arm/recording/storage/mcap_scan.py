"""Find the records in the bytes of an MCAP file.

An MCAP file, and each chunk in it after decompression, is a sequence of records: one byte of kind,
eight bytes of length, content. The messages of a chunk are found without a Python step for each
message: recorders write their topics in turn, so a chunk usually repeats the pattern of the
previous one; otherwise its indexes are used. If the indexes are incomplete, and outside of chunks,
the records are walked through one by one.
"""

import mmap
import struct
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from elastic_arm.recording import limits
from elastic_arm.recording.spans import Bytes, Offsets, Spans, column, progression, shifted

RECORD_HEAD = 9  # kind and length
MESSAGE_HEAD = 31  # kind, length, channel, sequence, log time, publish time
LATEST_NS = 2**63 - 1
_HEAD = struct.Struct("<BQ")
# Kind, length and channel, which are the same in each round: eleven bytes as two overlapping words.
_HEAD_WORDS = (("<u4", 0), ("<u8", 3))
_LOOKED = 1 << 26  # bytes that are looked at before the system takes them back


class Record(NamedTuple):
    """A record other than a message: its kind, and begin and end of its content."""

    opcode: int
    begin: int
    end: int


@dataclass(frozen=True)
class Scan:
    """The records found in bytes."""

    messages: Offsets  # where each message record begins, in order
    others: list[Record]  # all other records, in order
    end: int  # where the last whole record ends: less than requested if the bytes are torn


def scan(buffer: Bytes, begin: int, end: int, most: int = limits.RECORDS) -> Scan:
    """Find all records between `begin` and `end`, up to one that is cut off or too short."""
    view = buffer.data
    at = begin
    given = begin
    messages: list[int] = []
    others: list[Record] = []
    while at + RECORD_HEAD <= end:
        opcode, size = _HEAD.unpack_from(view, at)
        after = at + RECORD_HEAD + size
        if (
            opcode == 0
            or after > end
            or (opcode == Opcode.MESSAGE and size < MESSAGE_HEAD - RECORD_HEAD)
        ):
            break
        if opcode == Opcode.MESSAGE:
            messages.append(at)
        else:
            others.append(Record(opcode, at + RECORD_HEAD, after))
            if len(others) > most:
                raise ValueError(f"more than {most} records other than messages")
        at = after
        if at - given > _LOOKED:
            give_back(buffer, given, at)
            given = at
    return Scan(np.array(messages, np.int64), others, at)


def give_back(buffer: Bytes, begin: int, end: int) -> None:
    """Release the memory of bytes that have been read.

    The system reads them again when they are needed.
    """
    mapping = getattr(buffer.base, "obj", None)
    if isinstance(mapping, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        begin = begin // mmap.PAGESIZE * mmap.PAGESIZE
        mapping.madvise(mmap.MADV_DONTNEED, begin, end - begin)


@dataclass(frozen=True)
class McapBlock:
    """The messages of one chunk, of a file without chunks, or of rows in the same layout."""

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
            self._sizes[channel] = column(self.buffer, "<u8", self.where(channel), 1).astype(
                np.int64
            )
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
    """Return the messages of a chunk if they repeat the pattern of the previous chunk and fill the
    chunk; None otherwise.

    Only the heads of the messages are read, which is much faster than reading the indexes.
    """
    if before is None or not _in_turn(before):
        return None
    block = McapBlock(plain, {}, horizon_ns)
    covered = 0
    for channel in before.messages:
        where = before.where(channel)
        size = int(before.sizes(channel)[0])
        if not isinstance(where, slice) or where.start + RECORD_HEAD + size > len(plain):
            return None
        last = len(plain) - RECORD_HEAD - size
        again = slice(
            where.start,
            where.start + (last - where.start) // where.step * where.step + 1,
            where.step,
        )
        for dtype, at in _HEAD_WORDS:
            if not (
                column(plain, dtype, again, at) == column(before.buffer, dtype, where, at)[0]
            ).all():
                return None
        block.messages[channel] = np.arange(again.start, again.stop, again.step)
        block._where[channel] = again
        block._sizes[channel] = np.full(len(block.messages[channel]), size)
        covered += len(block.messages[channel]) * (RECORD_HEAD + size)
    return block if covered == len(plain) else None


def _in_turn(block: McapBlock) -> bool:
    """Return whether each channel sends one message per round, and the messages of the first round
    are contiguous."""
    places = [(block.where(channel), int(block.sizes(channel)[0])) for channel in block.messages]
    turn = sorted(
        (where.start, size, where.step) for where, size in places if isinstance(where, slice)
    )
    at = 0
    for start, size, _ in turn:
        if start != at:
            return False
        at += RECORD_HEAD + size
    return len(turn) == len(places) and all(step == at for _, _, step in turn)


def indexed(file: Bytes, indexes: list[Record], plain: Bytes, horizon_ns: int) -> McapBlock | None:
    """Return a chunk's messages by its indexes.

    None unless the indexes account for every byte.
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
        heads = (column(plain, "u1", where) == Opcode.MESSAGE) & (
            column(plain, "<u2", where, 9) == channel
        )
        if not heads.all():
            return None
        # Lengths of up to 2^63 - 1 are claimed: none may be added to anything before it is known to
        # be small.
        size = block.sizes(channel)
        if size.min() < MESSAGE_HEAD - RECORD_HEAD or size.max() > len(plain):
            return None
    return block if _end_to_end(block) else None


def _end_to_end(block: McapBlock) -> bool:
    """Return whether the records are contiguous from the first byte to the last.

    They are if their lengths add up to the total, one begins at the first byte, and each ends where
    another begins or at the last byte.
    """
    if not block.messages:
        return False
    length = len(block.buffer)
    begin = np.concatenate([*block.messages.values()])
    size = RECORD_HEAD + np.concatenate([block.sizes(channel) for channel in block.messages])
    if size.sum() != length or (begin + size).max() > length:
        return False
    begins = np.zeros(length + 1, np.bool_)
    begins[begin] = begins[length] = True
    return bool(begins[0] and begins[begin + size].all())
