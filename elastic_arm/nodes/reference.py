"""The reference that a simulated arm follows: streamed points in, one row per step out."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# A pause between streamed points longer than this is the start of another motion, not a hole to bridge.
LONGEST_HOLE_NS = 50_000_000
# Slower than this, rad/s, is standing still: rounding leaves less.
STILL = 1e-6


class Row(NamedTuple):
    """Position, velocity and acceleration, each (n,)."""

    position: Array
    velocity: Array
    acceleration: Array


class ReferenceQueue:
    """Brings streamed points onto a grid of steps.

    Between points, the cubic through positions and velocities holds (its error is of the fourth order in the points'
    spacing), and the acceleration is linear. A message replaces whatever of the stream lies behind its first point, as
    a trajectory does in ROS. Where the stream ends, the last position is held.

    Parameters
    ----------
    start
        (n,) position held until the first point.
    step_ns
        Spacing of the grid; step k is at `origin_ns + k * step_ns`.
    """

    def __init__(self, start: Array, origin_ns: int, step_ns: int) -> None:
        self._origin, self._step = origin_ns, step_ns
        rest = np.zeros_like(start)
        self._last = Row(np.array(start, dtype=float), rest, rest)
        self._rows: deque[tuple[int, Row]] = deque()
        self._tail: tuple[int, Row] | None = None
        self.late = 0
        self.starved = 0

    @property
    def horizon_ns(self) -> int | None:
        """Time of the last point streamed; None before the first."""
        return self._tail[0] if self._tail else None

    def add(self, stamps: Sequence[int] | NDArray[np.int64], points: Row) -> None:
        """Take points at `stamps` (N,) ns, increasing; `points` holds (N, n) each."""
        stamps = np.asarray(stamps, dtype=np.int64)
        while self._rows and self._time(self._rows[-1][0]) >= stamps[0]:
            self._rows.pop()
        if self._tail and 0 < stamps[0] - self._tail[0] <= LONGEST_HOLE_NS:
            stamps = np.concatenate(([self._tail[0]], stamps))
            points = Row(*(np.vstack((before, now)) for before, now in zip(self._tail[1], points, strict=True)))
        first = -(-(int(stamps[0]) - self._origin) // self._step)
        last = (int(stamps[-1]) - self._origin) // self._step
        if self._rows:
            first = max(first, self._rows[-1][0] + 1)
        steps = np.arange(first, last + 1)
        rows = _between(stamps, points, self._origin + steps * self._step)
        self._rows.extend((int(k), Row(*row)) for k, *row in zip(steps, *rows, strict=True))
        self._tail = (int(stamps[-1]), Row(*(values[-1] for values in points)))

    def at(self, step: int) -> Row:
        """Return the reference of a step; steps are asked for in order."""
        while self._rows and self._rows[0][0] < step:
            self._rows.popleft()
            self.late += 1
        if self._rows and self._rows[0][0] == step:
            self._last = self._rows.popleft()[1]
        elif self._moving():
            self.starved += 1
            rest = np.zeros_like(self._last.position)
            self._last = Row(self._last.position, rest, rest)
        return self._last

    def starving(self, step: int) -> bool:
        """Say whether the arm is in motion and the stream does not reach this step."""
        return self._moving() and not (self._rows and self._rows[-1][0] >= step)

    def _moving(self) -> bool:
        return bool(np.max(np.abs(self._last.velocity)) > STILL)

    def _time(self, step: int) -> int:
        return self._origin + step * self._step


def _between(stamps: NDArray[np.int64], points: Row, wanted: NDArray[np.int64]) -> Row:
    """Evaluate the cubic through positions and velocities, and the linear acceleration, at the times `wanted`."""
    if len(stamps) == 1:
        index = np.zeros(len(wanted), dtype=int)
        return Row(*(values[index] for values in points))
    left = np.clip(np.searchsorted(stamps, wanted, side="right") - 1, 0, len(stamps) - 2)
    h = ((stamps[left + 1] - stamps[left]) * 1e-9)[:, None]
    s = ((wanted - stamps[left]) * 1e-9)[:, None] / h
    p0, p1 = points.position[left], points.position[left + 1]
    v0, v1 = points.velocity[left] * h, points.velocity[left + 1] * h
    rise = p1 - p0
    quadratic, cubic = 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise
    a0, a1 = points.acceleration[left], points.acceleration[left + 1]
    return Row(
        p0 + s * (v0 + s * (quadratic + s * cubic)),
        (v0 + s * (2 * quadratic + 3 * s * cubic)) / h,
        a0 + s * (a1 - a0),
    )
