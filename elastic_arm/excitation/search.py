"""Search for the motion within limits that determines the base parameters best.

The free numbers are where each joint swings about and its amplitudes. Joints are turned down to
their kinematic limits before a motion is evaluated, so that only torque and workspace remain as
constraints. The search is mesh adaptive direct search, NOMAD's (C. Audet, S. Le Digabel, V. Rochon
Montplaisir and C. Tribes, ACM Trans. Mathematical Software 48 (2022) 35), which polls a pattern of
points around the best one, takes no derivatives and lets constraints be broken on the way
(progressive barrier).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.dynamics import Model
from elastic_arm.excitation.criteria import BaseRegressor, find_criterion
from elastic_arm.excitation.fourier import FourierTrajectory, require
from elastic_arm.excitation.limits import LimitUse, MotionLimits
from elastic_arm.excitation.problem import Problem, Shape
from elastic_arm.interrupts import interrupt_waits, interrupts_count, interrupts_kept

Progress = Callable[[int, float], None]

# NOMAD draws and throws away as many numbers as its seed says: a seed near 2^31 takes a minute.
LARGEST_SEED = 2**16
# Models of the objective cost more than our evaluations do (minutes against seconds), and the start
# is good already: a plain pattern of a twentieth of the range to begin with found the best motions.
NOMAD = (
    "INITIAL_FRAME_SIZE * 0.1",
    "QUAD_MODEL_SEARCH no",
    "EVAL_QUEUE_SORT DIR_LAST_SUCCESS",
    "DIRECTION_TYPE ORTHO 2N",
    "BB_OUTPUT_TYPE OBJ PB PB PB",
    "DISPLAY_DEGREE 0",
)
# What its reason for stopping begins with where it has got a SIGINT.
INTERRUPTED = "Ctrl-C"


@dataclass(frozen=True, eq=False)
class ExcitationResult:
    """A search's outcome."""

    # trajectory, start: the best motion within the limits, and the one the search began with: the
    # best of the random ones
    trajectory: FourierTrajectory
    start: FourierTrajectory
    # criterion, value_before, value_after: what was made small
    criterion: str
    value_before: float
    value_after: float
    # condition_before, condition_after: condition numbers of the base regressor in the scale of
    # ordinary motions, whatever the criterion
    condition_before: float
    condition_after: float
    random: Array  # (R,) condition numbers of the random motions within the same limits
    columns: tuple[int, ...]  # base columns that were judged
    # base columns left out, because no ordinary motion separates them from the others
    indistinct: tuple[int, ...]
    # (evaluation, best value so far) wherever it improved, and at the end
    history: tuple[tuple[int, float], ...]
    use: LimitUse  # shares of the limits that `trajectory` uses
    evaluations: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        quartiles = (
            np.percentile(self.random, [0, 25, 50, 75, 100]).tolist() if len(self.random) else None
        )
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
    columns: Sequence[int] | Indices,
    *,
    rng: np.random.Generator,
    shape: Shape | None = None,
    criterion: str = "condition",
    noise: Array | None = None,
    evaluations: int = 3000,
    random: int = 50,
    progress: Progress | None = None,
) -> ExcitationResult:
    """Find a motion within limits that determines the base `columns` of `model` well.

    The same state of `rng` gives the same motion. `noise` (dof,) is the standard deviation of each
    equation's error, Nm, all alike when None; `evaluations` the budget of the search beside the
    `random` motions to start from and compare with. `progress` is called with evaluation and best
    value. Raises an ExcitationError if criterion or numbers make no sense, or no motion found keeps
    the limits (names which is broken).
    """
    require(evaluations >= 1, f"{evaluations} evaluations are requested", "Request at least one")
    require(
        random >= 1,
        f"{random} random motions are requested",
        "Request at least one, as a starting point",
    )
    require(
        len(columns) > 0,
        "the model has no base parameters",
        "Give the base columns of its regressor",
    )
    regressor = BaseRegressor(model, columns, noise)
    problem = Problem(model, limits, regressor, shape or Shape(), find_criterion(criterion))
    drawn = [problem.random(rng) for _ in range(random)]
    kept = [u for u in drawn if problem.excess(u).max() <= 0.0]
    indistinct = problem.refer_to(kept or drawn)
    start = (
        min(kept, key=problem.value)
        if kept
        else min(drawn, key=lambda u: float(problem.excess(u).max()))
    )
    course = _Course(problem, progress)
    _run_nomad(course, start, evaluations, int(rng.integers(LARGEST_SEED)))
    best = course.best(start)
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
        use=_kept_use(model, limits, problem.trajectory(best), course.count),
        evaluations=course.count,
    )


def _kept_use(
    model: Model, limits: MotionLimits, trajectory: FourierTrajectory, evaluations: int
) -> LimitUse:
    use = limits.use(trajectory, model)
    require(
        use.kept,
        f"no motion within the limits was found in {evaluations} evaluations; the best"
        f" one: {use.worst()}",
        "Raise that limit, give the arm more time (a longer period or ramp), or search longer",
    )
    return use


class _Course:
    """The objective of the search: evaluates points, remembers the best and how it came about."""

    def __init__(self, problem: Problem, progress: Progress | None) -> None:
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
        try:
            if interrupt_waits():
                raise KeyboardInterrupt
            u = np.array([point.get_coord(i) for i in range(point.size())])
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
            self.value = value
            self._best = u
            self.history.append((self.count, value))
        if self._progress is not None:
            self._progress(self.count, self.value)


def _run_nomad(course: _Course, start: Array, evaluations: int, seed: int) -> None:
    # Slow to import, and needed for the search alone.
    import PyNomad

    size = len(start)
    # NOMAD's generator belongs to the process: without both calls, a second search would continue
    # the first's numbers.
    PyNomad.setSeed(seed)
    PyNomad.resetRandomNumberGenerator()
    parameters = [*NOMAD, f"MAX_BB_EVAL {evaluations}", f"SEED {seed}"]
    with interrupts_kept():
        found = PyNomad.optimize(course, start.tolist(), [-1.0] * size, [1.0] * size, parameters)
    if course.error is not None:
        raise course.error
    # through another thread
    if found["stop_reason"].startswith(INTERRUPTED) and interrupts_count():
        raise KeyboardInterrupt
