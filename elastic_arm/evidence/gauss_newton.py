"""Gauss–Newton steps that linearise a set of terms about its own numbers.

    nu_{k+1} = nu_k + share E(nu - nu_k | y, S)        residuals and columns recomputed at nu_{k+1}

The steps end when each number moves by less than a share of its standard deviation. Numbers of the
arm, nonlinear numbers of effects, and the effects in the predicted torques move together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.turnover import FrictionPlace
from elastic_arm.evidence.fit import KINDS, Fit, Frame, LinearModel
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.nonlinear import placed_anew
from elastic_arm.evidence.priors import COMPARED, WORTH, Assumed
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.dry_friction import TurnoverTerm
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.known import known_terms
from elastic_arm.evidence.terms.share import shares_of
from elastic_arm.evidence.terms.term import Term

STEPS = 8  # largest number of steps; numerical
SHORTER = 0.3  # share of a step that is tried after it was too long; numerical
QUARTER = 0.25  # of the shortest period in the band: step between lags that are tried
SETTLED = 0.02  # standard deviations: steps below this count as zero; numerical


def about_itself(
    linear: Linearisation,
    fit: Fit,
    start: Frame,
    least: float = -np.inf,
    settled: float = SETTLED,
) -> tuple[Linearisation, Fit]:
    """Return a set linearised about its own numbers, starting from another linearisation.

    Numbers of the arm and nonlinear numbers of effects move together. A step that loses much is
    shortened. The steps end early if the score is further below `least` than the last step changed
    it. A set that has not settled after all steps gets its lowest score in the later half of them.

    start: fit whose frame the scores have; least: score to reach; settled: steps that count as
    zero, in standard deviations.
    """
    assumed = fit.model.assumed
    before: Fit | None = None
    scores: list[float] = []
    share = 1.0
    for _ in range(STEPS):
        if share == 1.0 and _has_settled(linear, fit, settled):
            break
        there = moved(linear, fit, share)
        own = linear_model(there, assumed).fit(again(fit, there)).compared_in(start)
        scores.append(own.score)
        gain = np.inf if before is None else own.score - before.score
        if gain < -COMPARED and share == 1.0:
            share = SHORTER
            continue
        # A score is valid at its own numbers: a lower score nearer to them is more accurate.
        linear = there
        fit = own
        share = 1.0
        before = own
        # An unchanged score far from the numbers means that steps overshoot.
        is_still = abs(gain) < WORTH and not is_far(own)
        if is_still or own.score + abs(gain) < least:
            break
    found = fit.compared_in(start)
    if is_far(found) and scores:
        # The noise of the start belongs to other numbers, and may be far too large. The earlier
        # half of the steps leads away from it.
        lowest = min(scores[len(scores) // 2 :])
        found = replace(found, correction=found.correction + lowest - found.score)
    return linear, found


def at_lags(linear: Linearisation, fit: Fit, frame: Frame) -> tuple[Linearisation, Fit]:
    """Return a set at those lags of whole channels, in equal steps, at which it is most probable
    with the lags as they are tried (:func:`_score_at`).

    A torque that reverses with its friction is linear in a lag only as far as the band resolves.
    From further away, Gauss–Newton steps end at lags that differ from joint to joint.

    frame: in which scores compare.
    """
    step = QUARTER / linear.problem.band.cutoff
    numbers = linear.problem.numbers
    stds = np.array([number.prior_std for number in numbers])
    channels = {number.channel or "" for number in numbers if number.is_lag}
    for channel in sorted(channels):
        own = [number.is_lag and number.channel == channel for number in numbers]
        for by in (step, -step):
            before = fit
            while True:
                there = linear.moved(linear.values + np.where(own, by / stds, 0.0), linear.acting)
                model = linear_model(there, fit.model.assumed)
                later = model.fit(again(fit, there), fit).compared_in(frame)
                gain = _score_at(later, own) - _score_at(fit, own)
                if not gain > 0.0:  # a lag of which nothing tells ends here as well
                    break
                linear, fit = there, later
            if fit is not before:
                break
    return linear, fit


def _score_at(fit: Fit, own: list[bool]) -> float:
    """Return the score of a fit with some numbers (K,) as they are at its linearisation.

        score - rows ln(1 + delta' C^-1 delta / rows) / 2

    delta is the step to the numbers of the fit and C its covariance; the noise is that of the
    residuals. What a long step of a lag promises, its columns cannot keep.
    """
    which = np.flatnonzero(own)
    step = fit.numbers[which]
    covariance = fit.number_covariance[np.ix_(which, which)]
    distance = float(step @ np.linalg.pinv(covariance, hermitian=True) @ step)
    rows = len(fit.model.y)
    return fit.score - 0.5 * rows * float(np.log1p(distance / rows))


def _has_settled(linear: Linearisation, fit: Fit, none: float) -> bool:
    """Whether a fit agrees with its linearisation: in numbers, nonlinear numbers, and effects that
    act in its torques.

    none: steps that count as zero, in standard deviations.
    """
    acting = {one.feature.key for one in linear.acting}
    acting_of_fit = {one.feature.key for one in _acting(fit)}
    if acting_of_fit != acting:
        return False
    of_effects = [t.steps(fit) for t in fit.terms if isinstance(t, EffectTerm)]
    moves = [_steps(fit), *of_effects]
    return bool(np.max(np.concatenate(moves), initial=0.0) < none)


def is_far(fit: Fit) -> bool:
    """Whether a number of a fit is more than its standard deviation from the linearisation."""
    return bool(np.max(_steps(fit), initial=0.0) > 1.0)


def _steps(fit: Fit) -> Array:
    """Return the distances of a fit's numbers from the linearisation, in standard deviations."""
    steps = np.abs(fit.numbers) / np.sqrt(np.diag(fit.number_covariance))
    return steps[fit.model.moving]


def moved(linear: Linearisation, fit: Fit, share: float = 1.0) -> Linearisation:
    """Return the linearisation after a share of the step to the numbers of a fit."""
    limits = np.array([p.limit for p in linear.problem.numbers])
    there = np.clip(linear.values + share * fit.numbers, -limits, limits)
    return linear.moved(np.where(fit.model.moving, there, 0.0), _acting(fit))


def moving_numbers(problem: Problem) -> Mask:
    """Return the numbers (K,) on whose values the residuals depend."""
    return np.array([p.moves_model for p in problem.numbers], dtype=bool)


def linear_model(linear: Linearisation, assumed: Assumed) -> LinearModel:
    """Return the data at a linearisation, computed once."""
    if "model" not in linear.cache:
        linear.cache["model"] = LinearModel(
            linear.data.white,
            linear.numbers,
            Bands(linear.data),
            -linear.values,
            np.array([KINDS.index(p.kind) for p in linear.problem.numbers], dtype=int),
            moving_numbers(linear.problem),
            tuple(known_terms(linear)[0]),
            shares_of(linear),
            assumed,
            linear.data.density,
            linear.fitted_rows,
            linear.problem.usual,
        )
    return linear.cache["model"].assuming(assumed)


def _acting(fit: Fit) -> tuple[ActingEffect, ...]:
    """Return the effects of a fit that act in the true torques; dry friction turns over late."""
    turned = {t.place: fit.beta(t) for t in fit.terms if isinstance(t, TurnoverTerm)}
    found = []
    for term in fit.terms:
        if not isinstance(term, EffectTerm) or not term.acts:
            continue
        effect = term.acting(fit, known=term in fit.model.always)
        feature = term.feature
        places = [FrictionPlace(str(feature.joint), side) for side in feature.sides]
        late = [turned[place] for place in places if place in turned]
        if feature.effect.friction and late:
            # Columns of lags would otherwise have reversals where the torque has none yet, and
            # each step would move the lag further.
            effect = replace(effect, turned=np.maximum(late[0], 0.0))
        found.append(effect)
    return tuple(found)


def again(fit: Fit, linear: Linearisation) -> list[Term]:
    """Return the terms of a fit at another linearisation."""
    always = known_terms(linear)[0]
    found: list[Term] = []
    for t in sorted(fit.optional, key=lambda t: isinstance(t, ChangeTerm)):
        found += t.again(linear, fit, [*always, *found])
    for k, t in enumerate(found):
        if isinstance(t, EffectTerm) and t.was_relaxed:
            model = linear_model(linear, fit.model.assumed)
            found[k] = placed_anew(linear, model, t, [*found[:k], *found[k + 1 :]])
    return found
