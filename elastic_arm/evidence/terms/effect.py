"""Effects of the catalogue at their places, and their nonlinear numbers.

    X(theta) beta + beta_0 dX/dtheta (theta - theta_0)

The derivatives by the nonlinear numbers theta are further columns, whose coefficients have the
prior of theta over its range.
"""

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.codegen.parallel import ahead
from elastic_arm.effects.effect import ControllerEffect, SensorEffect
from elastic_arm.effects.parameters import Parameter
from elastic_arm.equations.places import scaling
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import ODDS, SCALES, USUAL
from elastic_arm.evidence.terms.term import Coefficients, Term, odds_among

COARSE = 5  # values tried of each of several nonlinear numbers
ORDERS = 12  # values tried of an order
# where bounds are looked for
COEFFICIENTS = np.concatenate([s * np.geomspace(1e-8, 1e8, 2001) for s in (-1.0, 1.0)])
STEP = 1e-3  # of derivatives, in the coordinates of the numbers over their ranges; numerical


@dataclass(frozen=True, eq=False)
class EffectTerm(Term):
    """An effect of the catalogue."""

    theta: tuple[float, ...] = ()  # its nonlinear numbers
    tangents: tuple[int, ...] = ()  # components of `theta` by which the last columns are derived
    size: float = 1.0  # coefficient of the law at which its tangents were taken

    kind = "effect"

    @property
    def _details(self) -> tuple[Any, ...]:
        return self.theta, self.tangents, self.size if self.tangents else 1.0

    @property
    def linear(self) -> int:
        """Number of coefficients of the law itself, without those of its nonlinear numbers."""
        return self.count - len(self.tangents)

    @property
    def is_open(self) -> bool:
        """Whether it has nonlinear numbers to move, or is only a first-order approximation."""
        one_column = self.feature.count == 1
        continuous = any(not p.integer for p in components(self.feature))
        return bool(self.feature.bends or (one_column and continuous))

    @property
    def was_relaxed(self) -> bool:
        """Whether its law is of second degree in several nonlinear numbers that have moved."""
        one_column = self.feature.count == 1 and not self.feature.fixed
        return bool(self.tangents and self.feature.quadratic and one_column)

    @property
    def bends(self) -> bool:
        """Whether its sizes are among its nonlinear numbers, by steps of their unit."""
        if self.linear or not self.tangents:
            return False
        logarithmic = any(p.logarithmic for p in self.feature.effect.parameters)
        return bool(self.feature.by_size.bends and not logarithmic)

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of the prior odds that one of its kind is there, nats."""
        return -float(np.log(USUAL if is_usual else ODDS))

    def theta_by(self, fit: Coefficients) -> tuple[float, ...]:
        """Return its nonlinear numbers where a fit that holds it puts them."""
        return self.theta_at(fit.beta(self))

    def steps(self, fit: Coefficients) -> Array:
        """Return how far a fit that holds it puts its nonlinear numbers from where they are, in
        their deviations."""
        own = slice(self.linear, None)
        variance = np.diag(fit.covariance(self))[own]
        return np.abs(fit.beta(self)[own]) / np.sqrt(variance)

    def theta_at(self, beta: Array) -> tuple[float, ...]:
        """Return its nonlinear numbers at coefficients (k,)."""
        theta = list(self.theta)
        own = components(self.feature)
        for k, j in enumerate(self.tangents):
            theta[j] = moved(own[j], theta[j], float(beta[self.linear + k]))
        return tuple(theta)

    def coefficients(self, fit: Coefficients) -> Array:
        """Return the coefficients of its law by a fit that holds it: 1 of one without sizes."""
        return np.ones(1) if self.feature.fixed else fit.beta(self)[: self.linear]

    @property
    def acts(self) -> bool:
        """Whether it is in the true torques: neither of a sensor nor of a controller."""
        return not isinstance(self.feature.effect, SensorEffect | ControllerEffect)

    def acting(self, fit: Coefficients, *, known: bool) -> ActingEffect:
        """Return what it adds to the torques that a model predicts, by a fit that holds it.

        known: whether it is in every set.
        """
        theta = self.theta_by(fit)
        return ActingEffect(self.feature, theta, self.coefficients(fit), known=known)

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation: none where the friction that it scales is gone."""
        (feature,) = linear.placed([self.feature])
        feature = scaling(feature, linear.acting)
        if feature.effect.scales_friction and not feature.friction:
            return []
        here = replace(self, feature=feature)
        if self.tangents:
            size = 1.0 if feature.fixed else float(fit.beta(self)[0])
            return [tangent_term(linear, here, self.theta_by(fit), size)]
        X = linear.columns(feature, self.theta)
        if self.offset is not None:
            return [replace(here, offset=X.sum(axis=1))]
        return [replace(here, columns=X[:, : self.count])]

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        return linear.data.plain(self.feature, self.theta_by(fit))


