"""Where the numbers lie in a CDR message, so that thousands of equal layout are read, or written, at once.

The lengths of its sequences and strings alone decide where everything in a message lies. The layout of one message is
found by walking its type; every message with the same lengths has the same layout, which is checked over whole arrays.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from elastic_arm.errors import RecordingError
from elastic_arm.recording.scan import Bytes, Offsets, column, progression

_ORIGIN = 4  # alignment counts from behind the encapsulation header
_NUMBERS = {
    **{name: name for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")},
    "float32": "float32",
    "float64": "float64",
    "bool": "uint8",
    "byte": "uint8",
    "char": "uint8",
    "octet": "uint8",
}


@dataclass(frozen=True)
class Numbers:
    """A field of numbers: where it begins in the message, its type, how many."""

    at: int
    dtype: np.dtype
    count: int


@dataclass
class Layout:
    """Where everything lies in a message.

    Parameters
    ----------
    size
        Length of the message in bytes.
    numbers
        By path: `header.stamp.sec`, `position`, `points.0.velocities`.
    strings
        Lists of strings, by path.
    text
        Single strings, by path: where their bytes begin and end. Only their lengths are the layout's.
    fixed
        The bytes (begin, end) that must agree for another message to have this layout and these names.
    """

    size: int
    numbers: dict[str, Numbers] = field(default_factory=dict)
    strings: dict[str, list[str]] = field(default_factory=dict)
    text: dict[str, tuple[int, int]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)

    def matches(self, buffer: Bytes, offsets: Offsets, pattern: memoryview) -> NDArray[np.bool_]:
        """Say which of the messages (of this size) at `offsets` have the layout of the message `pattern`."""
        where = progression(offsets)
        same = np.ones(len(offsets), dtype=bool)
        for begin, end in self.fixed:
            # Compared in words: numpy walks byte strings byte by byte.
            while begin < end:
                width = max(width for width in (8, 4, 2, 1) if width <= end - begin)
                word = int.from_bytes(pattern[begin : begin + width], "little")
                same &= column(buffer, f"<u{width}", where, begin) == word
                begin += width
        return same

    def values(self, buffer: Bytes, offsets: Offsets, path: str) -> NDArray:
        """Return field `path` of the messages at `offsets`: (N, count), or (N,) for a single number.

        Raises
        ------
        KeyError
            If the messages have no such field of numbers.
        """
        numbers = self.numbers[path]
        if not numbers.count:
            return np.empty((len(offsets), 0), numbers.dtype)
        # One opaque item per message is copied faster than `count` numbers.
        width = numbers.count * numbers.dtype.itemsize
        items = np.ascontiguousarray(column(buffer, f"V{width}", progression(offsets), numbers.at))
        return items.view(numbers.dtype).reshape(len(offsets), numbers.count)


def layout_of(data: memoryview, type_name: str, store: Typestore) -> Layout:
    """Find the layout of one message.

    Raises
    ------
    RecordingError
        If the bytes do not hold a message of that type.
    """
    if len(data) < _ORIGIN or data[0] != 0 or data[1] not in (0, 1):
        raise RecordingError(f"a {type_name} message is not plain CDR", "Record with serialization format cdr.")
    walker = _Walker(data, store, "<" if data[1] else ">")
    try:
        walker.message(type_name, "")
    except (struct.error, KeyError, UnicodeDecodeError) as error:
        raise RecordingError(f"a message does not fit its type {type_name} ({error})") from None
    if walker.at > len(data):
        raise RecordingError(f"a message is shorter ({len(data)} bytes) than its type {type_name} wants")
    return walker.layout


def groups(
    buffer: Bytes, offsets: Offsets, sizes: Offsets, type_name: str, store: Typestore
) -> Iterator[tuple[Layout, Offsets]]:
    """Yield the layouts that occur among the messages at `offsets`, each with the indices of its messages."""
    left = np.arange(len(offsets))
    while len(left):
        begin, size = int(offsets[left[0]]), int(sizes[left[0]])
        pattern = buffer.data[begin : begin + size]
        layout = layout_of(pattern, type_name, store)
        equal = sizes[left] == size
        alike = left if equal.all() else left[equal]
        match = layout.matches(buffer, offsets[alike], pattern)
        mine = alike if match.all() else alike[match]
        yield layout, mine
        left = left[:0] if len(mine) == len(left) else np.setdiff1d(left, mine, assume_unique=True)


class _Walker:
    """Walks one message by its type and notes where things lie."""

    def __init__(self, data: memoryview, store: Typestore, order: Literal["<", ">"]) -> None:
        self.data, self.store, self.order = data, store, order
        self.at = _ORIGIN
        self.layout = Layout(len(data), fixed=[(0, 2)])

    def message(self, type_name: str, path: str) -> None:
        _, fields = self.store.fielddefs[type_name]
        for name, (kind, what) in fields:
            self.member(kind, what, f"{path}{name}")

    def member(self, kind: Nodetype, what: Any, path: str) -> None:
        match kind:
            case Nodetype.BASE if what[0] == "string":
                self.layout.text[path] = self.string()
            case Nodetype.BASE:
                self.numbers(what[0], 1, path)
            case Nodetype.NAME:
                self.message(what, f"{path}.")
            case Nodetype.ARRAY:
                self.items(what[0], what[1], path)
            case Nodetype.SEQUENCE:
                self.items(what[0], self.length(), path)

    def items(self, what: Any, count: int, path: str) -> None:
        if count > len(self.data):
            raise struct.error(f"{path} has {count} items")
        kind, inner = what
        if kind == Nodetype.NAME:
            for index in range(count):
                self.message(inner, f"{path}.{index}.")
        elif inner[0] == "string":
            spans = [self.string() for _ in range(count)]
            for begin, end in spans:
                self.fix(begin, end)
            self.layout.strings[path] = [bytes(self.data[begin:end]).decode() for begin, end in spans]
        else:
            self.numbers(inner[0], count, path)

    def numbers(self, name: str, count: int, path: str) -> None:
        dtype = np.dtype(_NUMBERS[name]).newbyteorder(self.order)
        if count:
            self.align(dtype.itemsize)
        self.layout.numbers[path] = Numbers(self.at, dtype, count)
        self.at += count * dtype.itemsize

    def string(self) -> tuple[int, int]:
        size = self.length()
        begin, self.at = self.at, self.at + size
        return begin, max(self.at - 1, begin)  # without the closing NUL

    def length(self) -> int:
        self.align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.fix(self.at, self.at + 4)
        self.at += 4
        return int(value)

    def fix(self, begin: int, end: int) -> None:
        fixed = self.layout.fixed
        if fixed[-1][1] == begin:
            fixed[-1] = (fixed[-1][0], end)
        elif end > begin:
            fixed.append((begin, end))

    def align(self, width: int) -> None:
        self.at += -(self.at - _ORIGIN) % width
