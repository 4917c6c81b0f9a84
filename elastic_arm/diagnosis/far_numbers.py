"""Numbers of an arm and its sensors that are beyond their ordinary deviations.

    P(abs(nu_k) > 3 s_k | y) = sum over sets p(S | y) P(abs(nu_k) > 3 s_k | y, S)

s_k is the prior standard deviation, whatever the trust in the description. For a ratio, 3 s_k means
a factor of 1 + 3 s_k or its inverse: too large and too small are equally far.
"""

from collections.abc import Mapping, Sequence, Set

import numpy as np
from scipy.stats import norm

from elastic_arm.arrays import Array
from elastic_arm.equations.numbers import Number
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.priors import ORDINARY, STATED
from elastic_arm.evidence.terms.known import KnownTerm, StatedTerm
from elastic_arm.evidence.terms.number import NumberTerm

Name = tuple[str, str | None]  # effect and joint


def bounds_of(numbers: Sequence[Number], zeros: float = 1.0) -> Array:
    """Return the ordinary bound (K,) of each number, in its standard deviations.

    zeros: the scale of the arm's torque zeros.
    """
    stds = np.array([p.prior_std for p in numbers])
    logarithmic = np.array([p.is_logarithmic for p in numbers], dtype=bool)
    bounds = np.where(logarithmic, np.log1p(ORDINARY * stds) / stds, ORDINARY)
    scaled = np.array([p.kind == "zero" for p in numbers], dtype=bool)
    return np.where(scaled, zeros * bounds, bounds)


def named_numbers(numbers: Sequence[Number], effects: Set[str]) -> dict[Name, list[int]]:
    """Return the numbers that are reported as each effect and joint.

    effects: the effects that may be reported.
    """
    found: dict[Name, list[int]] = {}
    for k, p in enumerate(numbers):
        if p.cause is None or p.cause.effect.id not in effects:
            continue
        own = [k]
        if p.is_of_link:
            of_joint = enumerate(numbers)
            own = [i for i, other in of_joint if other.is_of_link and other.joint == p.joint]
        found.setdefault((p.cause.key[0], p.joint), []).extend(own)
    return found


def beyond(fit: Fit, values: Array, numbers: Sequence[Number]) -> Array:
    """Return the probability (K,) that each number is beyond its ordinary deviations in a fit.

    values: numbers (K,) at which the fit is linearised. A posterior deviation counts as the
    ordinary one at most, so that a number that the recordings do not determine is not far off.
    """
    mean = values + fit.numbers
    std = np.sqrt(np.maximum(np.diag(fit.number_covariance), 0.0))
    bounds = bounds_of(numbers, fit.model.assumed.zeros)
    std = np.clip(std, np.finfo(float).eps, bounds / bounds_of(numbers))
    return norm.sf((bounds - mean) / std) + norm.cdf((-bounds - mean) / std)


def probabilities(
    fit: Fit, values: Array, numbers: Sequence[Number], named: Mapping[Name, Sequence[int]]
) -> dict[Name, float]:
    """Return the probability of each effect and joint that its numbers are far off in a fit.

    Numbers that a term of the fit moves count only for that term: if kp is larger and kd is as
    stated, kp is off and not their ratio.
    """
    each = beyond(fit, values, numbers)
    found = {}
    moved = np.zeros(len(numbers), dtype=bool)
    for term in fit.optional:
        if isinstance(term, NumberTerm):
            own = term.moved
            moved |= own
            if term.says_cause:
                found[term.key[0], term.key[1]] = float(each[own].max())
    for name, indices in named.items():
        rest = [k for k in indices if not moved[k]]
        if rest:
            found.setdefault(name, float(each[rest].max()))
    return found


def stated_beyond(fit: Fit) -> dict[Name, float]:
    """Return the probability that the size of each described effect is far off.

    Its size is a ratio to the stated one, with or without a term that widens its prior.
    """
    found = {}
    bound = np.log1p(ORDINARY * STATED)
    for term in fit.terms:
        if not isinstance(term, KnownTerm) or term.stated is None or not term.stated.any():
            continue
        rows = fit.rows(term)
        for more in fit.optional:
            if isinstance(more, StatedTerm) and more.key == term.key:
                rows = rows + fit.rows(more)
        along = term.stated @ rows / float(term.stated @ term.stated)
        ratio = float(along @ fit.found.x)
        std = float(np.sqrt(along @ fit.found.S @ along))
        low = np.exp(-bound)
        high = np.exp(bound)
        p = norm.cdf((low - ratio) / std) + norm.sf((high - ratio) / std)
        found[term.key[0], term.key[1]] = float(p)
    return found


def gain_beyond(whole: Fit, fitted: Fit, values: Array, numbers: Sequence[Number]) -> Array:
    """Return the gain (K,) of the validation recordings by each number beyond its bounds, nats.

    It is relative to the nearest ordinary value, with the other numbers refitted:

        ln p(y' | y) - ln p(y' | y, bound) = d²/2 of all recordings - d²/2 of the fitted ones

    d is the distance of the mean from the bound in posterior standard deviations.
    """
    bounds = bounds_of(numbers, whole.model.assumed.zeros)
    found = []
    for fit in (whole, fitted):
        mean = values + fit.numbers
        variance = np.maximum(np.diag(fit.number_covariance), np.finfo(float).tiny)
        past = mean - np.clip(mean, -bounds, bounds)
        found.append(0.5 * past**2 / variance)
    return found[0] - found[1]


def gain_beyond_together(
    whole: Fit, fitted: Fit, values: Array, numbers: Sequence[Number], which: Sequence[int]
) -> float:
    """Return the gain of the validation recordings by several numbers beyond their bounds, nats.

    As in :func:`gain_beyond`, but all numbers are at their bounds together: d² = x' S^-1 x with
    their distances x (m,) from the bounds and their covariance S (m, m).
    """
    bounds = bounds_of(numbers, whole.model.assumed.zeros)[which]
    found = []
    for fit in (whole, fitted):
        mean = (values + fit.numbers)[which]
        covariance = fit.number_covariance[np.ix_(which, which)]
        past = mean - np.clip(mean, -bounds, bounds)
        found.append(0.5 * float(past @ np.linalg.pinv(covariance) @ past))
    return found[0] - found[1]