def coefficient_range(parameter: Parameter) -> tuple[float, float, float]:
    """Return the standard deviation of the coefficient of a linear parameter's column, and its
    bounds.

    The range of the file is the deviation; a size that physics gives a sign has no other, and a
    ratio is positive.
    """
    if parameter.from_coefficient is not None:
        values = np.array([parameter.value_of(float(c)) for c in COEFFICIENTS])
        within = COEFFICIENTS[(values >= parameter.low) & (values <= parameter.high)]
        span = float(np.abs(within).max())
        one_sided = bool((within > 0).all() or (within < 0).all())
        low, high = (
            (0.0, np.inf)
            if within.min() > 0
            else (-np.inf, 0.0)
            if one_sided
            else (-np.inf, np.inf)
        )
        return span, low, high if parameter.neutral is None else min(high, 0.99)
    neutral = parameter.neutral or 0.0
    low = 0.0 if parameter.neutral == 0.0 and parameter.low > 0.0 else parameter.above - neutral
    return max(abs(parameter.high - neutral), abs(parameter.low - neutral)), low, np.inf


def linear_prior(feature: Feature, largest: float) -> tuple[Array, Array, Array]:
    """Return standard deviations and bounds (k,) of the coefficients of a feature's columns.

    largest: torque of its joint, Nm: no effect of the unit of a torque exceeds it ordinarily.
    """
    found: list[tuple[float, float, float]] = []
    for parameter in feature.linear:
        span, low, high = coefficient_range(parameter)
        if parameter.unit == "Nm":
            span = min(span, largest)
        found += [(span, low, high)] * parameter.size
    if feature.phase is not None:
        found = [(found[0][0], -np.inf, np.inf)] * 2
    std, low_, high_ = (
        (np.array(column, dtype=float) for column in zip(*found, strict=True))
        if found
        else (np.zeros(0),) * 3
    )
    return std, low_, high_


def effect_terms(
    linear: Linearisation, features: Sequence[Feature], usual: Set[Key]
) -> Iterator[EffectTerm]:
    """Yield the terms of effects, at several values of their nonlinear numbers, one after the
    other: together they are large.

    usual: what every real drive has.
    """
    wanted: list[tuple[Feature, list[tuple[float, ...]]]] = []
    for feature in features:
        feature = scaling(feature, linear.acting)
        if feature.effect.scales_friction and not feature.friction:
            continue
        wanted.append((feature, starting_points(feature, linear)))
    odds = odds_among((feature.key for feature, _ in wanted), usual)

    def made(one: tuple[Feature, list[tuple[float, ...]]]) -> list[EffectTerm]:
        feature, points = one
        if points == [_middle(feature)] and feature.quadratic and feature.count == 1:
            return [_relaxed(linear, feature, linear.problem.largest_at(feature.joint))]
        columns = np.split(linear.columns_at(feature, points), len(points), axis=1)
        price = float(np.log(len(points)))
        return [
            _term_at(linear, feature, point, own, price)
            for point, own in zip(points, columns, strict=True)
        ]

    for terms in ahead(made, wanted):
        yield from (replace(term, odds=odds[term.key]) for term in terms)


