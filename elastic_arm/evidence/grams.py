"""Products of residual and columns, place by place and octave by octave: G_b = A_b' A_b.

All that is decided needs no more of the data. Each pair of columns is multiplied once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.evidence.term import Ident, Term
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]

OCTAVES = np.array([0.5, 1, 2, 4, 8, 16, 32])  # Hz; edges of the octaves in which noise has a power of its own


class Products(NamedTuple):
    """Products of a set of terms, B bands and p coefficients."""

    H: Array  # (B, p, p)
    b: Array  # (B, p)
    yy: Array  # (B,)


class Bands:
    """Place and octave of each whitened row.

    Parameters
    ----------
    data
        Whitened residuals.
    """

    def __init__(self, data: WhitenedData) -> None:
        f = np.concatenate([np.repeat(np.arange(h.size // 2) * data.band.kept_rate / h.samples, 2) for h in data.harmonics])
        octaves, self.places = len(OCTAVES) + 1, data.layout.rows
        own = np.searchsorted(OCTAVES, f, side="right")
        self.of_rows = np.concatenate([place * octaves + own for place in range(self.places)])
        self.counts = np.bincount(self.of_rows, minlength=self.places * octaves)
        self.order = np.argsort(self.of_rows, kind="stable")
        ends = np.searchsorted(self.of_rows[self.order], np.arange(len(self.counts) + 1))
        self.used = np.flatnonzero(self.counts)
        self.slices = [slice(int(ends[b]), int(ends[b + 1])) for b in self.used]
        self.n = self.counts[self.used].astype(float)
        self.place, self.octave = np.divmod(self.used, octaves)

    def products(self, A: Array, B: Array) -> Array:
        """Return (bands, a, b) of columns whose rows are in the order of the bands."""
        return np.stack([A[s].T @ B[s] for s in self.slices])


class Grams:
    """Products of the residual, the numbers' columns and those of terms.

    Parameters
    ----------
    y, N
        (rows,) and (rows, k) whitened residual and columns of the numbers.
    bands
        Place and octave of the rows.
    """

    def __init__(self, y: Array, N: Array, bands: Bands) -> None:
        self.bands = bands
        self.base = np.column_stack([y, N])[bands.order]
        self.G0 = bands.products(self.base, self.base)
        self._columns: dict[Ident, Array] = {}
        self._with_base: dict[Ident, Array] = {}
        self._pairs: dict[tuple[Ident, Ident], Array] = {}

    def columns(self, term: Term) -> Array:
        """Return the columns (rows, [1 +] k) of a term in the order of the bands, its offset first where it has one."""
        if term.ident not in self._columns:
            own = term.columns if term.offset is None else np.column_stack([term.offset, term.columns])
            self._columns[term.ident] = own[self.bands.order]
        return self._columns[term.ident]

    def with_base(self, term: Term) -> Array:
        """Return the products (B, 1 + k, m) of residual and numbers with a term's columns."""
        if term.ident not in self._with_base:
            self._with_base[term.ident] = self.bands.products(self.base, self.columns(term))
        return self._with_base[term.ident]

    def pair(self, one: Term, other: Term) -> Array:
        """Return the products (B, m, m') of two terms' columns."""
        key = (one.ident, other.ident)
        if key not in self._pairs:
            found = self.bands.products(self.columns(one), self.columns(other))
            self._pairs[key] = found
            self._pairs[key[::-1]] = found.transpose(0, 2, 1)
        return self._pairs[key]

    def of(self, terms: Sequence[Term]) -> Products:
        """Return the products of a set: coefficients of the numbers first, then of the terms in order."""
        sizes = [self.G0.shape[1], *(t.count + (t.offset is not None) for t in terms)]
        at = np.concatenate([[0], np.cumsum(sizes)])
        G = np.empty((len(self.bands.n), at[-1], at[-1]))
        G[:, : sizes[0], : sizes[0]] = self.G0
        for i, one in enumerate(terms):
            own = slice(at[i + 1], at[i + 2])
            G[:, : sizes[0], own] = self.with_base(one)
            G[:, own, : sizes[0]] = G[:, : sizes[0], own].transpose(0, 2, 1)
            for k, other in enumerate(terms[: i + 1]):
                beside = slice(at[k + 1], at[k + 2])
                G[:, beside, own] = self.pair(other, one)
                G[:, own, beside] = G[:, beside, own].transpose(0, 2, 1)
        fixed = [at[i + 1] for i, t in enumerate(terms) if t.offset is not None]
        if fixed:  # of known size: off the residual
            e = np.zeros(G.shape[1])
            e[0], e[fixed] = 1.0, -1.0
            row = G @ e
            G[:, 0, 0] = row @ e
            G[:, 0, 1:], G[:, 1:, 0] = row[:, 1:], row[:, 1:]
        free = np.setdiff1d(np.arange(1, at[-1]), fixed)
        return Products(G[:, free[:, None], free], G[:, free, 0], G[:, 0, 0])
