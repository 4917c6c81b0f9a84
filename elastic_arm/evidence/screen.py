"""The gain of each additional term beside a fit, from Gram matrices only.

    G = X'X - C S C',   b = X'(y - fitted part)
    gain = 1/2 b^2 / (G + 1/s^2) - 1/2 ln(1 + G s^2)        for a column with the prior N(0, s^2)

X are the columns (rows, k) of a term, with each band divided by its noise power, C = X'A their
products with the columns A of the fit, and S the covariance (p, p) of the fit's coefficients.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.special import logsumexp

from elastic_arm.arrays import Array, Indices
from elastic_arm.evidence.fit import Fit, LinearModel
from elastic_arm.evidence.grams import Grams, kept
from elastic_arm.evidence.keys import Ident
from elastic_arm.evidence.posterior import Posterior, mass
from elastic_arm.evidence.priors import RELATED, SCALES, SIZES
from elastic_arm.evidence.side_by_side import SideBySide, tail_of
from elastic_arm.evidence.tails import Tail
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.term import Term

# sizes of caches of screens, products with all terms, and gains; memory
SCREENS = 2
PRODUCTS = 40
GAINED = 100
LOOKED_AT = 30  # number of terms with refined first-order gains; numerical


class Gained(NamedTuple):
    """The gains of terms beside a fit (T,), nats, and the sizes of laws with these gains."""

    nats: Array
    chosen: dict[int, float]


class FirstGains(NamedTuple):
    """Gains of T' terms at fixed noise, with c columns in all."""

    nats: Array  # (T',)
    less: Array  # (B, T') reductions of squares at fixed coefficients of the fit
    mean: dict[int, Array]  # coefficients of each term
    chosen: dict[int, float]  # sizes of laws
    CS: Array  # (c, p) products with the fit times its covariance
    at: Indices  # (T' + 1,) first column of each term


class Group(NamedTuple):
    """Products of some columns of terms with those of a fit, from a first band on."""

    numbers: Array  # (c', B', K) with the numbers' columns, including shares of effects
    shares: Array  # (c', B', M) with the shares that are absent
    terms: Array  # (c', B', p') with the terms' columns


class Beside(NamedTuple):
    """Products of columns of terms with a fit."""

    C: Array  # (c, p) products with the columns of the fit, at its noise
    left: Array  # (c, B) products with the residual of the fit
    needed: Indices  # the stored columns that they combine
    groups: list[Group]  # products of these columns
    moved: Array  # (M, K) combinations of the shares in the numbers' columns


