"""What next: the motion within the arm's limits that tells explanations apart which this recording does not.

If one of two explanations is true, the other, refitted to the same motion, leaves something unexplained. Half the
square of what it leaves, in units of the noise (and of what neither explains), is the log-likelihood by which a
recording of that motion is expected to decide. Motions are drawn, judged by it, and the best is improved by small
random steps.
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
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.selection.stepwise import misfit
from elastic_arm.dynamics import Model
from elastic_arm.effects.parameters import Parameter
from elastic_arm.errors import ExcitationError
from elastic_arm.estimation.effect_columns import Feature, Whole
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.excitation import FourierTrajectory, MotionLimits, Shape, random_trajectories

Array = NDArray[np.float64]
# Makes whitened columns (rows, k) of a feature at values of its searched parameters.
Columns = Callable[[Feature, Sequence[float]], Array]

MOST_PAIRS = 6
SECONDS = 20.0
# Slow and fast, smooth and rich motions; (harmonics, periods between the ramps).
KINDS = ((2, 1), (5, 1), (5, 2), (4, 4))
DRAWN = 16  # of each kind
GENTLER = (1.0, 0.3)  # friction shows near standstill, inertia at full speed
STEPS = 60  # random steps from the best one
STRIDE = 0.25  # of the amplitudes
# A refit may move a searched parameter: columns at these multiples, or at these distances (m), span what it can do.
NEIGHBOURS = (0.6, 1.0, 1.6)
APART = 0.05  # of the range
DEPENDENT = 1e-6  # relative singular value below which columns say the same


@dataclass(frozen=True)
class CompetingEffect:
    """One explanation of a cause's part of the gap.

    Parameters
    ----------
    effect, joint
        Its name.
    law, at, coefficients
        The feature whose columns, at these searched values and with these coefficients, are what it adds.
    family, around
        The feature and the searched values that a refit starts from.
    """

    effect: str
    joint: str | None
    law: Feature
    at: tuple[float, ...]
    coefficients: Array
    family: Feature
    around: tuple[float, ...]

    def adds(self, columns: Columns) -> Array:
        """Return what it adds (rows,)."""
        return columns(self.law, self.at) @ self.coefficients

    def reach(self, columns: Columns) -> Array:
        """Return the columns (rows, k) that a refit combines; none where its size is known."""
        if not self.family.effect.parameters:
            return np.zeros((len(self.adds(columns)), 0))
        points = _neighbours(self.family.searched, self.around)
        return np.hstack([columns(self.family, point) for point in points])


def propose(context: DiagnosisContext, causes: Sequence[Cause], *, rng: np.random.Generator) -> Proposal | None:
    """Return the motion that separates causes from their alternatives best; None where there are no alternatives.

    Parameters
    ----------
    context, causes
        Of the diagnosis.
    rng
        Draws the motions.
    """
    ambiguous = _ambiguous_pairs(context, causes)
    if not ambiguous:
        return None
    whites = [_recorded(data) for data in context.library.sets]
    # What no explanation reaches stays beside both, and makes either less sure.
    scale = misfit(context.library, [*context.given, *context.selected])
    here = (np.sum([_separations(ambiguous, columns) for columns in whites], axis=0) / scale).tolist()
    named = [((d[0].effect, d[0].joint), (d[1].effect, d[1].joint)) for d in ambiguous]
    limits = MotionLimits.of(context.model.robot)
    around = ExperimentConditions.of(context.model, context.library.sets[0])

    def judge(trajectory: FourierTrajectory) -> list[float]:
        return [value / scale for value in _separations(ambiguous, PredictedExperiment(around, trajectory).white)]

    try:
        best, values, count = _search(context.model, limits, judge, rng)
    except ExcitationError as error:
        pairs = [PairSeparation(*names, value) for names, value in zip(named, here, strict=True)]
        return Proposal(None, tuple(pairs), 0, (*limits.assumed, str(error)))
    pairs = [PairSeparation(*names, *both) for names, *both in zip(named, here, values, strict=True)]
    return Proposal(best, tuple(pairs), count, limits.assumed)


AmbiguousPair = tuple[CompetingEffect, CompetingEffect, tuple[CompetingEffect, ...]]


def separation(pair: AmbiguousPair, columns: Columns) -> float:
    """Log-likelihood by which a recording is expected to decide between two explanations, whichever is true.

    Parameters
    ----------
    pair
        The two, and what acts beside them in either case.
    columns
        Makes whitened columns for the recording.
    """
    one, other, beside = pair
    always = [contender.reach(columns) for contender in beside]
    found = []
    for true, wrong in ((one, other), (other, one)):
        target, reach = true.adds(columns), wrong.reach(columns)
        if not reach.shape[1]:
            target = target - wrong.adds(columns)
        found.append(0.5 * _unexplained(target, np.hstack([reach, *always])))
    return min(found)


def _separations(ambiguous: Sequence[AmbiguousPair], columns: Columns) -> list[float]:
    """Return the separation of every pair; explanations that several share are worked out once."""
    known: dict[tuple[Feature, tuple[float, ...]], Array] = {}

    def remembered(feature: Feature, searched: Sequence[float]) -> Array:
        key = (feature, tuple(searched))
        if key not in known:
            known[key] = columns(feature, searched)
        return known[key]

    return [separation(pair, remembered) for pair in ambiguous]


def _unexplained(target: Array, columns: Array) -> float:
    """Sum of squares of what least squares on the columns leaves of the target."""
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns[:, lengths > 0.0] / lengths[lengths > 0.0]
    if columns.shape[1]:
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        u = u[:, s > DEPENDENT * s[0]]
        target = target - u @ (u.T @ target)
    return float(target @ target)


def _search(
    model: Model, limits: MotionLimits, judge: Callable[[FourierTrajectory], list[float]], rng: np.random.Generator
) -> tuple[FourierTrajectory, list[float], int]:
    """Return the best motion, how it separates each pair, and how many were judged."""
    drawn = []
    for harmonics, periods in KINDS:
        ramp = SECONDS / 10.0
        shape = Shape(harmonics, (SECONDS - 2 * ramp) / periods, ramp, periods)
        drawn += random_trajectories(model, limits, DRAWN, rng=rng, shape=shape)
    tried = [motion.scaled(share) for motion, share in product(drawn, GENTLER)]
    scored = [(judge(motion), motion) for motion in tried]
    values, best = max(scored, key=lambda pair: _worth(pair[0]))
    for _ in range(STEPS):
        moved = _moved(best, limits, rng)
        if not limits.use(moved, model).kept:
            continue
        now = judge(moved)
        if _worth(now) > _worth(values):
            values, best = now, moved
    return best, values, len(tried) + STEPS


def _worth(values: Sequence[float]) -> float:
    """One pair that is hard to separate counts more than another that is separated twice over."""
    return float(np.sum(np.log1p(values)))


def _moved(motion: FourierTrajectory, limits: MotionLimits, rng: np.random.Generator) -> FourierTrajectory:
    a, b = (values + STRIDE * np.std(values) * rng.standard_normal(values.shape) for values in (motion.a, motion.b))
    q0 = motion.q0 + 0.1 * limits.half_range * rng.standard_normal(motion.n)
    q0 = np.clip(q0, limits.position_min, limits.position_max)
    moved = FourierTrajectory(motion.omega, a, b, q0, motion.duration, motion.ramp, motion.joints)
    return limits.fitted(moved, 0.98)


def _recorded(data: WhitenedData) -> Columns:
    return lambda feature, searched: data.whiten(data.plain(feature, searched))


def _ambiguous_pairs(context: DiagnosisContext, causes: Sequence[Cause]) -> list[AmbiguousPair]:
    """Return causes and alternatives, most probable alternatives first."""
    own = [_of_cause(context, candidate, cause) for candidate, cause in zip(context.selected, causes, strict=True)]
    found: list[tuple[float, AmbiguousPair]] = []
    for k, cause in enumerate(causes):
        beside = (*own[:k], *own[k + 1 :])
        others = [*context.given, *context.selected[:k], *context.selected[k + 1 :]]
        for alternative, candidate in zip(cause.alternatives, context.rivals[k], strict=False):
            rival = _of_rival(context, candidate, others)
            found.append((alternative.confidence, (own[k], rival, beside)))
    found.sort(key=lambda pair: -pair[0])
    return [pair for _, pair in found[:MOST_PAIRS]]


def _of_cause(context: DiagnosisContext, candidate: Candidate, cause: Cause) -> CompetingEffect:
    """Return a cause as it was polished; a refit combines the columns of its linear form."""
    forms = [e.feature for e in context.library.candidates if e.feature.key == candidate.feature.key]
    family = next((f for f in forms if not isinstance(f, Whole)), candidate.feature)
    values = [np.atleast_1d(cause.active.numbers[p.name]) for p in family.searched]
    around = tuple(float(v) for v in np.concatenate([*values, np.zeros(0)]))
    at = candidate.searched or ()
    beta = context.library.fit(0, [candidate])
    return CompetingEffect(cause.effect, cause.joint, candidate.feature, at, beta, family, around)


def _of_rival(context: DiagnosisContext, candidate: Candidate, others: Sequence[Candidate]) -> CompetingEffect:
    beta = context.library.fit(0, [*others, candidate])[-len(candidate.index) :]
    feature, at = candidate.feature, candidate.searched or ()
    return CompetingEffect(feature.effect.id, feature.joint, feature, at, beta, feature, at)


def _neighbours(searched: Sequence[Parameter], around: Sequence[float]) -> list[tuple[float, ...]]:
    """Return values of the searched parameters near those of a fit; whole orders stay."""
    points = [tuple(around)]
    k = 0
    for p in searched:
        for j in range(k, k + p.size):
            if p.integer:
                continue
            steps = [around[j] * m for m in NEIGHBOURS]
            if not p.logarithmic:
                apart = APART * (p.high - p.low)
                steps = [around[j] - apart, around[j] + apart]
            points += [(*around[:j], step, *around[j + 1 :]) for step in steps if step != around[j]]
        k += p.size
    return points
