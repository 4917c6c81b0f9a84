"""Gram matrices of residual and columns by place and octave: G_b = A_b' A_b.

Fits and screens use only these products, and each pair of columns is multiplied once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.evidence.keys import Ident
from elastic_arm.evidence.posterior import Products
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Term

# Hz, edges of the octaves in which noise has powers of their own
OCTAVES = np.array([0.5, 1, 2, 4, 8, 16, 32])

# Sizes of caches; memory.
MADE = 16  # sets with their products
STACKS = 4  # sets with their columns side by side
LACKING = 8  # sets of shares with their products with the numbers
COLUMNS = 8  # terms with copies of their columns in memory order

K = TypeVar("K")
V = TypeVar("V")


def kept(cache: dict[K, V], key: K, made: Callable[[], V], most: int) -> V:
    """Return a cached value, and compute it if needed; the least recently used one is dropped."""
    if key in cache:
        cache[key] = cache.pop(key)  # moves to the end of the order
        return cache[key]
    while len(cache) >= most:
        del cache[next(iter(cache))]
    cache[key] = made()
    return cache[key]


class Bands:
    """Place and octave of each whitened row; rows are in the order of the bands."""

    def __init__(self, data: WhitenedData) -> None:
        self.places = data.layout.rows
        own = np.searchsorted(OCTAVES, data.frequencies, side="right")
        shares = np.array([left.mean(axis=0) for left in data.shares()])
        of_rows = [place * (len(OCTAVES) + 1) + own for place in range(self.places)]
        told = [data.of_stretches(shares[:, place]) for place in range(self.places)]
        self._count(np.concatenate(of_rows), np.concatenate(told))

    def among(self, rows: Mask) -> Bands:
        """Return the bands of some of the rows (rows,)."""
        found = Bands.__new__(Bands)
        found.places = self.places
        found._count(self.of_rows[rows], self._told[rows])
        return found

    def _count(self, of_rows: Indices, told: Array) -> None:
        octaves = len(OCTAVES) + 1
        self.of_rows = of_rows
        self._told = told
        self.counts = np.bincount(self.of_rows, minlength=self.places * octaves)
        ends = np.concatenate([[0], np.cumsum(self.counts)])
        self.used = np.flatnonzero(self.counts)
        self.slices = [slice(int(ends[b]), int(ends[b + 1])) for b in self.used]
        # Rows with free torques carry less information.
        self.n = np.maximum(np.bincount(self.of_rows, told, len(self.counts))[self.used], 1.0)
        self.place, self.octave = np.divmod(self.used, octaves)

    def side_by_side(self, each: Sequence[Array]) -> Array:
        """Return several columns (rows, k) side by side; each column is contiguous in memory."""
        found = each[0].T if len(each) == 1 else np.concatenate([one.T for one in each])
        return np.ascontiguousarray(found).T

    def products(self, A: Array, B: Array) -> Array:
        """Return the products (bands, a, b) of columns with rows in the order of the bands."""
        found = np.zeros((len(self.slices), A.shape[1], B.shape[1]))
        first = self.first_of(B)
        for b, s in enumerate(self.slices[first:], first):
            np.matmul(A[s].T, B[s], out=found[b])
        return found

    def first_of(self, columns: Array) -> int:
        """Return the first band of the first place at which columns (rows, k) are not null.

        If they are null everywhere, it is the last place.
        """
        begins = np.flatnonzero(np.diff(self.place, prepend=-1)).tolist()
        for begin, after in pairwise([*begins, len(self.slices)]):
            if any(columns[own].any() for own in self.slices[begin:after]):
                return begin
        return begins[-1]

    def powers(self, white: Array) -> Array:
        """Return the sum of squares of rows in each band (B,)."""
        return np.asarray(
            np.bincount(self.of_rows, white**2, len(self.counts))[self.used], dtype=float
        )


class Grams:
    """Products of the residual, the columns of the numbers, and those of terms.

    y, N: (rows,) and (rows, K) whitened residual and columns of the numbers; basis: combinations
    (K, k) of these columns.
    """

    def __init__(self, y: Array, N: Array, bands: Bands, basis: Array) -> None:
        self.bands = bands
        self.basis = basis
        base = np.empty((1 + basis.shape[1], len(y)))
        base[0] = y
        np.matmul(basis.T, N.T, out=base[1:])
        self.base = base.T  # each column is contiguous in memory
        self.G0 = bands.products(self.base, self.base)
        rows, columns = np.tril_indices(self.G0.shape[1] - 1)
        self._base_half = self.G0[:, 1 + rows, 1 + columns]
        self._columns: dict[Ident, Array] = {}
        self._with_base: dict[Ident, Array] = {}
        self._pairs: dict[tuple[Ident, Ident], Array] = {}
        self._lacking: dict[tuple[Ident, ...], tuple[Array, Array]] = {}
        self._less: dict[tuple[Ident, ...], Term] = {}
        self._stacks: dict[tuple[Ident, ...], Array] = {}
        self._made: dict[tuple[Ident, ...], Array] = {}  # of sets, from :meth:`of`

    def let_go(self) -> None:
        """Discard the shared products of sets, which can be recomputed."""
        self._stacks.clear()
        self._made.clear()

    def columns(self, term: Term) -> Array:
        """Return the columns (rows, [1 +] k) of a term in the order of the bands, after its offset
        if it has one."""
        own = term.columns
        if term.offset is None and len(own) and own.flags.f_contiguous:
            return own
        return kept(self._columns, term.ident, lambda: self.bands.side_by_side(term.parts), COLUMNS)

    @staticmethod
    def lacks(term: Term, lacking: Sequence[ShareTerm]) -> bool:
        """Whether the columns of a term contain some of these shares."""
        return isinstance(term, NumberTerm) and bool(term.shared(lacking))

    def less(self, term: Term, lacking: Sequence[ShareTerm]) -> Term:
        """Return a term without some shares of its columns; the same term if it contains none."""
        if not isinstance(term, NumberTerm):
            return term
        own = term.shared(lacking)
        if not own:
            return term
        key = (term.ident, *(share.ident for share in own))
        if key not in self._less:
            self._less[key] = term.without(own)
        return self._less[key]

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

    def _pair_all(self, others: Sequence[Term], term: Term) -> None:
        """Compute the products of a new term with others at once."""
        if len(others) < 2 or (others[0].ident, term.ident) in self._pairs:
            return
        idents = tuple(o.ident for o in others)
        side_by_side = kept(
            self._stacks, idents, lambda: np.hstack([self.columns(o) for o in others]), STACKS
        )
        found = self.bands.products(side_by_side, self.columns(term))
        at = 0
        for o in others:
            own = found[:, at : at + self.columns(o).shape[1]]
            at += own.shape[1]
            self._pairs[o.ident, term.ident] = own
            self._pairs[term.ident, o.ident] = own.transpose(0, 2, 1)

    def _multiply(self, terms: Sequence[Term]) -> None:
        """Compute the products of new terms with the base and with one another in one pass over the
        columns."""
        new = [t for t in terms if t.ident not in self._with_base]
        if len(new) < 2:
            return
        together = self.bands.side_by_side([self.columns(t) for t in new])
        ends = np.cumsum([self.columns(t).shape[1] for t in new])[:-1]
        with_base = np.split(self.bands.products(self.base, together), ends, axis=2)
        rows = np.split(self.bands.products(together, together), ends, axis=1)
        for one, own, row in zip(new, with_base, rows, strict=True):
            self._with_base[one.ident] = own
            for other, pair in zip(new, np.split(row, ends, axis=2), strict=True):
                self._pairs[one.ident, other.ident] = pair

    def with_numbers(self, term: Term, lacking: Sequence[ShareTerm]) -> Array:
        """Return the products (B, k, m) of the numbers' columns, without some shares, with a term's
        columns."""
        found = self.with_base(term)[:, 1:]
        if not lacking:
            return found
        self._pair_all(lacking, term)
        of_shares = np.concatenate([self.pair(share, term) for share in lacking], axis=1)
        return found - self.moved_by(lacking).T @ of_shares

    def moved_by(self, shares: Sequence[ShareTerm]) -> Array:
        """Return the combinations (M, k) of the shares' columns in the numbers' columns."""
        none = self.basis[:0]
        return np.concatenate([none, *(self.basis[share.moved] for share in shares)])

    def _numbers(self, lacking: Sequence[ShareTerm]) -> tuple[Array, Array]:
        """Return the lower half of the products of the numbers' columns, without some shares, and
        their products with y."""
        key = tuple(share.ident for share in lacking)
        if not key:
            return self._base_half, self.G0[:, 0, 1:]
        return kept(self._lacking, key, lambda: self._less_shares(lacking), LACKING)

    def _less_shares(self, lacking: Sequence[ShareTerm]) -> tuple[Array, Array]:
        """Compute the products of :meth:`_numbers`.

            (N - X V)'(N - X V) = N'N - M - M',   M = (N'X - V'X'X / 2) V

        X are the columns of the shares, and V their combinations in the numbers' columns N.
        """
        self._multiply(lacking)
        V = self.moved_by(lacking)
        with_base = np.concatenate([self.with_base(share) for share in lacking], axis=2)
        XX = np.block([[self.pair(one, other) for other in lacking] for one in lacking])
        M = (with_base[:, 1:] - 0.5 * V.T @ XX) @ V
        rows, columns = np.tril_indices(V.shape[1])
        half = self._base_half - (M + M.transpose(0, 2, 1))[:, rows, columns]
        return half, self.G0[:, 0, 1:] - with_base[:, 0] @ V

    def of(self, terms: Sequence[Term], lacking: Sequence[ShareTerm] = ()) -> Products:
        """Return the products of a set: those of the numbers first, then of the terms in order.

        lacking: shares of the numbers' columns by effects that the set leaves out.
        """
        half, base = self._numbers(lacking)
        yy = self.G0[:, 0, 0]
        terms = [self.less(t, lacking) for t in terms]
        self._multiply(terms)
        offsets = [t for t in terms if t.offset is not None]
        for t in offsets:  # of known size: subtracted from the residual
            base = base - self.with_numbers(t, lacking)[:, :, 0]
            among_offsets = sum(self.pair(t, o)[:, 0, 0] for o in offsets)
            yy = yy - 2.0 * self.with_base(t)[:, 0, 0] + among_offsets
        b = [base]
        for t in terms:
            first = int(t.offset is not None)
            of_offsets = sum(self.pair(o, t)[:, 0, first:] for o in offsets)
            b.append(self.with_base(t)[:, 0, first:] - of_offsets)
        # Sets differ by a term or two: rows before them are reused from a recent set.
        idents = (tuple(share.ident for share in lacking), *(t.ident for t in terms))
        near = max(self._made, key=lambda known: _shared(known, idents), default=())
        begin = max(_shared(near, idents) - 1, 0)
        p = base.shape[1] + sum(t.count for t in terms[:begin])
        rows = [self._made[near][:, : p * (p + 1) // 2] if begin else half]
        for i, one in enumerate(terms[begin:], begin):
            first = int(one.offset is not None)
            self._pair_all(terms[:i], one)
            beside = [
                self.pair(o, one)[:, int(o.offset is not None) :, first:] for o in terms[: i + 1]
            ]
            block = np.concatenate([self.with_numbers(one, lacking)[:, :, first:], *beside], axis=1)
            above = block.shape[1] - one.count
            rows += [block[:, : above + k + 1, k] for k in range(one.count)]
        whole = kept(self._made, idents, lambda: np.concatenate(rows, axis=1), MADE)
        return Products(whole, np.concatenate(b, axis=1), yy)


def _shared(one: tuple[Ident, ...], other: tuple[Ident, ...]) -> int:
    """Return the number of equal terms at the beginning of two sets."""
    return next(
        (i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b),
        min(len(one), len(other)),
    )