class Screen:
    """Products of many terms with the residual and the numbers, which give the gains of terms.

    terms: an iterator, because the rows of all terms together are large.
    """

    def __init__(self, grams: Grams, terms: Iterable[Term]) -> None:
        self.grams = grams
        self.terms: list[Term] = []  # without their rows
        raw: list[int] = []  # index of the tail with the columns of each term
        mixed: list[Array | None] = []

        def tails() -> Iterator[Tail]:
            before = None
            count = 0
            for t in terms:
                shapes, combinations = t.made_of
                if shapes is not before:
                    before = shapes
                    count += 1
                    yield tail_of(grams.bands, shapes)
                raw.append(count - 1)
                mixed.append(combinations)
                self.terms.append(t.without_rows())

        self.columns = SideBySide(grams.bands, tails())
        self._raw = [self.columns.slices[k] for k in raw]
        self._mixed = mixed
        self.sizes = np.array([t.count + (t.offset is not None) for t in self.terms], dtype=int)
        self.at = np.concatenate([[0], np.cumsum(self.sizes)])
        self._mix = self._combinations()
        self.with_base = self.columns.products(grams.base)
        # Terms with the same number of columns are stacked.
        own = [self._own(t) for t in range(len(self.terms))]
        self.place = np.zeros(len(self.terms), dtype=int)
        self.own: dict[int, Array] = {}
        for k in np.unique(self.sizes):
            alike = np.flatnonzero(self.sizes == k)
            self.place[alike] = np.arange(len(alike))
            self.own[int(k)] = np.stack([own[t] for t in alike])
        self.squares = np.zeros((len(grams.bands.n), 0))
        if own:
            self.squares = np.concatenate([np.einsum("bii->bi", one) for one in own], axis=1)
        self.chosen: dict[int, float] = {}
        self._proposed: dict[int, Term] = {}
        self._with: dict[object, list[Array]] = {}
        self._gained: dict[object, Gained] = {}
        self._screens: dict[object, Screen] = {}
        self._whole: tuple[Posterior, Array, Array] | None = None  # of the last fit

    def _combinations(self) -> csr_array:
        """Return the combinations (c, raw) of the stored columns that give those of the terms."""
        rows = [np.zeros(0, dtype=int)]
        columns = [np.zeros(0, dtype=int)]
        values = [np.zeros(0)]
        for raw, mixed, at in zip(self._raw, self._mixed, self.at, strict=False):
            own = np.eye(raw.stop - raw.start) if mixed is None else mixed
            of, to = np.indices(own.shape)
            rows.append(at + to.ravel())
            columns.append(raw.start + of.ravel())
            values.append(own.ravel())
        places = np.concatenate(rows), np.concatenate(columns)
        shape = int(self.at[-1]), self.columns.count
        return csr_array((np.concatenate(values), places), shape=shape)

    def _own(self, t: int) -> Array:
        """Return the products (B, k, k) of the columns of a term with one another."""
        found = self.columns.squares(self._raw[t])
        mixed = self._mixed[t]
        return found if mixed is None else mixed.T @ found @ mixed

    def _apart(self, terms: tuple[Term, ...]) -> Screen:
        """Return the screen of terms without some shares of their columns."""
        return kept(
            self._screens, tuple(t.ident for t in terms), lambda: Screen(self.grams, terms), SCREENS
        )

    def _with_terms(self, terms: Sequence[Term]) -> list[list[Array]]:
        """Return the products (c', B', m) of each group with the columns of each term.

        New ones are computed in one pass over the columns.
        """
        new = [t for t in terms if t.ident not in self._with]
        made: dict[Ident, list[Array]] = {}
        if new:
            columns = [self.grams.columns(t) for t in new]
            ends = np.cumsum([one.shape[1] for one in columns])[:-1]
            groups = self.columns.products(self.grams.bands.side_by_side(columns))
            of_groups = [np.split(group, ends, axis=2) for group in groups]
            for t, *own in zip(new, *of_groups, strict=True):
                made[t.ident] = [one.copy() for one in own]
        known = {t.ident: self._with[t.ident] for t in terms if t.ident not in made} | made
        return [
            kept(self._with, t.ident, partial(known.__getitem__, t.ident), PRODUCTS) for t in terms
        ]

    def _beside(self, fit: Fit, among: Indices | None = None) -> Beside:
        """Return the products of columns of terms with a fit.

        among: indices of the terms; None for all.
        """
        mix = self._mix
        needed = np.arange(self.columns.count)
        if among is not None and len(among) < len(self.terms):
            mix = mix[np.concatenate([np.arange(self.at[t], self.at[t + 1]) for t in among])]
            needed = np.unique(mix.indices)
            mix = mix[:, needed]
        lacking = fit.model.lacking(fit.terms)
        terms = [self.grams.less(t, lacking) for t in fit.terms]
        moved = self.grams.moved_by(lacking)
        products = self._with_terms([*lacking, *terms])
        of_shares = products[: len(lacking)]
        of_terms = products[len(lacking) :]
        w = 1.0 / fit.found.v
        own, x = np.split(fit.found.x, [moved.shape[1]])
        groups: list[Group] = []
        C: list[Array] = []
        left: list[Array] = []
        for g, some in enumerate(self.columns.among(needed)):
            base = self.with_base[g][some]
            rest = base[:, :, 0]
            shares = [base[:, :, :0], *(one[g][some] for one in of_shares)]
            linear = [base[:, :, :0]]
            for t, one in zip(terms, of_terms, strict=True):
                with_term = one[g][some]
                linear.append(with_term[:, :, int(t.offset is not None) :])
                if t.offset is not None:
                    rest = rest - with_term[:, :, 0]
            group = Group(base[:, :, 1:], np.concatenate(shares, 2), np.concatenate(linear, 2))
            rest = rest - group.numbers @ own - group.terms @ x + group.shares @ (moved @ own)
            first = self.columns.firsts[g]
            with_numbers, with_shares, with_terms = (w[first:] @ one for one in group)
            groups.append(group)
            C.append(np.hstack([with_numbers - with_shares @ moved, with_terms]))
            left.append(np.pad(rest, ((0, 0), (first, 0))))
        return Beside(mix @ np.concatenate(C), mix @ np.concatenate(left), needed, groups, moved)

    def _moving_with(self, beside: Beside, t: int, beta: Array, way: Array) -> Array:
        """Return the products (B,) of a term's contribution with the change of a fit by a change
        `way` (p,) of its coefficients."""
        raw = self._raw[t]
        mixed = self._mixed[t]
        g = self.columns.group_of(raw)
        first = self.columns.firsts[g]
        begin, start = np.searchsorted(beside.needed, [raw.start, self.columns.begins[g]])
        own = slice(int(begin - start), int(begin - start) + raw.stop - raw.start)
        weights = beta if mixed is None else mixed @ beta
        of_numbers, of_terms = np.split(way, [beside.moved.shape[1]])
        changes = of_numbers, -beside.moved @ of_numbers, of_terms
        found = sum(one[own] @ x for one, x in zip(beside.groups[g], changes, strict=True))
        return np.concatenate([np.zeros(first), weights @ found])

    def beside(self, fit: Fit) -> tuple[Array, Array]:
        """Return the products (c, c) of the columns of the only term, and those with the residual
        (c,), beside a fit.

        They are Schur complements: without the part that the coefficients of the fit can explain,
        at the noise of the fit.
        """
        (own,) = self.own.values()
        w = 1.0 / fit.found.v
        found = self._beside(fit)
        return np.tensordot(w, own[0], 1) - found.C @ fit.found.S @ found.C.T, found.left @ w

    def related(self, fit: Fit, term: Term) -> set[int]:
        """Return the terms that could replace a term of a fit, by the correlation of their
        coefficients."""
        if not self.terms:
            return set()
        if self._whole is None or self._whole[0] is not fit.found:
            w = 1.0 / fit.found.v
            C = self._beside(fit).C
            CS = C @ fit.found.S
            left = w @ self.squares - np.einsum("ij,ij->i", C, CS)
            self._whole = fit.found, CS, np.maximum(left, 0.0)
        _, CS, G = self._whole
        own = fit.slices[term.ident]
        shared = CS[:, own].T ** 2
        alike = shared >= RELATED**2 * (shared + np.outer(np.diag(fit.found.S)[own], G))
        return set(np.repeat(np.arange(len(self.terms)), self.sizes)[alike.any(axis=0)].tolist())

    def gains(self, fit: Fit, among: Iterable[int] | None = None) -> Array:
        """Return the gain of each term beside a fit (T,), nats, including its prior odds, and
        choose the sizes of laws.

        For the terms with the largest gains, it includes the gain by a reduction of the noise.

        among: indices of the terms; the others have no gain. None for all.
        """
        which = None if among is None else frozenset(among)
        key = fit.model.assumed, frozenset(t.ident for t in fit.terms), which
        gained = kept(self._gained, key, partial(self._gains, fit, which), GAINED)
        self.chosen |= gained.chosen
        return gained.nats

    def _gains(self, fit: Fit, among: Iterable[int] | None) -> Gained:
        """Compute the gains and sizes of :meth:`gains`."""
        gains = np.full(len(self.terms), -np.inf)
        chosen: dict[int, float] = {}
        which = range(len(self.terms)) if among is None else sorted(among)
        lacking = fit.model.lacking(fit.terms)
        apart: dict[int, Term] = {}
        for t in which:
            if self.grams.lacks(self.terms[t], lacking):
                apart[t] = self.grams.less(self._whole_term(t), lacking)
        if apart:
            screen = self._apart(tuple(apart.values()))
            gains[list(apart)] = screen.gains(fit)
            chosen |= {t: screen.chosen[i] for i, t in enumerate(apart) if i in screen.chosen}
        some = np.array([t for t in which if t not in apart], dtype=int)
        if not len(some):
            return Gained(gains, chosen)
        beside = self._beside(fit, some)
        first = self._first_gains(fit, some, beside)
        rough = first.nats + self._quieter(fit, first.less)
        best = np.argsort(-first.nats)[:LOOKED_AT]
        best_roughly = np.argsort(-rough)[:LOOKED_AT]
        short = np.unique(np.concatenate([best, best_roughly]))
        moved = self._less_with_fit(fit, some, beside, first, short)
        gains[some] = first.nats
        gains[some[short]] += self._quieter(fit, moved)
        return Gained(gains, chosen | first.chosen)

    def _first_gains(self, fit: Fit, some: Indices, beside: Beside) -> FirstGains:
        """Return the gains of some terms (T',) at the noise of a fit."""
        w = 1.0 / fit.found.v
        C = beside.C
        CS = C @ fit.found.S
        b = beside.left @ w
        sizes = self.sizes[some]
        at = np.concatenate([[0], np.cumsum(sizes)])
        found = FirstGains(
            np.full(len(some), -np.inf), np.zeros((len(w), len(some))), {}, {}, CS, at
        )
        for k, own in self.own.items():
            here = np.flatnonzero(sizes == k)
            if not len(here):
                continue
            columns = at[here, None] + np.arange(k)
            squares = own[self.place[some[here]]].reshape(len(here), len(w), k * k)
            G = (w @ squares).reshape(-1, k, k) - C[columns] @ CS[columns].transpose(0, 2, 1)
            terms = [self.terms[t] for t in some[here]]
            gains_of = _first_order if k == 1 else _several
            gain, beta, best = gains_of(fit.model, terms, G, b[columns])
            found.nats[here] = gain
            found.mean.update(zip(here.tolist(), beta, strict=True))
            for t, size in zip(some[here].tolist(), best, strict=True):
                if size is not None:
                    found.chosen[t] = size
            of_pairs = (beta[:, :, None] * beta[:, None, :]).reshape(-1, k * k, 1)
            found.less[:, here] = 2.0 * (beta[:, None, :] @ beside.left[columns])[:, 0].T
            found.less[:, here] -= (squares @ of_pairs)[:, :, 0].T
        return found

    def _less_with_fit(
        self,
        fit: Fit,
        some: Indices,
        beside: Beside,
        first: FirstGains,
        short: Indices,
    ) -> Array:
        """Return by how much a few terms reduce the squares of each band (B, T'').

        The coefficients of the fit move with those of the term.
        """
        of_fit = fit.model.assumed, fit.terms
        H, left = kept(fit.model.spreads, of_fit, fit.spread, 1)
        means = [first.mean[int(t)] for t in short]
        changes = []
        for t, beta in zip(short, means, strict=True):
            own = slice(first.at[t], first.at[t + 1])
            changes.append(beta @ first.CS[own])
        back = -np.stack(changes, axis=1)
        mixed = []
        for t, beta, way in zip(some[short].tolist(), means, back.T, strict=True):
            mixed.append(self._moving_with(beside, t, beta, way))
        moved = first.less[:, short] + 2.0 * (left @ back) - np.sum(H @ back * back, axis=1)
        return moved - 2.0 * np.stack(mixed, axis=1)

    @staticmethod
    def _quieter(fit: Fit, less: Array) -> Array:
        """Return the gain (T,) by the reduction of the noise if terms reduce the squares of each
        band by `less` (B, T)."""
        own = fit.found.v > 1.0  # elsewhere the noise does not change
        n = fit.model.bands.n[own, None]
        v = fit.found.v[own, None]
        left = fit.found.left[own, None]
        now = np.maximum(left - less[own], 1e-9)
        quiet = np.maximum(now / n, 1.0)
        # Without the gain at the same noise, which is counted already.
        gain = n * np.log(v / quiet) + left / v - now / quiet - (left - now) / v
        return np.sum(0.5 * gain, axis=0)

    def term(self, t: int) -> Term:
        """Return a term at the size chosen by :meth:`gains`, with its own copy of the columns: a
        set with the term outlives this screen."""
        term = self._whole_term(t)
        return term.at_size(self.chosen[t]) if t in self.chosen else term

    def _whole_term(self, t: int) -> Term:
        """Return a term with all rows of its columns."""
        if t not in self._proposed:
            shapes = self.columns.some(self._raw[t]).copy()
            self._proposed[t] = self.terms[t].with_rows(shapes)
        return self._proposed[t]


