"""What the trajectory generator streams: a smooth way to the start of a trajectory, then the trajectory itself."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BPoly

from elastic_arm.arrays import Array
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.nodes.following.splines import Row

# Peak speed and acceleration of a quintic from rest to rest: distance / duration and distance / duration² times these.
QUINTIC_SPEED = 15.0 / 8.0
QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
# Highest acceleration on the way to the start, rad/s².
GENTLE = 0.5


class Plan:
    """The approach to a trajectory's start, and the trajectory, one or more times.

    position: (n,) where the arm stands.
    """

    def __init__(self, trajectory: FourierTrajectory, position: Array, repeat: int = 1, speed: float = 0.3) -> None:
        self._trajectory, self._repeat = trajectory, repeat
        first = np.array([values[0] for values in trajectory.evaluate(np.zeros(1))])
        distance = float(np.max(np.abs(first[0] - position)))
        self.approach = max(QUINTIC_SPEED * distance / speed, float(np.sqrt(QUINTIC_ACCELERATION * distance / GENTLE)))
        at_rest = np.array([position, np.zeros_like(position), np.zeros_like(position)])
        self._way: list[BPoly] = []
        if self.approach > 0:
            way = BPoly.from_derivatives([0.0, self.approach], [at_rest, first])
            self._way = [way, way.derivative(), way.derivative(2)]

    @property
    def duration(self) -> float:
        """Seconds from the first to the last point; infinite when repeated for ever."""
        return self.approach + (self._repeat * self._trajectory.duration if self._repeat else np.inf)

    def evaluate(self, t: Array) -> Row:
        """Return the points at times t (N,), seconds from the beginning of the approach."""
        rest = t - self.approach
        cycle = np.floor(rest / self._trajectory.duration)
        if self._repeat:
            cycle = np.minimum(cycle, self._repeat - 1)
        inside = np.clip(rest - cycle * self._trajectory.duration, 0.0, self._trajectory.duration)
        points = [np.array(values) for values in self._trajectory.evaluate(inside)]
        before = rest < 0.0
        if before.any():
            for values, polynomial in zip(points, self._way, strict=True):
                values[before] = polynomial(t[before])
        return Row(*points)
