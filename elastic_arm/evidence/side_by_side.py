"""Columns of many terms side by side, without the rows in which they are null.

Whitened columns are null before the first place in which they show. Of the candidates of an arm
that is a third of all rows, of laws without a form nearly half.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.evidence.grams import Bands

Chosen = NDArray[np.intp] | slice


class Tail(NamedTuple):
    """Columns that are null in all bands before one."""

    first: int  # this band
    columns: Array  # (rows from there on, k); each column stands in memory as a whole


def tail(bands: Bands, columns: Array) -> Tail:
    """Return columns (rows, k) without the rows before the first place in which they show."""
    begins = np.flatnonzero(np.diff(bands.place, prepend=-1)).tolist()
    starts = [bands.slices[begin].start for begin in begins]
    ends = [*starts[1:], len(columns)]
    places = zip(begins, starts, ends, strict=True)
    shows = ((begin, start) for begin, start, end in places if columns[start:end].any())
    begin, start = next(shows, (begins[-1], starts[-1]))
    return Tail(begin, np.array(columns[start:].T, order="C").T)


class SideBySide:
    """Columns of several tails, those together that are null before the same band."""

    def __init__(self, bands: Bands, tails: Iterable[Tail]) -> None:
        self._bands = bands
        parts: dict[int, list[Array]] = {}
        places: list[tuple[int, int]] = []  # of each tail: its first band, and its place there
        for first, columns in tails:
            parts.setdefault(first, []).append(columns)
            places.append((first, len(parts[first]) - 1))
        self.firsts = sorted(parts)
        widths = {first: [one.shape[1] for one in parts[first]] for first in self.firsts}
        self.groups = [_joined(parts.pop(first)) for first in self.firsts]
        self.starts = np.cumsum([0, *(X.shape[1] for X in self.groups)])
        begins: dict[int, Array] = {
            first: start + np.cumsum([0, *widths[first]])
            for first, start in zip(self.firsts, self.starts, strict=False)
        }
        # where the columns of each tail are among all
        self.slices = [slice(*begins[first][k : k + 2].tolist()) for first, k in places]

    @property
    def count(self) -> int:
        """Number of columns."""
        return int(self.starts[-1])

    def products(self, A: Array) -> list[Array]:
        """Return the products (c, B', m) of each group, in the bands from its first one on, with
        columns (rows, m).

        What belongs to one column stands in memory as a whole: most gains are looked for of some
        terms alone.
        """
        found = []
        for first, X in zip(self.firsts, self.groups, strict=True):
            slices = self._bands.slices[first:]
            start = slices[0].start
            own = np.empty((X.shape[1], len(slices), A.shape[1]))
            for b, s in enumerate(slices):
                own[:, b] = X[s.start - start : s.stop - start].T @ A[s]
            found.append(own)
        return found

    def squares(self, columns: slice) -> Array:
        """Return the products (B, k, k) of some columns of one group with one another."""
        g = self.group_of(columns)
        first = self.firsts[g]
        own = self.groups[g][:, columns.start - self.starts[g] : columns.stop - self.starts[g]]
        slices = self._bands.slices
        start = slices[first].start
        found = np.zeros((len(slices), own.shape[1], own.shape[1]))
        for b, s in enumerate(slices[first:], first):
            part = own[s.start - start : s.stop - start]
            found[b] = part.T @ part
        return found

    def whole(self, columns: slice) -> Array:
        """Return some columns of one group with all rows (rows, k)."""
        g = self.group_of(columns)
        own = self.groups[g][:, columns.start - self.starts[g] : columns.stop - self.starts[g]]
        found = np.zeros((own.shape[1], self._bands.slices[-1].stop))
        found[:, found.shape[1] - len(own) :] = own.T
        return found.T

    def group_of(self, columns: slice) -> int:
        """Return the group in which some columns are."""
        return int(np.searchsorted(self.starts, columns.start, side="right")) - 1

    def among(self, columns: NDArray[np.intp]) -> list[Chosen]:
        """Return which columns of each group are among some of all, which ascend."""
        if len(columns) == self.count:
            return [slice(None)] * len(self.groups)
        ends = np.searchsorted(columns, self.starts)
        each = zip(ends[:-1], ends[1:], self.starts[:-1], strict=True)
        return [columns[begin:end] - start for begin, end, start in each]


def _joined(parts: Sequence[Array]) -> Array:
    """Return columns of as many rows side by side; each column stands in memory as a whole."""
    return np.concatenate([one.T for one in parts]).T