Gains = tuple[Array, Array, list[float | None]]


def _first_order(model: LinearModel, terms: Sequence[Term], G: Array, b: Array) -> Gains:
    """Return the gains (T,) of terms of one column at their best scales, their coefficients (T, 1),
    and these scales."""
    G = np.maximum(G[:, 0, 0], 0.0)
    b = b[:, 0]
    price = np.array([t.price + model.doubt(t) for t in terms])
    fixed = np.array([t.offset is not None for t in terms])
    std = np.array([1.0 if t.offset is not None else t.std[0] for t in terms])
    low = np.array([-np.inf if t.offset is not None else t.low[0] for t in terms])
    high = np.array([np.inf if t.offset is not None else t.high[0] for t in terms])
    bounded = np.isfinite(low) | np.isfinite(high)
    gained: list[Array] = []
    means: list[Array] = []
    for scale in SCALES:
        prior = scale * std
        variance = 1.0 / (G + prior**-2.0)
        mean = variance * b
        gain = 0.5 * mean * b + 0.5 * np.log(variance / prior**2)
        bounds = low[bounded], high[bounded]
        after = mass(mean[bounded], np.sqrt(variance[bounded]), *bounds)
        gain[bounded] += after - mass(np.zeros(1), prior[bounded], *bounds)
        gained.append(gain)
        means.append(mean)
    best = np.argmax(gained, axis=0)
    mean = np.where(fixed, 1.0, np.take_along_axis(np.array(means), best[None], axis=0)[0])
    found = np.where(fixed, b - 0.5 * G, np.max(gained, axis=0) - np.log(len(SCALES))) - price
    sizes = [None if one else float(scale) for one, scale in zip(fixed, SCALES[best], strict=True)]
    return found, mean[:, None], sizes


