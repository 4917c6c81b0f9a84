"""Sizes of causes and numbers from the posterior: means and standard deviations over the sets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import truncnorm

from elastic_arm.arrays import Array
from elastic_arm.effects.effect import ControllerEffect, EffectInstance
from elastic_arm.equations.numbers import SCALE, Number
from elastic_arm.equations.robot_at import LEAST, changed_link
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.known import KnownTerm, StatedTerm, least_of
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.robot import Inertia

STEP = 1e-4  # standard deviations, step of the derivatives of parameters by coefficients; numerical


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter with its standard deviation (0: whole; None: not determined); lists for a
    vector."""

    value: Any
    std: Any
    unit: str


def estimated(
    fit: Fit, term: Term, parameters: Sequence[Number], values: Array
) -> tuple[dict[str, ParameterEstimate], EffectInstance]:
    """Return the parameters of a cause with standard deviations, and the effect for the simulator.

    parameters, values: the numbers and their values (K,) at the linearisation.
    """
    if isinstance(term, NumberTerm):
        number = term  # the lambda needs the narrowed type
        total = values + fit.numbers
        moved_by = np.flatnonzero(term.moved)
        covariance = fit.number_covariance[np.ix_(moved_by, moved_by)]
        own = [parameters[int(k)] for k in moved_by]
        return _of(term, lambda x: _number_values(number, own, x), total[moved_by], covariance)
    assert isinstance(term, EffectTerm)
    return _of_effect(fit, term, parameters, values)


def _of_effect(
    fit: Fit, term: EffectTerm, parameters: Sequence[Number], values: Array
) -> tuple[dict[str, ParameterEstimate], EffectInstance]:
    """Return the same for an effect."""
    rows = fit.rows(term)
    if isinstance(term, StatedTerm):  # the sum of the stated size and its deviation
        (known,) = (t for t in fit.terms if isinstance(t, KnownTerm) and t.key == term.key)
        rows[:, fit.slices[known.ident]] += np.eye(len(rows))
    # The scale of a controller's torques also scales its effects, and laws of known masses.
    is_scaled = term.feature.fixed or isinstance(term.feature.effect, ControllerEffect)
    place = SCALE, term.feature.joint
    scales: list[int] = []
    if is_scaled:
        scales = [k for k, p in enumerate(parameters) if (p.what, p.joint) == place]
    rows = np.vstack([rows, fit.moves[scales]])
    n = term.count
    x = rows @ fit.found.x
    covariance = rows @ fit.found.S @ rows.T
    x[n:] = fit.numbers[scales]
    covariance[n:, n:] = fit.number_covariance[np.ix_(scales, scales)]
    low = term.low
    high = term.high
    if isinstance(term, KnownTerm | StatedTerm):
        low = least_of(term.feature, n)
        high = np.full(n, np.inf)
    x, covariance = within(x, covariance, low, high)
    torques = [p.name for p in term.feature.effect.parameters if p.unit.startswith("Nm")]

    def found(x: Array) -> dict[str, Any]:
        own = _effect_values(term, x[:n])
        ratio = 1.0
        for k, change in zip(scales, x[n:], strict=True):
            scale = parameters[k]
            ratio *= scale.value(values[k] + change) / scale.value(values[k])
        return own | {name: np.multiply(ratio, own[name]).tolist() for name in torques}

    return _of(term, found, x, covariance)


