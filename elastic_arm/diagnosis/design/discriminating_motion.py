"""The motion within the arm's limits that discriminates between a cause and its alternatives.

If one of two effects is there, the other, refitted to the same motion, leaves a remainder. With whitened columns s of
the true effect and X of what a refit can combine, the expected log-likelihood ratio is half the squared norm of the
remainder, 0.5 |s - X X^+ s|^2, over the misfit that no hypothesis explains (the discrimination criterion of Atkinson
and Fedorov 1975, T-optimality). Motions are drawn, judged by it, and the best is improved by random steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.design.predicted_experiment import ExperimentConditions, PredictedExperiment
from elastic_arm.diagnosis.design.proposal import PairSeparation, Proposal
from elastic_arm.diagnosis.result import Cause
from elastic_arm.diagnosis.selection.gram_fits import orthonormal_basis
from elastic_arm.diagnosis.selection.hypothesis import misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.settings import DiagnosisSettings, ExperimentSettings
from elastic_arm.dynamics import Model
from elastic_arm.effects.parameters import Parameter
from elastic_arm.errors import ExcitationError
from elastic_arm.estimation.effect_columns import Feature, Whole
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.excitation import FourierTrajectory, MotionLimits, Shape, random_trajectories

Array = NDArray[np.float64]
# Makes whitened columns (rows, k) of a feature at values of its nonlinear parameters.
Columns = Callable[[Feature, Sequence[float]], Array]

DEPENDENT = 1e-6  # relative singular value below which a combination of columns is not determined; numerical


@dataclass(frozen=True)
class CompetingEffect:
    """One of the effects that may cause a part of the gap.

    Parameters
    ----------
    effect, joint
        Its name and place.
    feature, searched, coefficients
        Its columns at these nonlinear parameters, with these coefficients, are what it adds.
    refit_feature, refit_points
        The columns of this feature at all of these nonlinear parameters span what a refit can do.
    """

    effect: str
    joint: str | None
    feature: Feature
    searched: tuple[float, ...]
    coefficients: Array
    refit_feature: Feature
    refit_points: tuple[tuple[float, ...], ...]

    @property
    def name(self) -> tuple[str, str | None]:
        """Effect and joint."""
        return self.effect, self.joint

    def signal(self, columns: Columns) -> Array:
        """Return what it adds (rows,)."""
        return columns(self.feature, self.searched) @ self.coefficients

    def refit_columns(self, columns: Columns) -> Array:
        """Return the columns (rows, k) that a refit combines; none where its size is known."""
        if not self.refit_feature.effect.parameters:
            return np.zeros((len(self.signal(columns)), 0))
        return np.hstack([columns(self.refit_feature, point) for point in self.refit_points])


AmbiguousPair = tuple[CompetingEffect, CompetingEffect, tuple[CompetingEffect, ...]]


def propose(context: DiagnosisContext, causes: Sequence[Cause], *, rng: np.random.Generator) -> Proposal | None:
    """Return the motion that separates causes from their alternatives best; None where there are no alternatives.

    Parameters
    ----------
    context, causes
        Of the diagnosis.
    rng
        Draws the motions.
    """
    settings = context.settings.experiment
    ambiguous = _ambiguous_pairs(context, causes)
    if not ambiguous:
        return None
    recorded = [_recorded(data) for data in context.library.sets]
    # What no hypothesis explains stays beside both effects, and makes a decision less certain.
    scale = misfit(context.library, context.everything)
    here = (np.sum([_separations(ambiguous, columns) for columns in recorded], axis=0) / scale).tolist()
    names = [(one.name, other.name) for one, other, _ in ambiguous]
    limits = MotionLimits.of(context.model.robot)
    conditions = ExperimentConditions.of(context.model, context.library.sets[0])

    def judge(trajectory: FourierTrajectory) -> list[float]:
        experiment = PredictedExperiment(conditions, trajectory, settings.rate)
        return [value / scale for value in _separations(ambiguous, experiment.white)]

    try:
        best, expected, count = _search(context.model, limits, judge, settings, rng)
    except ExcitationError as error:
        pairs = [PairSeparation(*pair, value) for pair, value in zip(names, here, strict=True)]
        return Proposal(None, tuple(pairs), 0, (*limits.assumed, str(error)))
    pairs = [
        # A recording that ought to have decided and did not shows that neither is right.
        PairSeparation(*pair, now, then, then >= settings.decisive and then > now)
        for pair, now, then in zip(names, here, expected, strict=True)
    ]
    return Proposal(best, tuple(pairs), count, limits.assumed)


def separation(pair: AmbiguousPair, columns: Columns) -> float:
    """Log-likelihood by which a recording is expected to decide between two effects, whichever is there.

    Parameters
    ----------
    pair
        The two, and what acts beside them in either case.
    columns
        Makes whitened columns for the recording.
    """
    one, other, beside = pair
    always = [effect.refit_columns(columns) for effect in beside]
    found = []
    for true, wrong in ((one, other), (other, one)):
        target, reach = true.signal(columns), wrong.refit_columns(columns)
        if not reach.shape[1]:
            target = target - wrong.signal(columns)
        found.append(0.5 * _unexplained(target, np.hstack([reach, *always])))
    return min(found)


def _separations(ambiguous: Sequence[AmbiguousPair], columns: Columns) -> list[float]:
    """Return the separation of every pair; columns that several share are evaluated once."""
    known: dict[tuple[Feature, tuple[float, ...]], Array] = {}

    def remembered(feature: Feature, searched: Sequence[float]) -> Array:
        key = (feature, tuple(searched))
        if key not in known:
            known[key] = columns(feature, searched)
        return known[key]

    return [separation(pair, remembered) for pair in ambiguous]


def _unexplained(target: Array, columns: Array) -> float:
    """Sum of squares of what least squares on the columns leaves of the target."""
    basis = orthonormal_basis(columns, DEPENDENT)
    target = target - basis @ (basis.T @ target)
    return float(target @ target)


def _search(
    model: Model,
    limits: MotionLimits,
    judge: Callable[[FourierTrajectory], list[float]],
    settings: ExperimentSettings,
    rng: np.random.Generator,
) -> tuple[FourierTrajectory, list[float], int]:
    """Return the best motion, how it separates each pair, and how many were judged."""
    drawn, ramp = [], settings.seconds / 10.0
    for harmonics, periods in settings.kinds:
        shape = Shape(harmonics, (settings.seconds - 2 * ramp) / periods, ramp, periods)
        drawn += random_trajectories(model, limits, settings.drawn, rng=rng, shape=shape)
    tried = [motion.scaled(share) for motion, share in product(drawn, settings.amplitudes)]
    scored = [(judge(motion), motion) for motion in tried]
    values, best = max(scored, key=lambda pair: _criterion(pair[0]))
    for _ in range(settings.steps):
        moved = _moved(best, limits, settings, rng)
        if not limits.use(moved, model).kept:
            continue
        now = judge(moved)
        if _criterion(now) > _criterion(values):
            values, best = now, moved
    return best, values, len(tried) + settings.steps


def _criterion(values: Sequence[float]) -> float:
    """One pair that is hard to separate counts more than another that is separated twice over."""
    return float(np.sum(np.log1p(values)))


def _moved(
    motion: FourierTrajectory, limits: MotionLimits, settings: ExperimentSettings, rng: np.random.Generator
) -> FourierTrajectory:
    """Return the motion after a random step of amplitudes and centre, within the limits."""
    a, b = (
        values + settings.stride * np.std(values) * rng.standard_normal(values.shape) for values in (motion.a, motion.b)
    )
    q0 = motion.q0 + settings.centre_stride * limits.half_range * rng.standard_normal(motion.n)
    q0 = np.clip(q0, limits.position_min, limits.position_max)
    moved = FourierTrajectory(motion.omega, a, b, q0, motion.duration, motion.ramp, motion.joints)
    return limits.fitted(moved, settings.limit_use)


def _recorded(data: WhitenedData) -> Columns:
    return lambda feature, searched: data.whiten(data.plain(feature, searched))


def _ambiguous_pairs(context: DiagnosisContext, causes: Sequence[Cause]) -> list[AmbiguousPair]:
    """Return causes and alternatives, most probable alternatives first."""
    own = [_of_cause(context, candidate, cause) for candidate, cause in zip(context.selected, causes, strict=True)]
    found: list[tuple[float, AmbiguousPair]] = []
    for k, cause in enumerate(causes):
        beside = (*own[:k], *own[k + 1 :])
        others = [candidate for candidate in context.everything if candidate is not context.selected[k]]
        # A low pass in the place of a delay, which comes last, was no candidate of the search.
        for alternative, candidate in zip(cause.alternatives, context.rivals[k], strict=False):
            rival = _of_rival(context, candidate, others)
            found.append((alternative.confidence, (own[k], rival, beside)))
    found.sort(key=lambda pair: -pair[0])
    return [pair for _, pair in found[: context.settings.experiment.most_pairs]]


def _of_cause(context: DiagnosisContext, candidate: Candidate, cause: Cause) -> CompetingEffect:
    """Return a cause as it was polished; a refit combines the columns of its linear form."""
    forms = [c.feature for c in context.library.candidates if c.feature.key == candidate.feature.key]
    form = next((f for f in forms if not isinstance(f, Whole)), candidate.feature)
    values = [np.atleast_1d(cause.instance.numbers[p.name]) for p in form.searched]
    points = _neighbours(form.searched, [float(v) for v in np.concatenate([*values, np.zeros(0)])], context.settings)
    beta, searched = context.library.fit(0, [candidate]), candidate.searched or ()
    return CompetingEffect(cause.effect, cause.joint, candidate.feature, searched, beta, form, points)


def _of_rival(context: DiagnosisContext, candidate: Candidate, others: Sequence[Candidate]) -> CompetingEffect:
    beta = context.library.fit(0, [*others, candidate])[-len(candidate.index) :]
    feature, searched = candidate.feature, candidate.searched or ()
    points = _neighbours(feature.searched, searched, context.settings)
    return CompetingEffect(feature.effect.id, feature.joint, feature, searched, beta, feature, points)


def _neighbours(
    searched: Sequence[Parameter], around: Sequence[float], settings: DiagnosisSettings
) -> tuple[tuple[float, ...], ...]:
    """Return values of nonlinear parameters near those of a fit; integers stay."""
    points, experiment = [tuple(around)], settings.experiment
    for j, p in enumerate([parameter for parameter in searched for _ in range(parameter.size)]):
        if p.integer:
            continue
        steps = [around[j] * m for m in experiment.neighbours]
        if not p.logarithmic:
            distance = experiment.neighbour_distance * (p.high - p.low)
            steps = [around[j] - distance, around[j] + distance]
        points += [(*around[:j], step, *around[j + 1 :]) for step in steps if step != around[j]]
    return tuple(points)
