"""The data of a diagnosis at one linearisation: fits of sets of terms, and what each further term
would gain."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import logsumexp

from elastic_arm.arrays import Array
from elastic_arm.evidence.grams import Bands, Grams, kept
from elastic_arm.evidence.keys import Ident, Key
from elastic_arm.evidence.posterior import Posterior, Prior, mass, posterior
from elastic_arm.evidence.priors import (
    AS_BUILT,
    MEASURED,
    RELATED,
    SCALES,
    SIZES,
    TRUST,
    ZEROS,
    Assumed,
)
from elastic_arm.evidence.side_by_side import SideBySide, tail_of
from elastic_arm.evidence.tails import Tail
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Term

# factors of the prior's deviation up to which the data may tell something
WIDEST = {"arm": max(one.factor for one in TRUST.values()), "zero": max(ZEROS)}
# screens, products with all terms, gains and fits that are kept; memory
SCREENS, PRODUCTS, GAINED, FITS = 2, 40, 100, 100
# factor of the trust below which the numbers of a description lie where it has them; numerical
EXACT = 0.1
LOOKED_AT = 30  # terms of which first-order gains are made well; numerical
# Of sensors, only a simulation's description says how they are; details of how a law is met are in
# no description.
KINDS = "arm", "sensor", "detail", "zero"
UNTOLD = 1e-3  # of a prior's precision: what data tell no more of, they tell nothing of; numerical


class Frame(NamedTuple):
    """What makes scores of different linearisations comparable: a correction of
    level + share * (ln of the density at a linearisation), nats."""

    level: float
    share: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The posterior of one set of terms."""

    # model, terms: of what
    model: LinearModel
    terms: tuple[Term, ...]
    found: Posterior  # posterior of the numbers' coefficients and the terms'
    correction: float = (
        0.0  # of the score, by which it compares with scores at another linearisation
    )

    @property
    def score(self) -> float:
        """ln p(y, set) up to a constant of the data."""
        prices = sum(t.price + self.model.doubt(t) for t in self.optional)
        return self.found.evidence - prices + self.model.assumption + self.correction

    @property
    def frame(self) -> Frame:
        """What scores at other linearisations compare by.

        Linearisations predict different noise, so that the same recorded values have different
        densities. Where this fit leaves less than its noise, these differ by as much less.
        """
        share = float(np.sum(self.found.left / self.found.v) / len(self.model.y))
        return Frame(self.correction - share * self.model.density, share)

    def compared_in(self, frame: Frame) -> Fit:
        """Return the fit with a score that compares with that of the fit of a frame."""
        return replace(self, correction=frame.level + frame.share * self.model.density)

    def without_data(self) -> Fit:
        """Return it without the data: what its score and its coefficients say stays."""
        return replace(self, model=self.model.without_data())

    @cached_property
    def slices(self) -> dict[Ident, slice]:
        """Where the coefficients of each term stand."""
        at, found = self.model.basis[0].shape[1], {}
        for t in self.terms:
            found[t.ident] = slice(at, at + t.count)
            at += t.count
        return found

    def spread(self) -> tuple[Array, Array]:
        """Return the products of its columns (B, p, p), and of what is left with them (B, p)."""
        products, p = (
            self.model.grams.of(self.terms, self.model.lacking(self.terms)),
            len(self.found.x),
        )
        H = np.zeros((len(products.yy), p, p))
        rows, columns = np.tril_indices(p)
        H[:, rows, columns] = H[:, columns, rows] = products.half
        return H, products.b - H @ self.found.x

    @property
    def optional(self) -> tuple[Term, ...]:
        """The terms that need not be there."""
        return self.terms[len(self.model.always) :]

    @property
    def keys(self) -> frozenset[Key]:
        """Which of them are there."""
        return frozenset(t.key for t in self.optional)

    @property
    def moves(self) -> Array:
        """How the numbers move with the coefficients (K, p), what is far off included."""
        V, _ = self.model.basis
        found = np.zeros((len(V), len(self.found.x)))
        found[:, : V.shape[1]] = V
        for t in self.optional:
            if isinstance(t, NumberTerm):
                found += t.along @ self.rows(t)
        return found

    @cached_property
    def numbers(self) -> Array:
        """Posterior means (K,) of the numbers' coefficients, what is far off included."""
        V, _ = self.model.basis
        return self.moves @ self.found.x + self.model.mean - V @ (V.T @ self.model.mean)

    @cached_property
    def number_covariance(self) -> Array:
        """Their covariance (K, K)."""
        (V, _), moves = self.model.basis, self.moves
        own = self.model.factors(self.model.kinds)
        return moves @ self.found.S @ moves.T + np.outer(own, own) * (np.eye(len(V)) - V @ V.T)

    @property
    def far_off(self) -> Array:
        """The part (K,) of the numbers that is far off."""
        return sum(
            (t.along @ self.beta(t) for t in self.optional if isinstance(t, NumberTerm)),
            np.zeros(len(self.model.mean)),
        )

    def held(self, which: Sequence[int], at: Array) -> Fit:
        """Return the posterior where some numbers (m,) are known to be at values (m,), the rest
        refitted.

            x' = x - K (R x - at),   S' = S - K R S,   K = S R' (R S R')^-1
        """
        R = self.moves[list(which)]
        x, S = self.found.x, self.found.S
        K = S @ R.T @ np.linalg.pinv(R @ S @ R.T)
        off = self.numbers[list(which)] - at
        return replace(self, found=replace(self.found, x=x - K @ off, S=S - K @ R @ S))

    def rows(self, term: Term) -> Array:
        """Return the coefficients (k, p) of a term by the fit's: of one that changes, its mean over
        fitted ones."""
        found = np.zeros((term.count, len(self.found.x)))
        found[:, self.slices[term.ident]] = np.eye(term.count)
        linear = term.linear or term.count
        for change in self.optional:
            if not isinstance(change, ChangeTerm) or not change.is_of(term):
                continue
            first = self.slices[change.ident].start
            own = slice(first, first + change.fitted * linear)
            found[:linear, own] += np.tile(np.eye(linear), change.fitted) / change.fitted
        return found

    def raw(self, term: Term) -> Array:
        """Return the coefficients (k,) of a term's columns."""
        return self.found.x[self.slices[term.ident]]

    def beta(self, term: Term) -> Array:
        """Return the coefficients (k,) of a term; of one that changes between recordings, with
        their mean change."""
        return self.rows(term) @ self.found.x

    def correlation(self, one: Term, other: Term) -> float:
        """Return the largest correlation of coefficients of two terms."""
        S, a, b = self.found.S, self.slices[one.ident], self.slices[other.ident]
        std = np.sqrt(np.diag(S))
        return float(np.max(np.abs(S[a, b]) / np.outer(std[a], std[b]), initial=0.0))

    def gain_of_scale(self, term: Term, scale: float) -> float:
        """Return what a term would gain, nats, if its size had a prior of another scale, at the
        same noise."""
        return self._gain_of_width(term, scale / term.scale)

    def gain_of_size(self, law: Term, size: float) -> float:
        """Return what a law without a form would gain, nats, at another size, at the same noise."""
        return self._gain_of_width(law, size / float(law.std[0]))

    def _gain_of_width(self, term: Term, ratio: float) -> float:
        """Return what a term gains, nats, where the prior of its linear coefficients is wider by a
        ratio."""
        own = slice(self.slices[term.ident].start, self.slices[term.ident].start + term.linear)
        P = term.std[: term.linear] ** -2.0
        more = P * (ratio**-2.0 - 1.0)
        A = np.eye(term.linear) + self.found.S[own, own] * more
        x = self.found.x[own]
        moved = (more * x) @ np.linalg.solve(A, x)
        return float(-term.linear * np.log(ratio) - 0.5 * np.linalg.slogdet(A)[1] - 0.5 * moved)

    def covariance(self, term: Term) -> Array:
        """Return their covariance (k, k)."""
        rows = self.rows(term)
        return rows @ self.found.S @ rows.T


