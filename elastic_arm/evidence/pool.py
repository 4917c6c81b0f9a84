"""What could be in the data: effects of the catalogue at every place, numbers that are far off,
laws without a form."""

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from itertools import product

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.parallel import share_out
from elastic_arm.effects.effect import Scope
from elastic_arm.effects.parameters import Parameter
from elastic_arm.equations.formless import GeneralLaw, general_laws
from elastic_arm.equations.numbers import RATIO, SCALE, Number
from elastic_arm.equations.places import scaling
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import SIZES, WIDE
from elastic_arm.evidence.term import Key, Term

Columns = Callable[[Feature, Sequence[float]], Array]

COARSE, ORDERS = 5, 12  # values tried of each of several nonlinear numbers, and of an order
COEFFICIENTS = np.concatenate(
    [s * np.geomspace(1e-8, 1e8, 2001) for s in (-1.0, 1.0)]
)  # where bounds are looked for


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


def effect_terms(linear: Linearisation, features: Sequence[Feature]) -> list[Term]:
    """Return the terms of effects, at several values of their nonlinear numbers."""
    wanted: list[tuple[Feature, tuple[float, ...], float]] = []
    for feature in features:
        feature = scaling(feature, linear.acting)
        if feature.effect.scales_friction and not feature.friction:
            continue
        points = starting_points(feature, linear)
        wanted += [(feature, point, float(np.log(len(points)))) for point in points]

    def made(one: tuple[Feature, tuple[float, ...], float]) -> Term:
        feature, point, price = one
        own = linear.problem.largest_at(feature.joint)
        if point == _middle(feature) and feature.quadratic and feature.count == 1:
            return _relaxed(linear.columns, feature, own)
        X = linear.columns(feature, point)
        if feature.fixed and not feature.searched:
            return Term(
                feature.key,
                "effect",
                X[:, :0],
                np.zeros(0),
                grid=price,
                offset=X.sum(axis=1),
                feature=feature,
            )
        if feature.fixed:  # scaled while its numbers are looked for
            return Term(
                feature.key,
                "effect",
                X,
                np.ones(1),
                grid=price,
                low=np.zeros(1),
                feature=feature,
                theta=point,
            )
        std, low, high = linear_prior(feature, own)
        return Term(
            feature.key,
            "effect",
            X,
            std,
            grid=price,
            low=low,
            high=high,
            feature=feature,
            theta=point,
        )

    return share_out(made, wanted)


def _relaxed(columns: Columns, feature: Feature, largest: float) -> Term:
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
    return Term(
        feature.key,
        "effect",
        relaxed_columns(columns, feature),
        std * reaches,
        low=np.append(low, -free),
        high=np.append(high, free),
        feature=feature,
        theta=(np.nan,) * len(reach),
    )


def relaxed_columns(columns: Columns, feature: Feature) -> Array:
    """Return what an effect does in all monomials of its nonlinear numbers."""
    points = quadratic_points(sum(p.size for p in feature.searched))
    return np.hstack([columns(feature, tuple(point)) for point in points]) @ np.linalg.inv(
        monomials(points).T
    )


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
    low, high = parameter.low, parameter.high
    if parameter.integer:
        first = int(np.ceil(low))
        return [float(k) for k in range(first, min(first + ORDERS - 1, int(high)) + 1)]
    return [
        float(v) for v in (np.geomspace if parameter.logarithmic else np.linspace)(low, high, count)
    ]


def number_terms(parameters: Sequence[Number], N: Array, far: Set[str]) -> list[Term]:
    """Return the terms of numbers of the arm and its sensors that are far off, by their ordinary
    columns.

    N: (rows, k) whitened columns for one standard deviation each.
    """
    found: list[Term] = []
    together: dict[Key, list[int]] = {}
    unit = np.eye(len(parameters))
    for k, parameter in enumerate(parameters):
        if parameter.cause is None or parameter.cause.effect.id not in far:
            continue
        key = parameter.cause.key
        moves = unit[:, [k]].copy()
        if (
            parameter.what == SCALE
        ):  # a gain of angles that is off leaves that of speeds where it is
            for i, other in enumerate(parameters):
                if (other.what, other.joint) == (RATIO, parameter.joint):
                    moves[i] = -parameter.prior_std / other.prior_std
        found.append(number_term(parameter, N, key, moves))
        if parameter.is_of_link:
            own = [
                i for i, p in enumerate(parameters) if p.is_of_link and p.joint == parameter.joint
            ]
            found.append(number_term(parameter, N, key, unit[:, own]))
        if parameter.cause.effect.scope is Scope.EACH_OR_ARM:
            together.setdefault((key[0], None, key[2]), []).append(k)
    for key, own in together.items():
        if len(own) > 1:
            first = parameters[own[0]]
            moves = np.zeros((len(parameters), 1))
            moves[own, 0] = [first.prior_std / parameters[k].prior_std for k in own]
            found.append(number_term(first, N, key, moves))
    return found


def number_term(parameter: Number, N: Array, key: Key, moves: Array) -> Term:
    """Return the term of numbers that move by (K, k) for each coefficient, the first of them a
    parameter."""
    count = moves.shape[1]
    low = np.full(count, -np.inf)
    least = parameter.cause.linear[0].above if parameter.cause is not None else -np.inf
    if not parameter.is_logarithmic:
        low[0] = (
            0.98 * (least - parameter.neutral) / parameter.prior_std
        )  # ratios are positive, channels late
    std = np.full(count, WIDE)
    return Term(key, "number", N @ moves, std, low=low, feature=parameter.cause, what=moves)


def law_terms(linear: Linearisation) -> list[Term]:
    """Return the laws without a form, their size open (:func:`sized`)."""
    data, joints = linear.data, linear.problem.robot.joints
    laws = [
        law
        for j, joint in enumerate(joints)
        for law in general_laws((data,), j, joint.transmission)
    ]

    def made(law: GeneralLaw) -> Term:
        X = data.whiten(law.plain(data))
        key = "law", str(law.joint), (law.side, law.argument, law.smoothness)
        return Term(key, "law", X, np.ones(X.shape[1]), what=law)

    return share_out(made, laws)


def sized(term: Term, size: float) -> Term:
    """Return a law without a form at one of the sizes it may have."""
    ident = (term.kind, *term.key, term.count, size)
    return replace(term, std=np.full(term.count, size), grid=float(np.log(len(SIZES))), ident=ident)


def monomials(points: Array) -> Array:
    """Return all monomials (M, m) up to the second degree of k numbers (M, k): one, the numbers,
    their products."""
    first, second = np.triu_indices(points.shape[1])
    return np.hstack([np.ones((len(points), 1)), points, points[:, first] * points[:, second]])


def quadratic_points(k: int) -> Array:
    """Return points (m, k) at which a polynomial of second degree in k numbers is determined."""
    one = np.eye(k)
    pairs = [one[i] + one[j] for i in range(k) for j in range(i)]
    return np.concatenate([np.zeros((1, k)), one, -one, np.reshape(pairs, (-1, k))])