def within(x: Array, covariance: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the mean (k,) and covariance (k, k) of a Gaussian truncated to bounds, one coefficient
    after the other."""
    for k in np.flatnonzero(np.isfinite(low) | np.isfinite(high)):
        std = float(np.sqrt(covariance[k, k]))
        mean, variance = truncnorm.stats(
            (low[k] - x[k]) / std, (high[k] - x[k]) / std, loc=x[k], scale=std
        )
        gain = covariance[:, k] / std**2
        x = x + gain * (mean - x[k])
        covariance = covariance - np.outer(gain, covariance[k]) * (1.0 - variance / std**2)
    return x, covariance


def _effect_values(term: EffectTerm, beta: Array) -> dict[str, Any]:
    linear = [] if term.feature.fixed else [float(b) for b in beta[: term.linear]]
    return dict(term.feature.parameters(linear, term.theta_at(beta)))


def _number_values(term: NumberTerm, parameters: Sequence[Number], x: Array) -> dict[str, Any]:
    """Return the parameters of the effect for numbers at x (m,) standard deviations."""
    effect = term.feature.effect
    first = parameters[0]
    found: dict[str, Any] = {p.name: p.default for p in effect.parameters if p.default is not None}
    found[effect.parameters[0].name] = first.value(x[0])
    by_name = {p.what: float(v) * p.prior_std for p, v in zip(parameters, x, strict=True)}
    if "com" in found and "link_com_x" in by_name:
        robot = term.feature.equations.robot
        link = robot.joints[robot.joint_names.index(first.joint)].link
        found["com"], found["inertia"] = link_values(link, by_name)
    return found


def link_values(link: Inertia, numbers: Mapping[str, float]) -> tuple[tuple[float, ...], float]:
    """Return the shift (3,) m of a link's centre of mass, and the ratio of its moments of inertia
    beyond that of its mass, from the deviations of its ten numbers: those of the link that is
    written (:func:`.changed_link`)."""
    # A posterior mean may be a mass that no body has.
    mass = max(LEAST - 1.0, numbers["link_mass"])
    there = changed_link(link, {**numbers, "link_mass": mass}, nearest=True)
    shift = np.asarray(there.com) - np.asarray(link.com)
    described = float(np.trace(link.inertia))
    if described == 0.0:  # a point, at any ratio
        return tuple(shift.tolist()), 1.0
    moments = float(np.trace(there.inertia)) / described
    return tuple(shift.tolist()), moments * link.mass / there.mass


def mounted_body(
    link: Inertia, ratio: float, shift: Sequence[float]
) -> tuple[float, tuple[float, ...]]:
    """Return the mass, kg, and the place (3,) m in the link's frame of a point mass that changes
    the weight of a link as much as a mass r times the described one and a centre shifted by s do.

    (r - 1) m,   at ((r m) (c + s) - m c) / ((r - 1) m)
    """
    com = np.asarray(link.com, dtype=float)
    moment = ratio * (com + np.asarray(shift)) - com
    place = moment / (ratio - 1.0)
    return (ratio - 1.0) * link.mass, tuple(place.tolist())


def _of(
    term: EffectTerm | NumberTerm,
    values: Callable[[Array], dict[str, Any]],
    x: Array,
    covariance: Array,
) -> tuple[dict[str, ParameterEstimate], EffectInstance]:
    feature = term.feature
    names = term.feature.effect.parameters

    def flat(found: dict[str, Any]) -> Array:
        return np.concatenate([np.atleast_1d(np.asarray(found[p.name], float)) for p in names])

    here = values(x)
    if not names:
        return {}, EffectInstance(feature.effect, feature.joint, dict(feature.choices))
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    slopes = np.zeros((len(flat(here)), len(x)))
    for k, step in enumerate(STEP * std):
        by = np.zeros(len(x))
        by[k] = step
        slopes[:, k] = (flat(values(x + by)) - flat(values(x - by))) / (2.0 * step)
    deviations = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
    found = {}
    at = 0
    for p in names:
        own = deviations[at : at + p.size]
        at += p.size
        stds = own.tolist()
        if not p.integer and not own.any():
            stds = [None] * p.size
        if p.size > 1:
            found[p.name] = ParameterEstimate(list(here[p.name]), stds, feature.unit(p))
        else:
            found[p.name] = ParameterEstimate(float(here[p.name]), stds[0], feature.unit(p))
    bounded = {p.name: _physical(p, here[p.name]) for p in names}
    return found, EffectInstance(feature.effect, feature.joint, {**bounded, **feature.choices})


def _physical(parameter: Any, value: Any) -> Any:
    """Return a physically possible value: a mean may be outside by a rounding error."""
    if not np.isfinite(parameter.above):
        return value
    least = parameter.above + 1e-12 * max(1.0, abs(parameter.high))
    if isinstance(value, list | tuple):
        return tuple(max(v, least) for v in value)
    return max(float(value), least)


def averaged(
    found: Sequence[tuple[float, Mapping[str, ParameterEstimate]]],
) -> dict[str, ParameterEstimate]:
    """Return the mean and standard deviation of parameters over sets.

    found: (probability, parameters) of each set, the most probable first.
    """
    weights = np.array([w for w, _ in found])
    result = dict(found[0][1])
    for name, first in found[0][1].items():
        values = np.array([one[name].value for _, one in found], float)
        stds = np.array([one[name].std for _, one in found], float)
        known = np.isfinite(stds.reshape(len(found), -1)).all(axis=1)
        if known[0]:
            mean = np.average(values[known], axis=0, weights=weights[known])
            variance = np.average(
                stds[known] ** 2 + (values[known] - mean) ** 2, axis=0, weights=weights[known]
            )
            result[name] = ParameterEstimate(mean.tolist(), np.sqrt(variance).tolist(), first.unit)
    return result