class Gained(NamedTuple):
    """What terms would gain beside a fit (T,) nats, and the sizes of laws at which they do."""

    nats: Array
    chosen: dict[int, float]


class Group(NamedTuple):
    """Products of some columns of terms with those of a fit, in the bands from a first one on."""

    numbers: Array  # (c', B', K) with the numbers' columns, shares of effects in them
    shares: Array  # (c', B', M) with those of these shares that are not there
    terms: Array  # (c', B', p') with the terms' columns


class Beside(NamedTuple):
    """What columns of terms have in common with a fit."""

    C: Array  # (c, p) products with its columns, at its noise
    left: Array  # (c, B) products with what it leaves
    needed: NDArray[np.intp]  # the stored columns of which they are made
    groups: list[Group]  # of these columns
    moved: Array  # (M, K) what of the shares is in the numbers' columns


class Screen:
    """Products of many terms with the residual and the numbers, for what each would gain.

    terms: one after the other, as all rows of all of them are large.
    """

    def __init__(self, grams: Grams, terms: Iterable[Term]) -> None:
        self.grams = grams
        self.terms: list[Term] = []  # without their rows
        raw: list[int] = []  # in which of the tails the shapes of each term are
        mixed: list[Array | None] = []

        def tails() -> Iterator[Tail]:
            before, count = None, 0
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
        # Terms of as many columns side by side.
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
        """Return of what combinations (c, raw) of the stored columns those of the terms are."""
        rows, columns, values = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)], [np.zeros(0)]
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
        found, mixed = self.columns.squares(self._raw[t]), self._mixed[t]
        return found if mixed is None else mixed.T @ found @ mixed

    def _apart(self, terms: tuple[Term, ...]) -> Screen:
        """Return the screen of terms without some shares of their columns."""
        return kept(
            self._screens, tuple(t.ident for t in terms), lambda: Screen(self.grams, terms), SCREENS
        )

    def _with_terms(self, terms: Sequence[Term]) -> list[list[Array]]:
        """Return the products (c', B', m) of each group with the columns of each term.

        New ones are made in one pass over the columns.
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

    def _beside(self, fit: Fit, among: NDArray[np.intp] | None = None) -> Beside:
        """Return what the columns of terms have in common with a fit; among: of which; None for
        all."""
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
        of_shares, of_terms = products[: len(lacking)], products[len(lacking) :]
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
        """Return the products (B,) of what a term adds with what a fit's columns add where its
        coefficients change by (p,)."""
        raw, mixed = self._raw[t], self._mixed[t]
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
        """Return the products (c, c) of the columns of its only term and of these with the residual
        (c,) beside a fit.

        What the fit's coefficients can take is taken off (a Schur complement), at the noise of the
        fit.
        """
        (own,) = self.own.values()
        w, found = 1.0 / fit.found.v, self._beside(fit)
        return np.tensordot(w, own[0], 1) - found.C @ fit.found.S @ found.C.T, found.left @ w

    def related(self, fit: Fit, term: Term) -> set[int]:
        """Return the terms that could stand for a term of a fit, by the correlation of their
        coefficients."""
        if not self.terms:
            return set()
        if self._whole is None or self._whole[0] is not fit.found:
            w, C = 1.0 / fit.found.v, self._beside(fit).C
            CS = C @ fit.found.S
            left = w @ self.squares - np.einsum("ij,ij->i", C, CS)
            self._whole = fit.found, CS, np.maximum(left, 0.0)
        _, CS, G = self._whole
        own = fit.slices[term.ident]
        shared = CS[:, own].T ** 2
        alike = shared >= RELATED**2 * (shared + np.outer(np.diag(fit.found.S)[own], G))
        return set(np.repeat(np.arange(len(self.terms)), self.sizes)[alike.any(axis=0)].tolist())

    def gains(self, fit: Fit, among: Iterable[int] | None = None) -> Array:
        """Return what each term would gain beside a fit (T,) nats, its prior odds paid, and pick
        sizes of laws.

        What the noise gains that it makes smaller is counted of the terms that could gain most.

        among: the terms that count; the others gain nothing. None for all.
        """
        which = None if among is None else frozenset(among)
        key = fit.model.assumed, frozenset(t.ident for t in fit.terms), which
        gained = kept(self._gained, key, partial(self._gains, fit, which), GAINED)
        self.chosen |= gained.chosen
        return gained.nats

    def _gains(self, fit: Fit, among: Iterable[int] | None) -> Gained:
        """Return the same, made anew, and the sizes."""
        gains = np.full(len(self.terms), -np.inf)
        chosen: dict[int, float] = {}
        lacking = fit.model.lacking(fit.terms)
        which = range(len(self.terms)) if among is None else sorted(among)
        apart = {
            t: self.grams.less(self._whole_term(t), lacking)
            for t in which
            if self.grams.lacks(self.terms[t], lacking)
        }
        if apart:
            screen = self._apart(tuple(apart.values()))
            gains[list(apart)] = screen.gains(fit)
            chosen |= {t: screen.chosen[i] for i, t in enumerate(apart) if i in screen.chosen}
        some = np.array([t for t in which if t not in apart], dtype=int)
        if not len(some):
            return Gained(gains, chosen)
        w, S = 1.0 / fit.found.v, fit.found.S
        beside = self._beside(fit, some)
        C, left = beside.C, beside.left
        b = left @ w
        CS = C @ S
        at = np.concatenate([[0], np.cumsum(self.sizes[some])])
        mean: dict[int, Array] = {}
        less = np.zeros((len(w), len(some)))  # without what moves with it
        for k, own in self.own.items():
            here = np.flatnonzero(self.sizes[some] == k)
            if not len(here):
                continue
            columns = at[here, None] + np.arange(k)
            squares = own[self.place[some[here]]].reshape(len(here), len(w), k * k)
            G = (w @ squares).reshape(-1, k, k) - C[columns] @ CS[columns].transpose(0, 2, 1)
            terms = [self.terms[t] for t in some[here]]
            gain, beta, sizes = (_first_order if k == 1 else _several)(
                fit.model, terms, G, b[columns]
            )
            gains[some[here]] = gain
            chosen |= {
                int(t): size for t, size in zip(some[here], sizes, strict=True) if size is not None
            }
            mean |= dict(zip(here.tolist(), beta, strict=True))
            of_pairs = (beta[:, :, None] * beta[:, None, :]).reshape(-1, k * k, 1)
            less[:, here] = 2.0 * (beta[:, None, :] @ left[columns])[:, 0].T
            less[:, here] -= (squares @ of_pairs)[:, :, 0].T
        first = gains[some]
        rough = first + self._quieter(fit, less)
        short = np.unique(
            np.concatenate([np.argsort(-first)[:LOOKED_AT], np.argsort(-rough)[:LOOKED_AT]])
        )
        # What is there already moves with it.
        of_fit = fit.model.assumed, fit.terms
        H, own_left = kept(fit.model.spreads, of_fit, fit.spread, 1)
        changes = [(slice(at[t], at[t + 1]), mean[int(t)]) for t in short]
        back = -np.stack([beta @ CS[own] for own, beta in changes], axis=1)
        mixed = [
            self._moving_with(beside, int(some[t]), mean[int(t)], way)
            for t, way in zip(short, back.T, strict=True)
        ]
        moved = (
            less[:, short]
            + 2.0 * (own_left @ back)
            - np.sum(H @ back * back, axis=1)
            - 2.0 * np.stack(mixed, axis=1)
        )
        gains[some[short]] += self._quieter(fit, moved)
        return Gained(gains, chosen)

    @staticmethod
    def _quieter(fit: Fit, less: Array) -> Array:
        """Return what noise gains (T,) that is as much smaller as terms take off the squares of
        each band (B, T)."""
        own = fit.found.v > 1.0  # elsewhere the noise stays what it is
        n, v, left = (each[own, None] for each in (fit.model.bands.n, fit.found.v, fit.found.left))
        now = np.maximum(left - less[own], 1e-9)
        quiet = np.maximum(now / n, 1.0)
        # Beyond what the same noise makes of it, which is counted already.
        return np.sum(
            0.5 * (n * np.log(v / quiet) + left / v - now / quiet - (left - now) / v), axis=0
        )

    def term(self, t: int) -> Term:
        """Return a term as :meth:`gains` found it best, with columns of its own: a set that holds
        it outlives these."""
        term = self._whole_term(t)
        return term.at_size(self.chosen[t]) if t in self.chosen else term

    def _whole_term(self, t: int) -> Term:
        """Return a term with its rows."""
        if t not in self._proposed:
            shapes = self.columns.some(self._raw[t]).copy()
            self._proposed[t] = self.terms[t].with_rows(shapes)
        return self._proposed[t]


@dataclass(eq=False)
class LinearModel:
    """The data at one linearisation."""

    # y, N: (rows,), (rows, K) whitened residual, and columns of the numbers for one standard
    # deviation each
    y: Array
    N: Array
    bands: Bands  # of the rows
    # (K,) prior means of the numbers' coefficients, whose standard deviation is the trust
    mean: Array
    kinds: NDArray[np.intp]  # (K,) of which kind they are (:data:`KINDS`)
    moving: NDArray[
        np.bool_
    ]  # (K,) at which numbers' values the residuals are made; the others act linearly
    always: tuple[Term, ...] = ()  # terms that are known to be there
    # what other terms add to columns of the numbers (:func:`.shares_of`)
    shares: tuple[ShareTerm, ...] = ()
    assumed: Assumed = AS_BUILT  # trust in the description, scale of the zeros
    # ln of the density of what was recorded over that of the rows (:attr:`.WhitenedData.density`)
    density: float = 0.0
    # what every real drive has and the description does not state
    fitted_rows: NDArray[np.bool_] | None = (
        None  # (rows,) of recordings that are fitted; None for all
    )
    usual: frozenset[Key] = frozenset()
    # the same data without the judging rows
    parts: dict[str, LinearModel] = field(default_factory=dict)
    # Of the last fit, and of the last ones; the same under all assumptions. No fit is kept: it
    # holds the data, which would go only with the next collection of what holds itself.
    spreads: dict[object, tuple[Array, Array]] = field(default_factory=dict, repr=False)
    known: dict[object, tuple[tuple[Term, ...], Posterior]] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def basis(self) -> tuple[Array, NDArray[np.intp]]:
        """Combinations (K, k) of the numbers that the data tell anything of, and of which kind they
        are.

        Priors of equal width stay so in any orthonormal basis; of the rest the posterior is the
        prior.
        """
        found, kinds = [], []
        for kind in np.unique(self.kinds):
            own = np.flatnonzero(self.kinds == kind)
            columns = self.N[:, own]
            e, U = np.linalg.eigh(columns.T @ columns)
            told = e * WIDEST.get(KINDS[kind], 1.0) ** 2 > UNTOLD
            V = np.zeros((len(self.mean), int(told.sum())))
            V[own] = U[:, told]
            found.append(V)
            kinds.append(np.full(V.shape[1], kind))
        return np.hstack([np.zeros((len(self.mean), 0)), *found]), np.concatenate(
            [np.zeros(0, dtype=int), *kinds]
        )

    def without_data(self) -> LinearModel:
        """Return it without residual and columns, for what is known of its fits."""
        y, N = self.y[:0].copy(), self.N[:0].copy()
        found = replace(self, y=y, N=N, parts={}, spreads={}, known={})
        found.basis = self.basis
        return found

    def factors(self, kinds: NDArray[np.intp]) -> Array:
        """Return the factors on the standard deviations of numbers of some kinds."""
        sensor = self.trust if self.trust < EXACT else 1.0
        return np.array([self.trust, sensor, 1.0, sensor * self.assumed.zeros])[kinds]

    @cached_property
    def grams(self) -> Grams:
        """Products of residual and columns."""
        untold = self.mean - self.basis[0] @ (self.basis[0].T @ self.mean)
        return Grams(self.y - self.N @ untold, self.N, self.bands, self.basis[0])

    @property
    def trust(self) -> float:
        """Factor on the standard deviations of the numbers."""
        return TRUST[self.assumed.trust].factor

    @property
    def assumption(self) -> float:
        """The logarithm of the prior probability of what is assumed.

        The scale of the zeros has no alternative where there are none, and in a simulation.
        """
        trust = self.assumed.trust
        has_zeros = trust != MEASURED and bool(np.any(self.kinds == KINDS.index("zero")))
        scale = ZEROS[self.assumed.zeros] if has_zeros else 1.0
        return float(np.log(TRUST[trust].prior * scale))

    def doubt(self, term: Term) -> float:
        """Return -ln of the prior odds that one of the terms of a kind is there, nats."""
        return term.doubt(term.key in self.usual and self.assumed.trust != MEASURED)

    def lacking(self, terms: Sequence[Term]) -> tuple[ShareTerm, ...]:
        """Return the shares of the numbers' columns that are not there where some terms are."""
        there = {t.key for t in terms if t not in self.always}
        return tuple(share for share in self.shares if share.key not in there)

    def _posterior(self, terms: Sequence[Term], prior: Prior, start: Array | None) -> Posterior:
        coloured = float(np.log(TRUST[self.assumed.trust].coloured))
        return posterior(
            self.grams.of(terms, self.lacking(terms)),
            self.bands.n,
            prior,
            self.bands.place,
            coloured,
            start,
        )

    def of_fitted(self, fit: Fit) -> Fit:
        """Return the posterior of a set by the rows of the recordings that are fitted."""
        rows = self.fitted_rows
        if rows is None or rows.all():
            return fit
        if "fitted" not in self.parts:
            always = tuple(t.among(rows) for t in self.always)
            shares = tuple(t.among(rows) for t in self.shares)
            self.parts["fitted"] = replace(
                self,
                y=self.y[rows],
                N=self.N[rows],
                bands=self.bands.among(rows),
                always=always,
                shares=shares,
                fitted_rows=None,
                parts={},
                spreads={},
                known={},
            )
        part = self.parts["fitted"].assuming(self.assumed)
        return part.fit([t.among(rows) for t in fit.optional])

    def assuming(self, assumed: Assumed) -> LinearModel:
        """Return the same data with another trust in the description, or scale of the zeros."""
        if assumed == self.assumed:
            return self
        other = replace(self, assumed=assumed)
        other.basis, other.grams = self.basis, self.grams
        return other

    def fit(self, terms: Sequence[Term], near: Fit | None = None) -> Fit:
        """Return the posterior of a set of terms beside those that are known to be there.

        near: A fit of a similar set, where its noise starts.
        """
        terms = tuple(terms)
        key = self.assumed, frozenset(t.ident for t in terms)
        return Fit(self, *kept(self.known, key, lambda: self._fitted(terms, near), FITS))

    def _fitted(
        self, terms: tuple[Term, ...], near: Fit | None
    ) -> tuple[tuple[Term, ...], Posterior]:
        whole, (V, kinds) = (*self.always, *terms), self.basis
        free = np.full(V.shape[1], np.inf)
        prior = Prior(
            np.concatenate([V.T @ self.mean, *(t.mean for t in whole)]),
            np.concatenate([self.factors(kinds), *(t.std_at(self.trust) for t in whole)]),
            np.concatenate([-free, *(t.low for t in whole)]),
            np.concatenate([free, *(t.high for t in whole)]),
        )
        return whole, self._posterior(whole, prior, None if near is None else near.found.v)


