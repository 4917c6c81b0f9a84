"""The records of MCAP: lay messages as such, and find those of a byte string without a Python step per message.

An MCAP file, and each chunk in it once decompressed, is a run of records: one byte of kind, eight of length, content.
Recorders write their topics in turn, so the same few records come round and round: after a short walk the round is
known, and whole arrays of rounds are checked at once. Where the pattern breaks the walk goes on.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from elastic_arm.recording import limits
from elastic_arm.recording.spans import Bytes, Offsets, column, place, progression, shifted

RECORD_HEAD = 9  # kind and length
MESSAGE_HEAD = 31  # kind, length, channel, sequence, log time, publish time
_MESSAGE = struct.Struct("<BQHIQQ")
_HEAD = struct.Struct("<BQ")
# Kind, length and channel, which are the same in each round: eleven bytes as two overlapping words.
HEAD_WORDS = (("<u4", 0), ("<u8", 3))
_SHORTEST = MESSAGE_HEAD - RECORD_HEAD  # of a message's record
_WALK = 24  # messages walked before a round is looked for
_LONGEST_ROUND = 8
_LOOKED = 1 << 26  # bytes that are looked at before the system takes them back


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


def scan(buffer: Bytes, begin: int, end: int, most: int = limits.RECORDS) -> Scan:
    """Find all records between `begin` and `end`; stops before a torn one, or one that is shorter than its kind."""
    view = buffer.data
    found: list[Offsets] = []
    walked: list[int] = []
    others: list[Record] = []
    at, given, look = begin, begin, _WALK
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
        if at - given > _LOOKED:
            give_back(buffer, given, at)
            given = at
    messages = np.concatenate([*found, np.array(walked, np.int64)])
    return Scan(messages, others, at)


def give_back(buffer: Bytes, begin: int, end: int) -> None:
    """Have the system take back the memory of a file's bytes that were read; they come again when needed."""
    mapping = getattr(buffer.base, "obj", None)
    if isinstance(mapping, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        begin = begin // mmap.PAGESIZE * mmap.PAGESIZE
        mapping.madvise(mmap.MADV_DONTNEED, begin, end - begin)


def _leap(buffer: Bytes, walked: list[int], at: int, end: int) -> Offsets:
    """Return the messages that follow at `at` as long as they repeat the round of the `walked` ones."""
    starts = np.array([*walked, at], np.int64)
    keys = [column(buffer, dtype, starts[:-1], at) for dtype, at in HEAD_WORDS]
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
            for part, (dtype, offset) in zip(keys, HEAD_WORDS, strict=True):
                equal = column(buffer, dtype, spot, offset) == part[index]
                held = min(held, count if equal.all() else int(np.argmin(equal)))
        rounds += held
        if held < count:
            break
        batch *= 4
    return (at + stride * np.arange(rounds)[:, None] + slots[None, :-1]).ravel()
