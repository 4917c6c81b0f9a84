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

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.evidence.grams import Bands, Grams, kept
from elastic_arm.evidence.keys import Ident, Key
from elastic_arm.evidence.posterior import Posterior, Prior, posterior
from elastic_arm.evidence.priors import AS_BUILT, MEASURED, TRUST, ZEROS, Assumed
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.dry_friction import choices
from elastic_arm.evidence.terms.known import KnownTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Term

# factors on the prior deviation up to which the data may determine a number
WIDEST = {"arm": max(one.factor for one in TRUST.values()), "zero": max(ZEROS)}
FITS = 100  # number of fits that are kept; memory
# trust factor below which the description counts as exact; numerical
EXACT = 0.1
# Only the description of a simulation states the sensors, and no description states details of
# laws.
KINDS = ("arm", "sensor", "detail", "zero")
# share of the prior precision below which data determine nothing; numerical
UNTOLD = 1e-3


class Frame(NamedTuple):
    """A correction that makes scores at different linearisations comparable:
    level + share * (ln of the density at a linearisation), nats."""

    level: float
    share: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The posterior of one set of terms."""

    model: LinearModel
    terms: tuple[Term, ...]
    found: Posterior  # of p coefficients: those of combinations of numbers, then those of the terms
    correction: float = (
        0.0  # added to the score, to compare it with scores at another linearisation
    )

    @property
    def score(self) -> float:
        """ln p(y, set) up to a constant of the data."""
        prices = sum(t.price + self.model.doubt(t) for t in self.optional)
        prices += choices(self.optional)
        return self.found.evidence - prices + self.model.assumption + self.correction

    @property
    def frame(self) -> Frame:
        """The frame in which scores at other linearisations compare with this one.

        Linearisations predict different noise, so the same recorded values have different
        densities. If this fit leaves less than its noise, the densities differ by that much less.
        """
        share = float(np.sum(self.found.left / self.found.v) / len(self.model.y))
        return Frame(self.correction - share * self.model.density, share)

    def compared_in(self, frame: Frame) -> Fit:
        """Return the fit with a score that compares in a frame."""
        return replace(self, correction=frame.level + frame.share * self.model.density)

    def without_data(self) -> Fit:
        """Return the fit without the data; score and coefficients stay."""
        return replace(self, model=self.model.without_data())

    @cached_property
    def slices(self) -> dict[Ident, slice]:
        """The slice of the coefficients of each term."""
        at = self.model.basis[0].shape[1]
        found = {}
        for t in self.terms:
            found[t.ident] = slice(at, at + t.count)
            at += t.count
        return found

    def spread(self) -> tuple[Array, Array]:
        """Return the products of its columns (B, p, p), and those with the residual (B, p)."""
        products = self.model.grams.of(self.terms, self.model.lacking(self.terms))
        p = len(self.found.x)
        H = np.zeros((len(products.yy), p, p))
        rows, columns = np.tril_indices(p)
        H[:, rows, columns] = H[:, columns, rows] = products.half
        return H, products.b - H @ self.found.x

    @property
    def optional(self) -> tuple[Term, ...]:
        """The terms that a set may lack."""
        return self.terms[len(self.model.always) :]

    @property
    def keys(self) -> frozenset[Key]:
        """The keys of the optional terms."""
        return frozenset(t.key for t in self.optional)

    @property
    def moves(self) -> Array:
        """The derivatives (K, p) of the numbers by the coefficients, including far-off numbers."""
        V, _ = self.model.basis
        found = np.zeros((len(V), len(self.found.x)))
        found[:, : V.shape[1]] = V
        for t in self.optional:
            if isinstance(t, NumberTerm):
                found += t.along @ self.rows(t)
        return found

    @cached_property
    def numbers(self) -> Array:
        """Posterior means (K,) of the numbers' coefficients, including far-off numbers."""
        V, _ = self.model.basis
        return self.moves @ self.found.x + self.model.mean - V @ (V.T @ self.model.mean)

    @property
    def deviations(self) -> Array:
        """The numbers (K,), in standard deviations from the description."""
        return self.numbers - self.model.mean

    @cached_property
    def number_covariance(self) -> Array:
        """The covariance (K, K) of the numbers."""
        V, _ = self.model.basis
        moves = self.moves
        own = self.model.factors(self.model.kinds)
        return moves @ self.found.S @ moves.T + np.outer(own, own) * (np.eye(len(V)) - V @ V.T)

    @property
    def far_off(self) -> Array:
        """The part (K,) of the numbers by terms of far-off numbers."""
        return sum(
            (t.along @ self.beta(t) for t in self.optional if isinstance(t, NumberTerm)),
            np.zeros(len(self.model.mean)),
        )

    def held(self, which: Sequence[int], at: Array) -> Fit:
        """Return the posterior with some numbers (m,) held at values (m,) and the others refitted.

        x' = x - K (R x - at),   S' = S - K R S,   K = S R' (R S R')^-1
        """
        R = self.moves[list(which)]
        x = self.found.x
        S = self.found.S
        K = S @ R.T @ np.linalg.pinv(R @ S @ R.T)
        off = self.numbers[list(which)] - at
        return replace(self, found=replace(self.found, x=x - K @ off, S=S - K @ R @ S))

    def rows(self, term: Term) -> Array:
        """Return the derivatives (k, p) of a term's coefficients by those of the fit; for a term
        that changes, of its mean over the fitted recordings."""
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
        """Return the coefficients (k,) of a term's columns, without changes."""
        return self.found.x[self.slices[term.ident]]

    def beta(self, term: Term) -> Array:
        """Return the coefficients (k,) of a term, including its mean change between recordings."""
        return self.rows(term) @ self.found.x

    def correlation(self, one: Term, other: Term) -> float:
        """Return the largest correlation between coefficients of two terms."""
        S = self.found.S
        a = self.slices[one.ident]
        b = self.slices[other.ident]
        std = np.sqrt(np.diag(S))
        return float(np.max(np.abs(S[a, b]) / np.outer(std[a], std[b]), initial=0.0))

    def gain_of_scale(self, term: Term, scale: float) -> float:
        """Return the gain of another scale of a term's size at the same noise, nats."""
        return self._gain_of_width(term, scale / term.scale)

    def gain_of_size(self, law: Term, size: float) -> float:
        """Return the gain of another size of a nonparametric law at the same noise, nats."""
        return self._gain_of_width(law, size / float(law.std[0]))

    def _gain_of_width(self, term: Term, ratio: float) -> float:
        """Return the gain of a prior of a term's linear coefficients that is wider by a ratio,
        nats."""
        own = slice(self.slices[term.ident].start, self.slices[term.ident].start + term.linear)
        P = term.std[: term.linear] ** -2.0
        more = P * (ratio**-2.0 - 1.0)
        A = np.eye(term.linear) + self.found.S[own, own] * more
        x = self.found.x[own]
        moved = (more * x) @ np.linalg.solve(A, x)
        return float(-term.linear * np.log(ratio) - 0.5 * np.linalg.slogdet(A)[1] - 0.5 * moved)

    def covariance(self, term: Term) -> Array:
        """Return the covariance (k, k) of the coefficients of a term."""
        rows = self.rows(term)
        return rows @ self.found.S @ rows.T