def _term_at(
    linear: Linearisation, feature: Feature, point: tuple[float, ...], X: Array, price: float
) -> EffectTerm:
    """Return the term of an effect with columns X (rows, k) at some nonlinear numbers.

    price: of these numbers among those that are tried, nats.
    """
    if feature.fixed and not feature.searched:
        return EffectTerm(
            feature.key,
            X[:, :0],
            np.zeros(0),
            grid=price,
            offset=X.sum(axis=1),
            feature=feature,
        )
    if feature.fixed:  # scaled while its numbers are looked for
        return EffectTerm(
            feature.key,
            X,
            np.ones(1),
            grid=price,
            low=np.zeros(1),
            feature=feature,
            theta=point,
        )
    std, low, high = linear_prior(feature, linear.problem.largest_at(feature.joint))
    return EffectTerm(
        feature.key,
        X,
        std,
        grid=price,
        low=low,
        high=high,
        feature=feature,
        theta=point,
    )


def _relaxed(linear: Linearisation, feature: Feature, largest: float) -> EffectTerm:
    """Return a term linear in size times all monomials of the nonlinear numbers, in which the law
    is a polynomial.

    It holds what the law can do and more: what it gains is proposed, and the law at its best
    numbers decides.
    """
    (std,), (low,), (high,) = linear_prior(feature, largest)
    reach = np.array(
        [max(abs(p.low), abs(p.high)) for p in feature.searched for _ in range(p.size)]
    )
    reaches = monomials(reach[None])[0]
    free = np.full(len(reaches) - 1, np.inf)
    return EffectTerm(
        feature.key,
        monomial_columns(linear, feature),
        std * reaches,
        low=np.append(low, -free),
        high=np.append(high, free),
        feature=feature,
        theta=(np.nan,) * len(reach),
    )


def monomial_columns(linear: Linearisation, feature: Feature) -> Array:
    """Return what an effect does in all monomials of its nonlinear numbers, (rows, m); made once.

    Its column at any numbers theta is V m(theta): see :func:`monomials`.
    """
    made: dict[object, Array] = linear.cache.setdefault("monomials", {})
    key = feature.key, feature.fixed
    if key not in made:
        points = quadratic_points(sum(p.size for p in feature.searched))
        at_points = linear.columns_at(feature, [tuple(point) for point in points])
        made[key] = at_points @ np.linalg.inv(monomials(points).T)
    return made[key]


def starting_points(feature: Feature, linear: Linearisation) -> list[tuple[float, ...]]:
    """Return values of the nonlinear numbers from which a search may start."""
    components = linear.allowed(feature)
    if not components:
        return [()]
    if (middle := _middle(feature)) is not None:
        return [middle]
    return list(
        product(*(_spread(p, p.tried if len(components) == 1 else COARSE) for p in components))
    )


def _middle(feature: Feature) -> tuple[float, ...] | None:
    """Return the middle of the range of numbers of several components; None where there are
    none."""
    components = [p for p in feature.searched for _ in range(p.size)]
    several = len(components) > len(feature.searched)
    return tuple((p.low + p.high) / 2 for p in components) if several else None


def _spread(parameter: Parameter, count: int) -> list[float]:
    low = parameter.low
    high = parameter.high
    if parameter.integer:
        first = int(np.ceil(low))
        return [float(k) for k in range(first, min(first + ORDERS - 1, int(high)) + 1)]
    return [
        float(v) for v in (np.geomspace if parameter.logarithmic else np.linspace)(low, high, count)
    ]


def monomials(points: Array) -> Array:
    """Return all monomials (M, m) up to the second degree of k numbers (M, k): one, the numbers,
    their products."""
    first, second = _products(points.shape[1])
    return np.hstack([np.ones((len(points), 1)), points, points[:, first] * points[:, second]])


@lru_cache
def _products(k: int) -> tuple[Indices, Indices]:
    """Return the factors of all products of two of k numbers."""
    return np.triu_indices(k)


def monomial_slopes(point: Array) -> Array:
    """Return the derivatives (m, k) of :func:`monomials` at one point (k,)."""
    k = len(point)
    first, second = _products(k)
    one = np.eye(k)
    products = one[first] * point[second, None] + one[second] * point[first, None]
    return np.vstack([np.zeros((1, k)), one, products])


def quadratic_points(k: int) -> Array:
    """Return points (m, k) at which a polynomial of second degree in k numbers is determined."""
    one = np.eye(k)
    pairs = [one[i] + one[j] for i in range(k) for j in range(i)]
    return np.concatenate([np.zeros((1, k)), one, -one, np.reshape(pairs, (-1, k))])