Gains = tuple[Array, Array, list[float | None]]


def _first_order(model: LinearModel, terms: Sequence[Term], G: Array, b: Array) -> Gains:
    """Return what terms of one column gain (T,) with the scale that gains most, their sizes (T, 1),
    and the scales."""
    G, b = np.maximum(G[:, 0, 0], 0.0), b[:, 0]
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
        gain[bounded] += mass(
            mean[bounded], np.sqrt(variance[bounded]), low[bounded], high[bounded]
        ) - mass(np.zeros(1), prior[bounded], low[bounded], high[bounded])
        gained.append(gain)
        means.append(mean)
    best = np.argmax(gained, axis=0)
    mean = np.where(fixed, 1.0, np.take_along_axis(np.array(means), best[None], axis=0)[0])
    found = np.where(fixed, b - 0.5 * G, np.max(gained, axis=0) - np.log(len(SCALES))) - price
    sizes = [None if one else float(scale) for one, scale in zip(fixed, SCALES[best], strict=True)]
    return found, mean[:, None], sizes


def _several(model: LinearModel, terms: Sequence[Term], G: Array, b: Array) -> Gains:
    """Return the same of terms of as many columns each, laws without a form among them."""
    laws = np.array([isinstance(t, LawTerm) for t in terms])
    std = np.array([np.ones(b.shape[1]) if isinstance(t, LawTerm) else t.std for t in terms])
    e, U = np.linalg.eigh(G * std[:, :, None] * std[:, None, :])
    e, z = np.maximum(e, 0.0), np.einsum("tij,ti->tj", U, b * std)

    def at(size: float) -> Array:
        return 0.5 * np.sum(z**2 / (e + size**-2.0) - np.log1p(e * size * size), axis=1)

    # The size of a law is averaged over, as its prior is not stated; the scale of an effect is
    # chosen.
    of_laws, of_effects = np.stack([at(a) for a in SIZES]), np.stack([at(s) for s in SCALES])
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