@dataclass(eq=False)
class LinearModel:
    """The data at one linearisation."""

    y: Array  # (rows,) whitened residual
    N: Array  # (rows, K) columns of the numbers, each for one standard deviation
    bands: Bands  # of the rows
    # (K,) prior means of the numbers' coefficients; their standard deviation is the trust
    mean: Array
    kinds: Indices  # (K,) kinds of the numbers (:data:`KINDS`)
    # (K,) whether the residuals depend on a number's value; the others act linearly
    moving: Mask
    always: tuple[Term, ...] = ()  # terms of all sets
    # contributions of other terms to columns of the numbers (:func:`.shares_of`)
    shares: tuple[ShareTerm, ...] = ()
    assumed: Assumed = AS_BUILT  # trust in the description, scale of the zeros
    # ln of the density of the recorded values over that of the rows (:attr:`.WhitenedData.density`)
    density: float = 0.0
    # (rows,) whether a row belongs to a fitted recording; None for all
    fitted_rows: Mask | None = None
    # terms that every real drive has and the description does not state
    usual: frozenset[Key] = frozenset()
    # the same data without the validation rows
    parts: dict[str, LinearModel] = field(default_factory=dict)
    # Results of the last fits, shared by all assumptions. Fits themselves are not kept: they refer
    # to the data, and such a cycle would be freed only by the garbage collector.
    spreads: dict[object, tuple[Array, Array]] = field(default_factory=dict, repr=False)
    known: dict[object, tuple[tuple[Term, ...], Posterior]] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def basis(self) -> tuple[Array, Indices]:
        """Combinations V (K, k) of the numbers that the data determine, and their kinds (k,).

        Priors of equal width stay equal in any orthonormal basis. The posterior of all other
        combinations is their prior.
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
        """Return the model without residual and columns."""
        y = self.y[:0].copy()
        N = self.N[:0].copy()
        found = replace(self, y=y, N=N, parts={}, spreads={}, known={})
        found.basis = self.basis
        return found

    def factors(self, kinds: Indices) -> Array:
        """Return the factors on the prior standard deviations of numbers, by their kinds."""
        sensor = self.trust if self.trust < EXACT else 1.0
        return np.array([self.trust, sensor, 1.0, sensor * self.assumed.zeros])[kinds]

    @cached_property
    def grams(self) -> Grams:
        """The products of residual and columns."""
        untold = self.mean - self.basis[0] @ (self.basis[0].T @ self.mean)
        return Grams(self.y - self.N @ untold, self.N, self.bands, self.basis[0])

    @property
    def trust(self) -> float:
        """The factor on the standard deviations of the numbers."""
        return TRUST[self.assumed.trust].factor

    @property
    def assumption(self) -> float:
        """The logarithm of the prior probability of the assumptions.

        Without zeros, and in a simulation, the scale of the zeros has no alternative.
        """
        trust = self.assumed.trust
        has_zeros = trust != MEASURED and bool(np.any(self.kinds == KINDS.index("zero")))
        scale = ZEROS[self.assumed.zeros] if has_zeros else 1.0
        return float(np.log(TRUST[trust].prior * scale))

    def doubt(self, term: Term) -> float:
        """Return -ln of the prior odds that a term of this kind acts, nats."""
        return term.doubt(term.key in self.usual and self.assumed.trust != MEASURED)

    def lacking(self, terms: Sequence[Term]) -> tuple[ShareTerm, ...]:
        """Return the shares of the numbers' columns by effects that are not among some terms."""
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
        """Return the posterior of a set from the fitted recordings only."""
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
        """Return the same data with another trust in the description or scale of the zeros."""
        if assumed == self.assumed:
            return self
        other = replace(self, assumed=assumed)
        other.basis = self.basis
        other.grams = self.grams
        return other

    def fit(self, terms: Sequence[Term], near: Fit | None = None) -> Fit:
        """Return the posterior of a set of optional terms.

        near: fit of a similar set, whose noise is the start.
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
            std.append(t.std_at(self.trust) if isinstance(t, KnownTerm) else t.std)
            low.append(t.low)
            high.append(t.high)
        prior = Prior(*(np.concatenate(parts) for parts in (mean, std, low, high)))
        found = self._posterior(whole, prior, None if near is None else near.found.v)
        fit = Fit(self, whole, found)
        existing = sum(t.log_existing(fit) for t in whole if isinstance(t, NumberTerm))
        return whole, replace(found, evidence=found.evidence + existing)