def _several(model: LinearModel, terms: Sequence[Term], G: Array, b: Array) -> Gains:
    """Return the same for terms with several columns, such as nonparametric laws."""
    laws = np.array([isinstance(t, LawTerm) for t in terms])
    std = np.array([np.ones(b.shape[1]) if isinstance(t, LawTerm) else t.std for t in terms])
    e, U = np.linalg.eigh(G * std[:, :, None] * std[:, None, :])
    e = np.maximum(e, 0.0)
    z = np.einsum("tij,ti->tj", U, b * std)

    def at(size: float) -> Array:
        return 0.5 * np.sum(z**2 / (e + size**-2.0) - np.log1p(e * size * size), axis=1)

    # The gain of a law is averaged over its sizes, which have no prior; the scale of an effect is
    # chosen.
    of_laws = np.stack([at(a) for a in SIZES])
    of_effects = np.stack([at(s) for s in SCALES])
    size = np.where(laws, SIZES[np.argmax(of_laws, axis=0)], SCALES[np.argmax(of_effects, axis=0)])
    gain = np.where(
        laws,
        logsumexp(of_laws, axis=0) - np.log(len(SIZES)),
        of_effects.max(axis=0) - np.log(len(SCALES)),
    )
    mean = std * np.einsum("tij,tj->ti", U, z / (e + size[:, None] ** -2.0))
    return (
        gain - np.array([t.price + model.doubt(t) for t in terms]),
        mean,
        [float(s) for s in size],
    )
