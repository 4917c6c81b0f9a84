"""The free numbers of a motion, which map a cube to motions within the kinematic limits, and random
motions.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.excitation.criteria import BaseRegressor, condition, distinct_columns
from elastic_arm.excitation.fourier import FourierTrajectory, require
from elastic_arm.excitation.limits import MotionLimits

# More would take memory for what no arm follows; ramps in periods.
MOST_HARMONICS = 100
LONGEST_RAMP = 100
# Share of the kinematic limits that the search uses, so that peaks between its samples stay within
# them.
SHARE = 0.98
# A random motion that breaks torque or workspace is tried again smaller, then elsewhere.
SHRINKING = (1.0, 0.7, 0.5, 0.35, 0.2, 0.1)
PLACES = 60
# Random places among which one is sought where an arm can stand: of thick links two in a hundred
# are free.
DRAWN = 1000
# Random motions that tell which columns can be told apart.
TELLING = 10


@dataclass(frozen=True)
class Shape:
    """What kind of motion is sought.

    Harmonics, period and ramp in s, and periods between the ramps.
    """

    harmonics: int = 5
    period: float = 10.0
    ramp: float | None = None
    periods: int = 1

    def __post_init__(self) -> None:
        require(
            1 <= self.harmonics <= MOST_HARMONICS,
            f"{self.harmonics} harmonics are requested",
            f"Request at least one, and at most {MOST_HARMONICS}",
        )
        require(
            np.isfinite(self.period) and self.period > 0.0,
            f"the period is {self.period:g} s",
            "Give a time above 0",
        )
        require(self.periods >= 1, f"{self.periods} periods are requested", "Request at least one")
        ramp = self.period / 4.0 if self.ramp is None else self.ramp
        longest = LONGEST_RAMP * self.period
        require(
            0.0 <= ramp <= longest,
            f"the ramp is {ramp:g} s",
            f"Give zero or a time up to {longest:g} s",
        )
        object.__setattr__(self, "ramp", float(ramp))


def random_trajectories(
    model: Model,
    limits: MotionLimits,
    count: int,
    *,
    rng: np.random.Generator,
    shape: Shape | None = None,
) -> list[FourierTrajectory]:
    """Return `count` random motions within the limits.

    Coefficients are uniform and turned down to the limits.

    Raises an ExcitationError if one of them finds no place within the limits.
    """
    problem = Problem(model, limits, BaseRegressor(model, ()), shape or Shape(), condition)
    found = [problem.trajectory(problem.random(rng)) for _ in range(count)]
    for trajectory in found:
        use = limits.use(trajectory, model)
        require(
            use.kept,
            f"a random motion violates the limits everywhere: {use.worst()}",
            "Raise that limit",
        )
    return found


def liveliest(motions: Sequence[FourierTrajectory], count: int) -> list[FourierTrajectory]:
    """Return the motions whose slowest joint gets fastest, the best last.

    Where a joint rests, nothing shows of it.
    """

    def slowest(motion: FourierTrajectory) -> float:
        _, speeds, _ = motion.evaluate(np.linspace(0.0, motion.duration, 500))
        return float(np.abs(speeds).max(axis=0).min())

    return sorted(motions, key=slowest)[-count:]


class Problem:
    """Motions as points u in [-1, 1]^(n (2 H + 1)): centres, sines, cosines, joint by joint."""

    def __init__(
        self,
        model: Model,
        limits: MotionLimits,
        regressor: BaseRegressor,
        shape: Shape,
        criterion: Callable[[Array, Array], float],
    ) -> None:
        self._model = model
        self._limits = limits
        self._regressor = regressor
        self._shape = shape
        self._criterion = criterion
        self._scale = np.ones(len(regressor.columns))

    @property
    def size(self) -> int:
        return self._model.n * (2 * self._shape.harmonics + 1)

    def trajectory(self, u: Array) -> FourierTrajectory:
        centres = u[: self._model.n]
        waves = u[self._model.n :].reshape(2, self._model.n, -1)
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
        """Draw a motion that keeps torque and workspace.

        It is turned down, then moved elsewhere, until it does.
        """
        best = np.zeros(self.size)
        least = np.inf
        for u in self._places(rng):
            for factor in SHRINKING:
                v = self._point(self.trajectory(u).scaled(factor))
                excess = float(self.excess(v).max())
                if excess <= 0.0:
                    return v
                if excess < least:
                    best = v
                    least = excess
        return best

    def _places(self, rng: np.random.Generator) -> Iterator[Array]:
        """Yield motions at random places, and where none of them will do, at as many where the arm
        can stand.

        Where torques hold the arm at none of the first, the limits are to blame, and no others are
        sought.
        """
        draws = (rng.uniform(-1.0, 1.0, self.size) for _ in range(PLACES + DRAWN))
        tried = []
        for u in islice(draws, PLACES):
            tried.append(u)
            yield u
        if any(self._at_rest(u)[0] <= 0.0 for u in tried):
            yield from islice((u for u in draws if self._at_rest(u).max() <= 0.0), PLACES)

    def _at_rest(self, u: Array) -> Array:
        """How far torque, floor and links are broken where a motion begins, (3,)."""
        return self._limits.use(self.trajectory(u), self._model, np.zeros(1)).excess[3:]

    def excess(self, u: Array) -> Array:
        """How far torque, floor and links are broken, (3,)."""
        return self._limits.use(self.trajectory(u), self._model).excess[3:]

    def refer_to(self, points: Sequence[Array]) -> tuple[int, ...]:
        """Take the columns' scale from ordinary motions; return indistinct columns."""
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
