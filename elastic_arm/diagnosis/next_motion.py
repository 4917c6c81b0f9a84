"""The motion within the arm's limits that best discriminates between a cause and its alternatives.

If one of two effects acts, the other one, refitted to the same motion, leaves a remainder. With the
whitened columns s of the true effect and X of everything that a refit can combine, the expected
log-likelihood ratio is half the squared norm of the remainder, 0.5 |s - X X^+ s|^2 (the
discrimination criterion of Atkinson and Fedorov 1975, T-optimality). Motions are drawn at random
and ranked by this criterion, and random steps improve the best one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.predicted_experiment import ExperimentConditions, PredictedExperiment
from elastic_arm.diagnosis.result import Cause, PairSeparation, Proposal
from elastic_arm.dynamics import Model
from elastic_arm.errors import ExcitationError
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.terms.effect import EffectTerm, axis, components, moved
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.excitation import FourierTrajectory, MotionLimits, Shape, random_trajectories

# Returns the whitened columns (rows, k) of a feature at values of its nonlinear parameters.
Columns = Callable[[Feature, Sequence[float]], Array]

# relative singular value below which a combination of columns is not determined; numerical
DEPENDENT = 1e-6
DECISIVE = 12.0  # nats at which a recording is expected to decide: odds of 160,000
MOST_PAIRS = 6  # number of pairs between which a motion should discriminate; bounds the time
SECONDS = 20.0  # length of the motion
KINDS = ((2, 1), (5, 1), (5, 2), (4, 4))  # harmonics, periods: slow to fast
DRAWN = 16  # motions of each kind; bounds the time
STEPS = 60  # random steps from the best; bounds the time
AMPLITUDES = (1.0, 0.3)  # friction shows near standstill, inertia at full speed
STRIDE = 0.25  # of the amplitudes, in a step
CENTRE_STRIDE = 0.1  # of the joints' half ranges, in a step
LIMIT_USE = 0.98  # of the limits
# share of the range of a nonlinear number, to the neighbours that represent a refit
NEIGHBOUR = 0.1
RATE = 500.0  # Hz; enough for ripple of the rotor's fourth order at full speed


@dataclass(frozen=True)
class CompetingEffect:
    """One of two competing effects: columns, coefficients, and the freedom of a refit."""

    effect: str
    joint: str | None
    feature: Feature
    theta: tuple[float, ...]
    coefficients: Array
    refits: tuple[tuple[float, ...], ...]

    @property
    def name(self) -> tuple[str, str | None]:
        """Effect and joint."""
        return self.effect, self.joint

    def signal(self, columns: Columns) -> Array:
        """Return its contribution (rows,)."""
        return columns(self.feature, self.theta) @ self.coefficients

    def refit_columns(self, columns: Columns) -> Array:
        """Return the columns (rows, k) that a refit combines; none if the size is known."""
        if not self.feature.effect.parameters:
            return np.zeros((len(self.signal(columns)), 0))
        return np.hstack([columns(self.feature, point) for point in self.refits])


AmbiguousPair = tuple[CompetingEffect, CompetingEffect, tuple[CompetingEffect, ...]]


def propose(
    context: DiagnosisContext, causes: Sequence[Cause], *, rng: np.random.Generator
) -> Proposal | None:
    """Return the motion that best separates causes from their alternatives; None without
    alternatives."""
    ambiguous = _ambiguous_pairs(context, causes)
    if not ambiguous:
        return None
    linear = context.explanation.linear
    here = _separations(ambiguous, linear.columns)
    names = [(one.name, other.name) for one, other, _ in ambiguous]
    limits = MotionLimits.of(context.model.robot)
    conditions = ExperimentConditions.of(linear.model, linear.data)

    def judge(trajectory: FourierTrajectory) -> list[float]:
        return _separations(ambiguous, PredictedExperiment(conditions, trajectory, RATE).white)

    try:
        best, expected, count = _search(context.model, limits, judge, rng)
    except ExcitationError as error:
        pairs = [PairSeparation(*pair, value) for pair, value in zip(names, here, strict=True)]
        return Proposal(None, tuple(pairs), 0, (*limits.assumed, str(error)))
    pairs = [
        # If a recording should have decided and did not, neither effect is right.
        PairSeparation(*pair, now, then, then >= DECISIVE and then > now)
        for pair, now, then in zip(names, here, expected, strict=True)
    ]
    return Proposal(best, tuple(pairs), count, limits.assumed)


def separation(pair: AmbiguousPair, columns: Columns) -> float:
    """Return the expected log-likelihood ratio of a recording between two effects, whichever acts.

    pair: the two effects, and those that act in both cases.
    """
    one, other, beside = pair
    always = [effect.refit_columns(columns) for effect in beside]
    found = []
    for true, wrong in ((one, other), (other, one)):
        target = true.signal(columns)
        reach = wrong.refit_columns(columns)
        if not reach.shape[1]:
            target = target - wrong.signal(columns)
        found.append(0.5 * _unexplained(target, np.hstack([reach, *always])))
    return min(found)


def _separations(ambiguous: Sequence[AmbiguousPair], columns: Columns) -> list[float]:
    """Return the separation of every pair; shared columns are evaluated once."""
    known: dict[tuple[Feature, tuple[float, ...]], Array] = {}

    def remembered(feature: Feature, searched: Sequence[float]) -> Array:
        key = (feature, tuple(searched))
        if key not in known:
            known[key] = columns(feature, searched)
        return known[key]

    return [separation(pair, remembered) for pair in ambiguous]


def _unexplained(target: Array, columns: Array) -> float:
    """Return the sum of squares of the target after least squares on the columns."""
    u, s, _ = (
        np.linalg.svd(columns, full_matrices=False)
        if columns.size
        else (columns, np.zeros(0), None)
    )
    basis = u[:, s > DEPENDENT * s[0]] if len(s) else np.zeros((len(target), 0))
    target = target - basis @ (basis.T @ target)
    return float(target @ target)


def _search(
    model: Model,
    limits: MotionLimits,
    judge: Callable[[FourierTrajectory], list[float]],
    rng: np.random.Generator,
) -> tuple[FourierTrajectory, list[float], int]:
    """Return the best motion, its separation of each pair, and the number of motions tried."""
    drawn = []
    ramp = SECONDS / 10.0
    for harmonics, periods in KINDS:
        shape = Shape(harmonics, (SECONDS - 2 * ramp) / periods, ramp, periods)
        drawn += random_trajectories(model, limits, DRAWN, rng=rng, shape=shape)
    tried = [motion.scaled(share) for motion, share in product(drawn, AMPLITUDES)]
    scored = [(judge(motion), motion) for motion in tried]
    values, best = max(scored, key=lambda pair: _criterion(pair[0]))
    for _ in range(STEPS):
        moved = _moved(best, limits, rng)
        if not limits.use(moved, model).kept:
            continue
        now = judge(moved)
        if _criterion(now) > _criterion(values):
            values = now
            best = moved
    return best, values, len(tried) + STEPS


def _criterion(values: Sequence[float]) -> float:
    """Return the criterion: hard pairs count more than pairs that are already well separated."""
    return float(np.sum(np.log1p(values)))


def _moved(
    motion: FourierTrajectory, limits: MotionLimits, rng: np.random.Generator
) -> FourierTrajectory:
    """Return the motion after a random step of its amplitudes and centre, within the limits."""
    a = motion.a + STRIDE * np.std(motion.a) * rng.standard_normal(motion.a.shape)
    b = motion.b + STRIDE * np.std(motion.b) * rng.standard_normal(motion.b.shape)
    q0 = motion.q0 + CENTRE_STRIDE * limits.half_range * rng.standard_normal(motion.n)
    q0 = np.clip(q0, limits.position_min, limits.position_max)
    moved = FourierTrajectory(motion.omega, a, b, q0, motion.duration, motion.ramp, motion.joints)
    return limits.fitted(moved, LIMIT_USE)


def _ambiguous_pairs(context: DiagnosisContext, causes: Sequence[Cause]) -> list[AmbiguousPair]:
    """Return the pairs of causes and alternatives, the most probable alternatives first."""
    best = context.explanation.best
    own = {
        (t.key[0], t.key[1]): _competing(best, t)
        for t in best.optional
        if isinstance(t, EffectTerm | NumberTerm)
    }
    found: list[tuple[float, AmbiguousPair]] = []
    for cause in causes:
        name = (cause.effect, cause.joint)
        if name not in own:
            continue
        beside = tuple(one for other, one in own.items() if other != name)
        for alternative in cause.alternatives:
            if rival := _rival(context, name, (alternative.effect, alternative.joint)):
                found.append((alternative.confidence, (own[name], rival, beside)))
    found.sort(key=lambda pair: -pair[0])
    return [pair for _, pair in found[:MOST_PAIRS]]


def _rival(
    context: DiagnosisContext, cause: tuple[str, str | None], other: tuple[str, str | None]
) -> CompetingEffect | None:
    """Return an alternative from the most probable set that contains it and not the cause."""
    best: tuple[float, Fit, Term] | None = None
    for fit in context.explanation.search.met.values():
        names = {(t.key[0], t.key[1]): t for t in fit.optional}
        if other in names and cause not in names and (best is None or fit.score > best[0]):
            best = fit.score, fit, names[other]
    return None if best is None else _competing(best[1], best[2])


def _competing(fit: Fit, term: Term) -> CompetingEffect:
    """Return a term of a fit by the columns of its law; a refit moves its nonlinear numbers to
    neighbours."""
    assert isinstance(term, EffectTerm | NumberTerm)
    feature = term.feature
    theta: tuple[float, ...] = ()
    if isinstance(term, EffectTerm):
        theta = term.theta_by(fit)
        beta = term.coefficients(fit)
    else:
        beta = np.zeros(feature.count)
        beta[0] = float(fit.beta(term)[0])
    points: list[tuple[float, ...]] = [theta]
    own: list[Any] = components(feature)
    for j, p in enumerate(own if theta else []):
        if not p.integer:
            low, high = axis(p)
            step = NEIGHBOUR * (high - low)
            points += [
                (*theta[:j], moved(p, theta[j], sign * step), *theta[j + 1 :])
                for sign in (-1.0, 1.0)
            ]
    return CompetingEffect(term.key[0], term.key[1], feature, theta, beta, tuple(points))
