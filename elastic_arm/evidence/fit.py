"""The posterior of a set of terms at one linearisation, and the score of the set.

    y = N nu + sum over the terms t of the set of (o_t + X_t beta_t) + e        (docs/diagnosis.md)
    score = ln p(y | S, tau) + ln p(S, tau)

y is the whitened residual (rows,), N (rows, K) are its columns by the numbers nu of arm and
sensors, X_t (rows, k) the columns of a term, o_t the part of a term without coefficients, and e
noise. Only the combinations V (K, k) of the numbers that the data determine are fitted
(:attr:`LinearModel.basis`). The posterior is that of the coefficients (V'nu, beta).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.evidence.grams import Bands, Grams, kept
from elastic_arm.evidence.keys import Ident, Key
from elastic_arm.evidence.posterior import Posterior, Prior, posterior
from elastic_arm.evidence.priors import AS_BUILT, MEASURED, TRUST, ZEROS, Assumed
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Term

# factors of the prior's deviation up to which the data may determine something
WIDEST = {"arm": max(one.factor for one in TRUST.values()), "zero": max(ZEROS)}
FITS = 100  # fits that are kept; memory
# factor of the trust below which the numbers of a description lie where it has them; numerical
EXACT = 0.1
# Of sensors, only a simulation's description states how they are; details of how a law is met are
# in no description.
KINDS = ("arm", "sensor", "detail", "zero")
# share of a prior's precision: data that add less to it determine nothing; numerical
UNTOLD = 1e-3


class Frame(NamedTuple):
    """What makes scores of different linearisations comparable: a correction of
    level + share * (ln of the density at a linearisation), nats."""

    level: float
    share: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The posterior of one set of terms."""

    model: LinearModel
    terms: tuple[Term, ...]
    found: Posterior  # of the p coefficients: of the combinations of numbers, then of the terms
    correction: float = 0.0  # of the score, to compare with scores at another linearisation

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
        at = self.model.basis[0].shape[1]
        found = {}
        for t in self.terms:
            found[t.ident] = slice(at, at + t.count)
            at += t.count
        return found

    def spread(self) -> tuple[Array, Array]:
        """Return the products of its columns (B, p, p), and of what is left with them (B, p)."""
        products = self.model.grams.of(self.terms, self.model.lacking(self.terms))
        p = len(self.found.x)
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

    @property
    def deviations(self) -> Array:
        """Where (K,) it puts the numbers, in deviations from the description."""
        return self.numbers - self.model.mean

    @cached_property
    def number_covariance(self) -> Array:
        """Their covariance (K, K)."""
        V, _ = self.model.basis
        moves = self.moves
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
        x = self.found.x
        S = self.found.S
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
        S = self.found.S
        a = self.slices[one.ident]
        b = self.slices[other.ident]
        std = np.sqrt(np.diag(S))
        return float(np.max(np.abs(S[a, b]) / np.outer(std[a], std[b]), initial=0.0))

    def gain_of_scale(self, term: Term, scale: float) -> float:
        """Return what a term would gain, nats, if its size had a prior of another scale, at the
        same noise."""
        return self._gain_of_width(term, scale / term.scale)

    def gain_of_size(self, law: Term, size: float) -> float:
        """Return what a nonparametric law would gain, nats, at another size, at the same noise."""
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


@dataclass(eq=False)
class LinearModel:
    """The data at one linearisation."""

    y: Array  # (rows,) whitened residual
    N: Array  # (rows, K) columns of the numbers, for one standard deviation each
    bands: Bands  # of the rows
    # (K,) prior means of the numbers' coefficients, whose standard deviation is the trust
    mean: Array
    kinds: NDArray[np.intp]  # (K,) of which kind they are (:data:`KINDS`)
    # (K,) at which numbers' values the residuals are made; the others act linearly
    moving: NDArray[np.bool_]
    always: tuple[Term, ...] = ()  # terms that are known to be there
    # what other terms add to columns of the numbers (:func:`.shares_of`)
    shares: tuple[ShareTerm, ...] = ()
    assumed: Assumed = AS_BUILT  # trust in the description, scale of the zeros
    # ln of the density of what was recorded over that of the rows (:attr:`.WhitenedData.density`)
    density: float = 0.0
    # (rows,) of recordings that are fitted; None for all
    fitted_rows: NDArray[np.bool_] | None = None
    # what every real drive has and the description does not state
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
        """Combinations V (K, k) of the numbers that the data determine at all, and their kinds
        (k,).

        Priors of equal width stay so in any orthonormal basis; of the rest the posterior is the
        prior.
        """
        found = [np.zeros((len(self.mean), 0))]
        kinds = [np.zeros(0, dtype=int)]
        for kind in np.unique(self.kinds):
            own = np.flatnonzero(self.kinds == kind)
            columns = self.N[:, own]
            e, U = np.linalg.eigh(columns.T @ columns)
            is_determined = e * WIDEST.get(KINDS[kind], 1.0) ** 2 > UNTOLD
            V = np.zeros((len(self.mean), int(is_determined.sum())))
            V[own] = U[:, is_determined]
            found.append(V)
            kinds.append(np.full(V.shape[1], kind))
        return np.hstack(found), np.concatenate(kinds)

    def without_data(self) -> LinearModel:
        """Return it without residual and columns, for what is known of its fits."""
        y = self.y[:0].copy()
        N = self.N[:0].copy()
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
        other.basis = self.basis
        other.grams = self.grams
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
        whole = (*self.always, *terms)
        V, kinds = self.basis
        free = np.full(V.shape[1], np.inf)
        mean = [V.T @ self.mean]
        std = [self.factors(kinds)]
        low = [-free]
        high = [free]
        for t in whole:
            mean.append(t.mean)
            std.append(t.std_at(self.trust))
            low.append(t.low)
            high.append(t.high)
        prior = Prior(*(np.concatenate(parts) for parts in (mean, std, low, high)))
        found = self._posterior(whole, prior, None if near is None else near.found.v)
        fit = Fit(self, whole, found)
        existing = sum(t.log_existing(fit) for t in whole)
        return whole, replace(found, evidence=found.evidence + existing)
