"""Where nuisance parameters lie most probably, and what the recordings determine of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.channels import gains
from elastic_arm.diagnosis.calibration.expansion import Expansion, expand
from elastic_arm.diagnosis.calibration.linearisation import linearise
from elastic_arm.diagnosis.calibration.problem import CalibrationProblem
from elastic_arm.diagnosis.result import Imperfection
from elastic_arm.diagnosis.selection.hypothesis import misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.tangents import steps_along, tangents
from elastic_arm.diagnosis.settings import DiagnosisSettings, RefitSettings
from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.observation import widest_band

Array = NDArray[np.float64]


def calibrate(
    problem: CalibrationProblem, start: Expansion, extra: Sequence[Candidate] = (), *, scaled: bool = False
) -> tuple[Expansion, float, list[Candidate]]:
    """Expand the residuals where the nuisance parameters lie most probably.

    Returns that, what is left as noise, and the effects where they lie beside it. Gauss-Newton steps go on until they
    are small beside the standard deviations. The nuisance parameters are marginalised in the misfit, so that a good
    step hardly lowers it; it may rise by a hundredth, or by more on the way to a near end. Unexplained misfit counts as
    noise, so that what no parameter explains does not bend them.

    Parameters
    ----------
    problem
        What is calibrated.
    start
        Where to begin.
    extra
        Effects that were found.
    scaled
        Whether a sensor's gain scales their torques, too. While causes are still sought it does not: where they are not
        selected, the gain could stand in for them.
    """
    settings = problem.settings
    best = _fitted(problem, start, extra, scaled=scaled)
    # What acted in another calibration, beside a cause that is not there now, acts no more.
    own = {effect.feature.key for effect in best.acting}
    foreign = any(effect.feature.key not in own for effect in start.acting)
    if scaled or foreign or (problem.scales_friction and not start.acting):
        fits = best.misfit <= settings.search.bent
        again = expand(problem, start.values, start, best.acting, same_problem=fits)
        best = _fitted(problem, again, extra, scaled=scaled)
    least, step = best, best.step
    for _ in range(settings.refit.steps):
        if best.farthest < settings.refit.settled:
            break
        nearer = _nearer(problem, best, step, scaled=scaled)
        if nearer is None:
            break
        step = nearer.step_beyond(best, problem)
        best = nearer
        least = min(least, best, key=lambda one: one.misfit)
    # Far from its end a linear fit may leave less than any arm does.
    if best.misfit > settings.refit.passing * least.misfit:
        best = least
    noise = effective_noise(best.misfit, problem.band, settings)
    return best.expansion, noise, [candidate for candidate, _ in best.extra]


def is_commissioned(problem: CalibrationProblem, values: Array) -> bool:
    """Whether most numbers of an arm are as near to its description as those of one that was calibrated before.

    Parameters
    ----------
    problem
        What was calibrated, before any cause is known.
    values
        (k,) in standard deviations of the priors.
    """
    settings = problem.settings.refit
    own = np.array([parameter.is_inertial for parameter in problem.parameters])
    return bool(np.mean(np.abs(values[own]) >= settings.beyond_ordinary) < settings.few)


@dataclass(frozen=True)
class FittedExpansion:
    """An expansion with the effects fitted beside the nuisance parameters.

    Parameters
    ----------
    expansion
        Where it is linearised.
    misfit
        Mean square of what is left.
    step
        (k,) of Gauss and Newton as far as the values may go, in standard deviations of the priors.
    farthest
        The largest step of those that move the model, in standard deviations with these data.
    acting
        The known effects of the arm.
    extra
        The effects that were found, and by how much their searched numbers move.
    """

    expansion: Expansion
    misfit: float
    step: Array
    farthest: float
    acting: tuple[ActingEffect, ...]
    extra: tuple[tuple[Candidate, Array], ...]

    def moved(self, share: float) -> list[Candidate]:
        """Return the effects that were found with their numbers after a share of the step."""
        return [
            candidate if candidate.searched is None or not step.any() else _at(candidate, share * step)
            for candidate, step in self.extra
        ]

    def step_beyond(self, before: FittedExpansion, problem: CalibrationProblem) -> Array:
        """Return the step (k,), that of lags by the secant through this fit and the one before.

        The column of a late torque is the rate of the torque that the model predicts, with the noise of accelerations:
        its own step goes a part of the way alone.
        """
        moved, change = self.expansion.values - before.expansion.values, before.step - self.step
        longer = np.divide(moved, change, out=np.ones_like(moved), where=change != 0.0)
        lags = np.array([parameter.is_lag for parameter in problem.parameters], dtype=bool)
        return np.where(lags & (longer > 1.0) & (longer < problem.settings.refit.longest), longer, 1.0) * self.step

    def is_on_the_way_from(self, other: FittedExpansion, settings: RefitSettings) -> bool:
        """Whether it leaves a little more than another one, but is much nearer to the end: what products left."""
        return self.misfit < settings.passing * other.misfit and self.farthest < settings.approach * other.farthest


def _fitted(
    problem: CalibrationProblem, expansion: Expansion, extra: Sequence[Candidate], *, scaled: bool
) -> FittedExpansion:
    found, again = linearise(problem, expansion, (), extra)
    # Beside other masses and gains a payload lies elsewhere.
    selected = [*found.given, *again, *tangents(found.library, again)]
    left = misfit(found.library, selected)
    step, stds = found.library.nuisance_step(selected, effective_noise(left, problem.band, problem.settings))
    # Offsets act linearly: they stay in the columns.
    moving = np.array([parameter.moves_model for parameter in problem.parameters], dtype=bool)
    limits = _limits(problem, left, free=bool(extra) or scaled)
    step = np.where(moving, np.clip(expansion.values + step, -limits, limits), 0.0) - expansion.values
    farthest = float(np.max(np.abs(step[moving]) / stds[moving], initial=0.0))
    acts = [*found.given, *(again if scaled else ())]
    acting = tuple(
        ActingEffect(c.feature, c.searched or (), beta)
        for c, beta in zip(selected, found.library.coefficients(selected), strict=True)
        if not isinstance(c.feature.effect, SensorEffect) and c in acts
    )
    steps = steps_along(found.library, selected, again)
    return FittedExpansion(expansion, left, step, farthest, acting, tuple(zip(extra, steps, strict=True)))


def _at(candidate: Candidate, step: Array) -> Candidate:
    """Return a candidate with its searched numbers changed; it has no columns until it is added to a library."""
    searched = tuple(float(v) for v in np.asarray(candidate.searched) + step)
    return replace(candidate, searched=searched)


def _nearer(problem: CalibrationProblem, best: FittedExpansion, step: Array, *, scaled: bool) -> FittedExpansion | None:
    """Return the fit after a step; None where it leaves too much.

    Where the full step leaves clearly more than before, a part of it is gone. Of several numbers whose products act a
    long step may first leave more.
    """
    settings = problem.settings.refit
    fits = best.misfit <= problem.settings.search.bent
    limits = _limits(problem, best.misfit, free=bool(best.extra) or scaled)
    start = best.expansion.values
    for share in settings.step_shares:
        part = share * step / _changes_of_gain(problem, start, start + share * step)
        values = np.clip(start + part, -limits, limits)
        # Where much is unexplained, many combinations of numbers are next to null directions: there each step counts.
        expansion = expand(problem, values, best.expansion, best.acting, same_problem=fits)
        found = _fitted(problem, expansion, best.moved(share), scaled=scaled)
        if found.misfit < settings.worse * best.misfit or found.is_on_the_way_from(best, settings):
            return found
    return None


def _limits(problem: CalibrationProblem, misfit: float, *, free: bool) -> Array:
    """Return how far (k,) nuisance parameters may lie from the description, in standard deviations of their priors.

    Parameters
    ----------
    problem
        What is calibrated.
    misfit
        Mean square of what is left.
    free
        Whether causes are known already.
    """
    limits, settings = np.array([p.limit for p in problem.parameters]), problem.settings
    if free or misfit <= settings.search.bent:
        return limits
    # What no number of the arm explains bends them all, and with them the gains: causes are not yet known.
    inertial = np.array([p.is_inertial for p in problem.parameters], dtype=bool)
    return np.where(inertial, np.minimum(limits, settings.refit.beyond_ordinary), limits)


def _changes_of_gain(problem: CalibrationProblem, first: Array, second: Array) -> Array:
    """Return by what a step of each inertial number (k,) is to be divided: by the change of its torques' gains.

    A reading is gain * torque. Linearly, both changes add up, (1 + dg) * torque + change of torque; the same reading
    has the gain 1 + dg with the change of torque over 1 + dg.

    Parameters
    ----------
    problem
        What is calibrated.
    first, second
        (k,) before and after the step, in standard deviations of the priors.
    """
    joints = problem.robot.joint_names
    before, after = (gains(problem.parameters, values, joints) for values in (first, second))
    ratios = [after[channel] / before[channel] for channel in before]
    changes = np.mean(ratios, axis=0) if ratios else np.ones(len(joints))
    return np.array([changes[joints.index(p.joint)] if p.is_inertial else 1.0 for p in problem.parameters])


def effective_noise(misfit: float, band: Band, settings: DiagnosisSettings) -> float:
    """Return the variance at which whitened residuals count as white noise.

    What is unexplained is coloured: fewer of its rows are independent than there are. In a narrower band there are
    fewer rows to begin with.

    Parameters
    ----------
    misfit
        Mean square of the whitened residuals.
    band
        In which they are compared.
    settings
        Largest discount for colour, in the widest band of the recording.
    """
    most = settings.refit.most_discount * min(1.0, band.cutoff / widest_band(band.rate))
    return misfit * min(misfit, max(most, 1.0))


def posterior(
    library: RegressorLibrary, selected: Sequence[Candidate], settings: DiagnosisSettings
) -> tuple[Array, Array]:
    """Return posterior means and standard deviations (k,) of the nuisance parameters, relative to the expansion.

    Parameters
    ----------
    library
        Of all columns.
    selected
        The known effects and the causes.
    settings
        Largest discount for colour.
    """
    return library.nuisance_step(selected, effective_noise(misfit(library, selected), library.sets[0].band, settings))


def imperfections(problem: CalibrationProblem, deviations: Array, stds: Array) -> tuple[Imperfection, ...]:
    """Return what the recordings determine of each nuisance parameter.

    Parameters
    ----------
    problem
        What was calibrated.
    deviations, stds
        (k,) from the description, and their standard deviations, in units of the parameters.
    """
    return tuple(
        Imperfection(
            p.what,
            p.joint,
            p.unit,
            float(p.neutral + deviation),
            float(std),
            p.ordinary_std,
            p.is_ordinary(float(deviation), float(std), problem.settings.refit),
            problem.source(p),
            p.neutral,
        )
        for p, deviation, std in zip(problem.parameters, deviations, stds, strict=True)
        if p.is_number
    )
