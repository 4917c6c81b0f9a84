"""The message records of MCAP: a head, then the message."""

from __future__ import annotations

import struct

import numpy as np
from mcap.opcode import Opcode

from elastic_arm.recording.spans import Bytes, Offsets, place, progression, shifted

RECORD_HEAD = 9  # kind and length
MESSAGE_HEAD = 31  # kind, length, channel, sequence, log time, publish time
_HEAD = struct.Struct("<BQHIQQ")


def message_head(size: int, channel: int, sequence: int, log_ns: int, publish_ns: int) -> bytes:
    """Return the head of a message's record."""
    length = MESSAGE_HEAD - RECORD_HEAD + size
    return _HEAD.pack(Opcode.MESSAGE, length, channel, sequence & 0xFFFFFFFF, log_ns, publish_ns)


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
