"""Locate the numbers in CDR messages, so that thousands of messages with equal layout are read or
written at once.

The layout of a message depends only on the lengths of its sequences and strings. The layout of one
message is found by walking through its type. All messages with the same lengths have the same
layout, which is checked over whole arrays.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict

from elastic_arm.arrays import Mask
from elastic_arm.errors import RecordingError
from elastic_arm.recording import limits, message_types
from elastic_arm.recording.spans import Bytes, Offsets, Spans, column, offsets_of

_ORIGIN = 4  # alignment counts from behind the encapsulation header
_NUMBERS = {
    **{
        name: name
        for name in ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
    },
    "float32": "float32",
    "float64": "float64",
    "bool": "uint8",
    "byte": "uint8",
    "char": "uint8",
    "octet": "uint8",
}


@dataclass(frozen=True)
class Numbers:
    """A field of numbers: its position in the message, type and count."""

    at: int
    dtype: np.dtype
    count: int


@dataclass
class Layout:
    """The positions of all fields of a message."""

    size: int  # length of the message in bytes
    # by path: `header.stamp.sec`, `position`, `points.0.velocities`
    numbers: dict[str, Numbers] = field(default_factory=dict)
    strings: dict[str, list[str]] = field(default_factory=dict)  # lists of strings, by path
    # single strings, by path: where their bytes begin and end. Only their lengths are the layout's.
    text: dict[str, tuple[int, int]] = field(default_factory=dict)
    # the bytes (begin, end) that must agree for another message to have this layout and these names
    fixed: list[tuple[int, int]] = field(default_factory=list)
    # what they hold: (begin, dtype, value)
    words: list[tuple[int, str, int]] = field(default_factory=list)

    def learn(self, pattern: memoryview) -> None:
        """Store the fixed bytes of `pattern`, a message with this layout."""
        merged: list[tuple[int, int]] = []
        for begin, end in sorted(self.fixed):
            if merged and merged[-1][1] == begin:
                begin, _ = merged.pop()
            merged.append((begin, end))
        for begin, end in merged:
            # In words: numpy walks byte strings byte by byte.
            while begin < end:
                width = max(width for width in (8, 4, 2, 1) if width <= end - begin)
                value = int.from_bytes(pattern[begin : begin + width], "little")
                self.words.append((begin, f"<u{width}", value))
                begin += width

    def matches(self, spans: Spans) -> Mask:
        """Return which messages (N,) have this layout and these names."""
        # Only messages of this length reach as far as the words.
        same: Mask = spans.size == self.size
        if same.all():
            return self._alike(spans.buffer, spans.begin)
        long = np.flatnonzero(same)
        same[long] = self._alike(spans.buffer, offsets_of(spans.begin)[long])
        return same

    def _alike(self, buffer: Bytes, where: Offsets | slice) -> Mask:
        begin, dtype, value = self.words[0]
        same = column(buffer, dtype, where, begin) == value
        for begin, dtype, value in self.words[1:]:
            same &= column(buffer, dtype, where, begin) == value
        return same

    def values(self, spans: Spans, path: str) -> NDArray:
        """(N, count) numbers of field `path` in messages of this layout."""
        numbers = self.numbers[path]
        found = np.empty((len(spans), numbers.count), numbers.dtype)
        self.values_into(spans, path, found)
        return found

    def values_into(self, spans: Spans, path: str, target: NDArray) -> None:
        """Put what :meth:`values` returns into `target`, (N, count) contiguous."""
        numbers = self.numbers[path]
        if numbers.count and len(target):
            # One opaque item per message is copied faster than `count` numbers.
            items = f"V{numbers.count * numbers.dtype.itemsize}"
            target.view(items)[:, 0] = column(spans.buffer, items, spans.begin, numbers.at)


def layout_of(data: memoryview, type_name: str, types: Typesdict | None = None) -> Layout:
    """Return the layout of one message, whose type is among the given types or otherwise the known
    ones."""
    if len(data) < _ORIGIN or data[0] != 0 or data[1] not in (0, 1):
        raise RecordingError(
            f"a {type_name} message is not plain CDR", "Record with serialization format cdr."
        )
    walker = _Walker(
        data,
        message_types.typestore().fielddefs if types is None else types,
        "<" if data[1] else ">",
    )
    try:
        walker.message(type_name, "")
    except RecursionError:
        raise RecordingError(f"the types of {type_name} refer to each other in a cycle") from None
    except (struct.error, KeyError, UnicodeDecodeError) as error:
        raise RecordingError(f"a message does not fit its type {type_name} ({error})") from None
    if walker.at > len(data):
        raise RecordingError(
            f"a message is shorter ({len(data)} bytes) than its type {type_name} requires"
        )
    return walker.layout


class Layouts:
    """The layouts found so far among the messages of one type."""

    def __init__(self, type_name: str, types: Typesdict) -> None:
        self.type_name = type_name
        self.types = types
        self.known: dict[int, list[Layout]] = {}
        self._latest: Layout | None = None
        self._walked = 0

    def groups(self, spans: Spans) -> Iterator[tuple[Layout, Offsets | None]]:
        """Yield the layouts among messages, each with the indices of its messages.

        None stands for all messages.
        """
        # Nearly always all messages of a block are like those before: then nothing has to be picked
        # out.
        if self._latest is not None and self._latest.matches(spans).all():
            yield self._latest, None
            return
        left = np.arange(len(spans))
        while len(left):
            self._latest = self._of(spans.at(left[:1]))
            match = self._latest.matches(spans.at(left))
            yield self._latest, None if len(left) == len(spans) and match.all() else left[match]
            left = left[~match]

    def _of(self, one: Spans) -> Layout:
        """Return the layout of one message: a known one, or a new one."""
        pattern = one.message(0)
        known = self.known.setdefault(len(pattern), [])
        for layout in known:
            if layout.matches(one).all():
                return layout
        if (
            sum(map(len, self.known.values())) >= limits.LAYOUTS
            or self._walked > limits.LAYOUT_FIELDS
        ):
            problem = (
                f"its messages have more than {limits.LAYOUTS} different combinations of names"
                " and lengths"
            )
            raise RecordingError(
                problem, "Stop publishers that change the names or the number of joints."
            )
        layout = layout_of(pattern, self.type_name, self.types)
        layout.learn(pattern)
        self._walked += len(layout.fixed) + len(layout.numbers)
        known.append(layout)
        return layout


class _Walker:
    """Walks through one message by its type and records the positions."""

    def __init__(self, data: memoryview, types: Typesdict, order: Literal["<", ">"]) -> None:
        self.data = data
        self.types = types
        self.order = order
        self.at = _ORIGIN
        self.walked = 0
        self.layout = Layout(len(data), fixed=[(0, 2)])

    def message(self, type_name: str, path: str) -> None:
        _, fields = self.types[type_name]
        self.count(1)
        for name, (kind, what) in fields:
            self.count(1)
            self.member(kind, what, f"{path}{name}")

    def count(self, fields: int) -> None:
        self.walked += fields
        if self.walked > limits.WALKED_FIELDS:
            raise struct.error(f"it has more than {limits.WALKED_FIELDS} fields")

    def member(self, kind: Nodetype, what: Any, path: str) -> None:
        match kind:
            case Nodetype.BASE if what[0] == "string":
                begin, end = self.string()
                self.layout.text[path] = (begin, max(end - 1, begin))  # without the closing NUL
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
            if count > limits.COLUMNS:
                raise struct.error(f"{path} has {count} texts; the limit is {limits.COLUMNS}")
            self.count(count)
            spans = [self.string() for _ in range(count)]
            self.layout.fixed += spans
            self.layout.strings[path] = [
                bytes(self.data[begin:end]).rstrip(b"\0").decode() for begin, end in spans
            ]
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
        begin = self.at
        self.at = self.at + size
        return begin, self.at

    def length(self) -> int:
        self.align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.data, self.at)
        self.layout.fixed.append((self.at, self.at + 4))
        self.at += 4
        return int(value)

    def align(self, width: int) -> None:
        self.at += -(self.at - _ORIGIN) % width
