"""Columns of many terms side by side, without their leading null rows.

A whitened column is null before the first place at which it acts. These rows are a third of all
rows of the candidates of an arm, and nearly half of those of nonparametric laws.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.tails import Tail

Chosen = Indices | slice


def tail_of(bands: Bands, columns: Array) -> Tail:
    """Return columns (rows, k) without the rows before the first place at which they act."""
    start = bands.slices[bands.first_of(columns)].start
    return Tail(start, np.array(columns[start:].T, order="C").T)


class SideBySide:
    """Columns of several tails, grouped by their first row."""

    def __init__(self, bands: Bands, tails: Iterable[Tail]) -> None:
        parts: dict[int, list[Array]] = {}
        places: list[tuple[int, int]] = []  # first row of each tail, and its index in the group
        for start, columns in tails:
            parts.setdefault(start, []).append(columns)
            places.append((start, len(parts[start]) - 1))
        starts = sorted(parts)
        widths = {start: [one.shape[1] for one in parts[start]] for start in starts}
        self.groups = [Tail(start, _joined(parts.pop(start))) for start in starts]
        self.begins = np.cumsum([0, *(group.columns.shape[1] for group in self.groups)])
        before = {
            start: begin + np.cumsum([0, *widths[start]])
            for start, begin in zip(starts, self.begins, strict=False)
        }
        # slice of the columns of each tail
        self.slices = [slice(*before[start][k : k + 2].tolist()) for start, k in places]
        of_bands = [one.start for one in bands.slices]
        self.firsts = [of_bands.index(start) for start in starts]  # first band of each group
        self._bands = bands

    @property
    def count(self) -> int:
        """Number of columns."""
        return int(self.begins[-1])

    def products(self, A: Array) -> list[Array]:
        """Return the products (c, B', m) of each group with columns (rows, m), from its first band
        on.

        The products of one column are contiguous in memory, because most gains are computed for
        some terms only.
        """
        found = []
        shown = self._bands.first_of(A)
        for first, (start, X) in zip(self.firsts, self.groups, strict=True):
            slices = self._bands.slices[first:]
            null = max(shown - first, 0)
            own = np.empty((X.shape[1], len(slices), A.shape[1]))
            own[:, :null] = 0.0
            for b, s in enumerate(slices[null:], null):
                own[:, b] = X[s.start - start : s.stop - start].T @ A[s]
            found.append(own)
        return found

    def squares(self, columns: slice) -> Array:
        """Return the products (B, k, k) of some columns of one group with one another."""
        start, own = self.some(columns)
        found = np.zeros((len(self._bands.slices), own.shape[1], own.shape[1]))
        first = self.firsts[self.group_of(columns)]
        for b, s in enumerate(self._bands.slices[first:], first):
            part = own[s.start - start : s.stop - start]
            found[b] = part.T @ part
        return found

    def some(self, columns: slice) -> Tail:
        """Return a view of some columns of one group."""
        g = self.group_of(columns)
        start, X = self.groups[g]
        return Tail(start, X[:, columns.start - self.begins[g] : columns.stop - self.begins[g]])

    def group_of(self, columns: slice) -> int:
        """Return the index of the group of some columns."""
        return int(np.searchsorted(self.begins, columns.start, side="right")) - 1

    def among(self, columns: Indices) -> list[Chosen]:
        """Return the columns of each group among some columns, given in ascending order."""
        if len(columns) == self.count:
            return [slice(None)] * len(self.groups)
        ends = np.searchsorted(columns, self.begins)
        each = zip(ends[:-1], ends[1:], self.begins[:-1], strict=True)
        return [columns[begin:end] - start for begin, end, start in each]


def _joined(parts: Sequence[Array]) -> Array:
    """Return columns with the same rows side by side; each column is contiguous in memory."""
    return np.concatenate([one.T for one in parts]).T
