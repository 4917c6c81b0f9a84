"""The positions of messages in plain bytes, and columns of numbers at these positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Indices

Bytes = NDArray[np.uint8]
Offsets = NDArray[np.int64]


@dataclass(frozen=True)
class Spans:
    """Messages in plain bytes."""

    buffer: Bytes  # The bytes
    begin: Offsets | slice  # (N,) where each message begins; a slice where they are equally spaced
    size: Offsets  # (N,) their lengths in bytes

    def __len__(self) -> int:
        return len(self.size)

    def message(self, index: int) -> memoryview:
        """Return the bytes of one message."""
        begin = int(offsets_of(self.begin)[index])
        return self.buffer.data[begin : begin + int(self.size[index])]

    def at(self, index: Offsets) -> Spans:
        """Return the messages chosen by indices."""
        return Spans(self.buffer, offsets_of(self.begin)[index], self.size[index])

    def in_a_row(self) -> Spans:
        """Copy messages of one size at irregular positions into consecutive ones.

        One copy is faster than gathering each field.
        """
        if len(self) < 2 or isinstance(self.begin, slice) or not (self.size == self.size[0]).all():
            return self
        width = int(self.size[0])
        if not width:
            return self
        buffer = column(self.buffer, f"V{width}", self.begin).view(np.uint8)
        return Spans(buffer, slice(0, len(buffer), width), self.size)


def column(buffer: Bytes, dtype: str | np.dtype, offsets: Offsets | slice, at: int = 0) -> NDArray:
    """Return the items at a fixed distance after each of several positions.

    A slice gives a strided view of the bytes (no copy), an index array a copy.
    """
    if isinstance(offsets, slice):
        # The same as a slice of all places, in one step: this is called some twenty times a chunk.
        count = len(range(offsets.start, offsets.stop, offsets.step))
        return np.ndarray((count,), dtype, buffer, offsets.start + at, (offsets.step,))
    return _everywhere(buffer, np.dtype(dtype))[offsets + at]


def place(buffer: Bytes, offsets: Offsets | slice, at: int, items: NDArray) -> None:
    """Write items into a buffer, each at the same distance after its position."""
    _everywhere(buffer, items.dtype)[shifted(offsets, at)] = items


def _everywhere(buffer: Bytes, dtype: np.dtype) -> NDArray:
    # Every byte is a possible beginning, so offsets of any alignment are a slice or an index of
    # this view.
    return np.ndarray(
        (max(len(buffer) - dtype.itemsize + 1, 0),), dtype, buffer=buffer, strides=(1,)
    )


def shifted(offsets: Offsets | slice, at: int) -> Offsets | slice:
    """Return `offsets`, each moved by `at` bytes."""
    if isinstance(offsets, slice):
        return slice(offsets.start + at, offsets.stop + at, offsets.step)
    return offsets + at


def progression(offsets: Offsets) -> Offsets | slice:
    """Return equally spaced `offsets` as a slice, which makes a view."""
    if len(offsets) < 2:
        return offsets
    step = int(offsets[1] - offsets[0])
    if (
        step > 0
        and int(offsets[-1] - offsets[0]) == step * (len(offsets) - 1)
        and np.all(np.diff(offsets) == step)
    ):
        return slice(int(offsets[0]), int(offsets[-1]) + 1, step)
    return offsets


def offsets_of(where: Offsets | slice) -> Offsets:
    """Return the offsets for a slice of :func:`progression`."""
    return np.arange(where.start, where.stop, where.step) if isinstance(where, slice) else where


def by_value(values: NDArray) -> dict[int, Indices | slice]:
    """Return the positions of each value in an array, in order and in one pass."""
    if not len(values):
        return {}
    if (values == values[0]).all():
        return {int(values[0]): slice(None)}
    order = np.argsort(values, kind="stable")
    sorted_values = values[order]
    starts = np.flatnonzero(np.concatenate([[True], sorted_values[1:] != sorted_values[:-1]]))
    return dict(zip(sorted_values[starts].tolist(), np.split(order, starts[1:]), strict=True))