def components(feature: Feature) -> list[Parameter]:
    """Return the parameter of each nonlinear number."""
    return [p for p in feature.searched for _ in range(p.size)]


def axis(p: Parameter) -> tuple[float, float]:
    """Return the coordinates of a parameter's range: logarithms where values are spread so."""
    return (float(np.log(p.low)), float(np.log(p.high))) if p.logarithmic else (p.low, p.high)


def moved(p: Parameter, value: float, step: float) -> float:
    """Return a value after a step in its coordinate, within its range."""
    return float(np.clip(value * np.exp(step) if p.logarithmic else value + step, p.low, p.high))


def tangent_term(
    linear: Linearisation, term: EffectTerm, theta: Sequence[float], size: float
) -> EffectTerm:
    """Return a term at some nonlinear numbers with its derivatives by them.

    size: coefficient of its one column there; 1 where that is known.
    """
    feature = term.feature
    continuous = [(j, p) for j, p in enumerate(linear.allowed(feature)) if not p.integer]
    X, slopes = _with_slopes(linear, feature, theta, continuous)
    tangents: list[Array] = []
    means: list[float] = []
    stds: list[float] = []
    lowest: list[float] = []
    highest: list[float] = []
    for (j, p), slope in zip(continuous, slopes.T, strict=True):
        low, high = axis(p)
        tangents.append(size * slope)
        here = float(np.log(theta[j])) if p.logarithmic else theta[j]
        means.append((low + high) / 2.0 - here)
        stds.append((high - low) / np.sqrt(12.0))
        lowest.append(low - here)
        highest.append(high - here)
    if feature.fixed:
        offset = X.sum(axis=1)
        own = X[:, :0]
        std = own_low = own_high = np.zeros(0)
    else:
        offset = None
        own = X
        largest = linear.problem.largest_at(feature.joint)
        std, own_low, own_high = linear_prior(feature, largest)
        std = std * term.scale
    return EffectTerm(
        term.key,
        np.vstack([own.T, *tangents]).T,  # each column stands in memory as a whole
        np.concatenate([std, stds]),
        odds=term.odds,
        grid=float(np.log(len(SCALES))) if term.is_scaled else 0.0,
        mean=np.concatenate([np.zeros(len(std)), means]),
        low=np.concatenate([own_low, lowest]),
        high=np.concatenate([own_high, highest]),
        offset=offset,
        feature=feature,
        theta=tuple(float(v) for v in theta),
        tangents=tuple(j for j, _ in continuous),
        size=size,
        scale=term.scale,
        is_scaled=term.is_scaled,
    )


def _with_slopes(
    linear: Linearisation,
    feature: Feature,
    theta: Sequence[float],
    continuous: Sequence[tuple[int, Parameter]],
) -> tuple[Array, Array]:
    """Return an effect's columns (rows, k), and the derivatives (rows, m) of their sum by the
    coordinates of its continuous nonlinear numbers, each with its place in theta."""
    if feature.quadratic and feature.count == 1:
        V = monomial_columns(linear, feature)
        point = np.array(theta, dtype=float)
        per_coordinate = np.array([theta[j] if p.logarithmic else 1.0 for j, p in continuous])
        slopes = monomial_slopes(point)[:, [j for j, _ in continuous]] * per_coordinate
        return V @ monomials(point[None]).T, V @ slopes
    points = [tuple(theta)]
    steps: list[float] = []
    for j, p in continuous:
        low, high = axis(p)
        steps.append(STEP if p.logarithmic else STEP * (high - low))
        beside = [moved(p, theta[j], h) for h in (steps[-1], -steps[-1])]
        points += [(*theta[:j], value, *theta[j + 1 :]) for value in beside]
    X, *others = np.split(linear.columns_at(feature, points), len(points), axis=1)
    slopes = np.zeros((len(continuous), len(X))).T
    for k, h in enumerate(steps):
        above, below = others[2 * k : 2 * k + 2]
        slopes[:, k] = (above - below).sum(axis=1) / (2.0 * h)
    return X, slopes
