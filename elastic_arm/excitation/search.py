"""Search for the motion within limits that determines the base parameters best.

The free numbers are where each joint swings about and its amplitudes. Joints are turned down to their kinematic limits
before anything else is asked of a motion, so that only torque and workspace remain as constraints. The search is mesh
adaptive direct search, NOMAD's (C. Audet, S. Le Digabel, V. Rochon Montplaisir and C. Tribes, ACM Trans. Mathematical
Software 48 (2022) 35), which polls a pattern of points around the best one, takes no derivatives and lets constraints
be broken on the way (progressive barrier).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation.criteria import BaseRegressor, condition, distinct_columns, find_criterion
from elastic_arm.excitation.fourier import FourierTrajectory
from elastic_arm.excitation.limits import LimitUse, MotionLimits

Array = NDArray[np.float64]
Progress = Callable[[int, float], None]

# Share of the kinematic limits that the search uses, so that peaks between its samples stay within them.
SHARE = 0.98
# A random motion that breaks torque or workspace is tried again smaller, then elsewhere.
SHRINKING = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
PLACES = 60
# Random motions that tell which columns can be told apart.
TELLING = 10
# Models of the objective cost more than our evaluations do; the plain pattern is faster and found as good motions.
NOMAD = (
    "QUAD_MODEL_SEARCH no",
    "EVAL_QUEUE_SORT DIR_LAST_SUCCESS",
    "DIRECTION_TYPE ORTHO 2N",
    "BB_OUTPUT_TYPE OBJ PB PB PB",
    "DISPLAY_DEGREE 0",
)


@dataclass(frozen=True)
class Shape:
    """What kind of motion is sought: harmonics, period and ramp in s, and periods between the ramps."""

    harmonics: int = 5
    period: float = 10.0
    ramp: float | None = None
    periods: int = 1

    def __post_init__(self) -> None:
        _require(self.harmonics >= 1, f"{self.harmonics} harmonics are asked for", "Ask for at least one")
        _require(
            np.isfinite(self.period) and self.period > 0.0, f"the period is {self.period:g} s", "Give a time above 0"
        )
        _require(self.periods >= 1, f"{self.periods} periods are asked for", "Ask for at least one")
        ramp = self.period / 4.0 if self.ramp is None else self.ramp
        _require(np.isfinite(ramp) and ramp >= 0.0, f"the ramp is {ramp:g} s", "Give zero or a positive time")
        object.__setattr__(self, "ramp", float(ramp))


@dataclass(frozen=True, eq=False)
class ExcitationResult:
    """A search's outcome.

    Parameters
    ----------
    trajectory, start
        The best motion within the limits, and the one the search began with: the best of the random ones.
    criterion, value_before, value_after
        What was made small.
    condition_before, condition_after
        Condition numbers of the base regressor in the scale of ordinary motions, whatever the criterion.
    random : (R,)
        Condition numbers of the random motions within the same limits.
    columns
        Base columns that were judged.
    indistinct
        Base columns left out, because no ordinary motion tells them from the others.
    history
        (evaluation, best value so far) wherever it improved, and at the end.
    use
        Shares of the limits that `trajectory` uses.
    """

    trajectory: FourierTrajectory
    start: FourierTrajectory
    criterion: str
    value_before: float
    value_after: float
    condition_before: float
    condition_after: float
    random: Array
    columns: tuple[int, ...]
    indistinct: tuple[int, ...]
    history: tuple[tuple[int, float], ...]
    use: LimitUse
    evaluations: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        quartiles = np.percentile(self.random, [0, 25, 50, 75, 100]).tolist() if len(self.random) else None
        return {
            "criterion": self.criterion,
            "value": {"before": self.value_before, "after": self.value_after},
            "condition_number": {"before": self.condition_before, "after": self.condition_after},
            "random": {"count": len(self.random), "condition_number_min_quartiles_max": quartiles},
            "base_columns": list(self.columns),
            "indistinct_columns": list(self.indistinct),
            "evaluations": self.evaluations,
            "history": [list(entry) for entry in self.history],
            "limits": self.use.to_dict(),
        }


def optimise(
    model: Model,
    limits: MotionLimits,
    columns: Sequence[int] | NDArray[np.intp],
    *,
    rng: np.random.Generator,
    shape: Shape | None = None,
    criterion: str = "condition",
    noise: Array | None = None,
    evaluations: int = 3000,
    random: int = 50,
    progress: Progress | None = None,
) -> ExcitationResult:
    """Find a motion that determines the base parameters of `model` well.

    Parameters
    ----------
    model, columns
        The regressor and its base columns.
    limits
        That the motion keeps.
    rng
        The same generator state gives the same motion.
    shape
        Harmonics, period, ramp.
    criterion
        A name in :data:`elastic_arm.excitation.criteria.CRITERIA`.
    noise : (dof,)
        Standard deviation of each equation's error, Nm; None: all alike.
    evaluations
        Budget of the search, the random motions not counted.
    random
        Number of random motions, to start from and to compare with.
    progress
        Called with (evaluation, best value) after every evaluation.

    Raises
    ------
    ExcitationError
        If the criterion or the numbers make no sense, or no motion found keeps the limits (says which is broken).
    """
    _require(evaluations >= 1, f"{evaluations} evaluations are asked for", "Ask for at least one")
    _require(random >= 1, f"{random} random motions are asked for", "Ask for at least one, to start from")
    _require(len(columns) > 0, "the model has no base parameters", "Give the base columns of its regressor")
    problem = _Problem(model, limits, BaseRegressor(model, columns, noise), shape or Shape(), find_criterion(criterion))
    drawn = [problem.random(rng) for _ in range(random)]
    kept = [u for u in drawn if problem.excess(u).max() <= 0.0]
    indistinct = problem.refer_to(kept or drawn)
    start = min(kept, key=problem.value) if kept else min(drawn, key=lambda u: float(problem.excess(u).max()))
    course = _Course(problem, progress)
    # NOMAD steps its generator `seed` times to get there: a large seed would cost minutes.
    _run_nomad(course, start, evaluations, int(rng.integers(10_000)))
    best = course.best(start)
    use = limits.use(problem.trajectory(best), model)
    if not use.kept:
        raise ExcitationError(
            f"no motion within the limits was found in {course.count} evaluations; at best {use.worst()}",
            "Raise that limit, give the arm more time (a longer period or ramp), or search longer",
        )
    return ExcitationResult(
        trajectory=problem.trajectory(best),
        start=problem.trajectory(start),
        criterion=criterion,
        value_before=problem.value(start),
        value_after=problem.value(best),
        condition_before=problem.condition(start),
        condition_after=problem.condition(best),
        random=np.array([problem.condition(u) for u in kept]),
        columns=problem.columns,
        indistinct=indistinct,
        history=(*course.history, (course.count, course.value)),
        use=use,
        evaluations=course.count,
    )


def random_trajectories(
    model: Model, limits: MotionLimits, count: int, *, rng: np.random.Generator, shape: Shape | None = None
) -> list[FourierTrajectory]:
    """Return `count` random motions within the limits: coefficients uniform, turned down to the limits.

    Raises
    ------
    ExcitationError
        If one of them finds no place within the limits.
    """
    problem = _Problem(model, limits, BaseRegressor(model, ()), shape or Shape(), condition)
    found = [problem.trajectory(problem.random(rng)) for _ in range(count)]
    for trajectory in found:
        use = limits.use(trajectory, model)
        _require(use.kept, f"a random motion breaks the limits everywhere: {use.worst()}", "Raise that limit")
    return found


class _Problem:
    """Motions as points u in [-1, 1]^(n (2 H + 1)): centres, sines, cosines, joint by joint."""

    def __init__(
        self,
        model: Model,
        limits: MotionLimits,
        regressor: BaseRegressor,
        shape: Shape,
        criterion: Callable[[Array, Array], float],
    ) -> None:
        self._model, self._limits, self._regressor, self._shape = model, limits, regressor, shape
        self._criterion = criterion
        self._scale = np.ones(len(regressor.columns))

    @property
    def size(self) -> int:
        return self._model.n * (2 * self._shape.harmonics + 1)

    def trajectory(self, u: Array) -> FourierTrajectory:
        centres, waves = u[: self._model.n], u[self._model.n :].reshape(2, self._model.n, -1)
        a, b = waves * self._limits.velocity[:, None]
        assert self._shape.ramp is not None
        motion = FourierTrajectory.of_periods(
            self._shape.period,
            a,
            b,
            self._limits.centre + SHARE * self._limits.half_range * centres,
            periods=self._shape.periods,
            ramp=self._shape.ramp,
            joints=self._limits.joints,
        )
        return self._limits.fitted(motion, SHARE)

    def random(self, rng: np.random.Generator) -> Array:
        """Draw a motion; turn it down, then move it elsewhere, until torque and workspace are kept."""
        best, least = np.zeros(self.size), np.inf
        for _ in range(PLACES):
            u = rng.uniform(-1.0, 1.0, self.size)
            for factor in SHRINKING:
                v = self._point(self.trajectory(u).scaled(factor))
                excess = float(self.excess(v).max())
                if excess <= 0.0:
                    return v
                if excess < least:
                    best, least = v, excess
        return best

    def excess(self, u: Array) -> Array:
        """How far torque, floor and links are broken, (3,)."""
        return self._limits.use(self.trajectory(u), self._model).excess[3:]

    def refer_to(self, points: Sequence[Array]) -> tuple[int, ...]:
        """Take the scale of the columns from these ordinary motions; return the columns they cannot tell apart."""
        motions = [self._regressor(self.trajectory(u)) for u in points]
        distinct = distinct_columns(np.concatenate(motions[:TELLING]))
        self._scale = np.median([np.linalg.norm(W[:, distinct], axis=0) for W in motions], axis=0)
        self._regressor = replace(self._regressor, picked=distinct)
        return tuple(int(c) for c in np.delete(np.asarray(self._regressor.columns), distinct))

    @property
    def columns(self) -> tuple[int, ...]:
        """Base columns that count."""
        return tuple(int(c) for c in np.asarray(self._regressor.columns)[self._regressor.picked])

    def value(self, u: Array) -> float:
        return self._criterion(self._regressor(self.trajectory(u)), self._scale)

    def both(self, u: Array) -> tuple[float, Array]:
        """Value and excess of one motion."""
        motion = self.trajectory(u)
        value = self._criterion(self._regressor(motion), self._scale)
        return value, self._limits.use(motion, self._model).excess[3:]

    def condition(self, u: Array) -> float:
        return condition(self._regressor(self.trajectory(u)), self._scale)

    def _point(self, motion: FourierTrajectory) -> Array:
        centres = (motion.q0 - self._limits.centre) / (SHARE * self._limits.half_range)
        waves = np.array([motion.a, motion.b]) / self._limits.velocity[:, None]
        return np.clip(np.concatenate([centres, waves.ravel()]), -1.0, 1.0)


class _Course:
    """What the search asks for: evaluates points, remembers the best and how it came about."""

    def __init__(self, problem: _Problem, progress: Progress | None) -> None:
        self.problem = problem
        self.count = 0
        self.value = np.inf
        self.history: list[tuple[int, float]] = []
        self.error: BaseException | None = None
        self._best: Array | None = None
        self._progress = progress

    def best(self, otherwise: Array) -> Array:
        """Return the best point within the limits; `otherwise` where there was none."""
        return otherwise if self._best is None else self._best

    def __call__(self, point: Any) -> bool:
        """Evaluate a point for NOMAD."""
        if self.error is not None:
            return False
        u = np.array([point.get_coord(i) for i in range(point.size())])
        try:
            value, excess = self.problem.both(u)
            self._note(u, value, excess)
        except BaseException as error:  # noqa: BLE001 - raised again once NOMAD, which swallows it, has returned
            self.error = error
            return False
        point.setBBO(" ".join(repr(float(number)) for number in (value, *excess)).encode())
        return True

    def _note(self, u: Array, value: float, excess: Array) -> None:
        self.count += 1
        if excess.max() <= 0.0 and value < self.value:
            self.value, self._best = value, u
            self.history.append((self.count, value))
        if self._progress is not None:
            self._progress(self.count, self.value)


def _run_nomad(course: _Course, start: Array, evaluations: int, seed: int) -> None:
    # Slow to import, and needed for the search alone.
    import PyNomad

    size = len(start)
    # NOMAD's generator belongs to the process: without both calls, a second search would continue the first's numbers.
    PyNomad.setSeed(seed)
    PyNomad.resetRandomNumberGenerator()
    parameters = [*NOMAD, f"MAX_BB_EVAL {evaluations}", f"SEED {seed}"]
    PyNomad.optimize(course, start.tolist(), [-1.0] * size, [1.0] * size, parameters)
    if course.error is not None:
        raise course.error


def _require(condition: bool, problem: str, remedy: str) -> None:
    if not condition:
        raise ExcitationError(problem, remedy)
