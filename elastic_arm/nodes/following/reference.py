"""The reference of a simulated arm: it converts streamed points to one row per step."""

from collections import deque

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.nodes.following.splines import LINEAR, QUINTIC, Points, Row, resting
from elastic_arm.nodes.support.wire import NANOSECONDS

# A pause between streamed points longer than this is the start of another motion, not a hole to
# bridge.
LONGEST_HOLE_NS = NANOSECONDS // 2
# With less than this of the stream left, seconds, the arm slows down, so that it stands where the
# stream breaks off; it takes as long to pick up again.
BRAKING = 0.2
# At a smaller share of its speed the arm stops.
SLOWEST = 0.01
# Points older than this, seconds, are of another run, or another clock.
OLDEST = 10.0
# Slower than this, rad/s, is standing still: rounding leaves less.
STILL = 1e-6


class ReferenceQueue:
    """Brings streamed points onto a grid of steps.

    Between points the polynomial holds that they allow
    (:mod:`elastic_arm.nodes.following.splines`). A message replaces whatever of the stream lies
    behind its first point. Where the stream ends, the last position is held.

    Nothing of a motion is left out because it comes late. A motion that begins late is followed
    from its first point on, late. Where the stream falls behind, the arm slows down along its path,
    stands, and picks up again, as a machine tool does under feed hold. It is :attr:`delay` behind
    the stamps then, until another motion begins.

    start: (n,) position held until the first point; origin_ns, step_ns: step k of the grid is at
    `origin_ns + k * step_ns`. Of the attributes, `delay` is by how many steps the arm is behind the
    stamps, `starved` how often the stream fell behind, `late` how many points were left out, older
    than any delay.
    """

    def __init__(self, start: Array, origin_ns: int, step_ns: int) -> None:
        self._origin = origin_ns
        self._step = step_ns
        rest = np.zeros_like(start)
        self._last = Row(np.array(start, dtype=float), rest, rest)
        # Rows without a hole between them are one motion. What the arm has gone through is gone.
        self._motions: deque[deque[tuple[int, Row]]] = deque()
        self._tail: Points | None = None
        self._head = 0.0
        self._speed = 0.0
        self._following = False
        self._braking = round(BRAKING * NANOSECONDS / step_ns)
        self.delay = 0.0
        self.starved = 0
        self.late = 0

    def add(self, points: Points) -> None:
        """Add streamed points.

        They continue the earlier ones if they are less than half a second behind them.
        """
        self._cut(int(points.stamps[0]))
        if (tail := self.bridge(int(points.stamps[0]))) is not None:
            # the straight line leaves the last point at its own speed
            if min(tail.degree[0], points.degree[0]) == LINEAR:
                self._cut(int(tail.stamps[0]), keep=True)
            points = tail.followed_by(points)
        first = self._step_at(int(points.stamps[0]))
        last = (int(points.stamps[-1]) - self._origin) // self._step
        if self._motions:
            first = max(first, self._motions[-1][-1][0] + 1)
        steps = np.arange(first, last + 1)
        if len(steps):
            self.extend(first, points.at(self._origin + steps * self._step))
        self._tail = points.last

    def bridge(self, stamp: int) -> Points | None:
        """Return the point from which a stream continues to `stamp`; None for another motion."""
        if self._tail and 0 < stamp - int(self._tail.stamps[0]) <= LONGEST_HOLE_NS:
            return self._tail
        return None

    @property
    def present(self) -> Row:
        """The row returned last."""
        return self._last

    def clear(self) -> None:
        """Discard all future points; points added later are a new motion."""
        self._motions.clear()
        self._tail = None
        self._following = False
        self.delay = 0.0

    def extend(self, first: int, rows: Row) -> None:
        """Append rows on the grid, (N, n) each, from the step `first` on.

        It follows the last step added.
        """
        if not self._motions or self._motions[-1][-1][0] != first - 1:
            self._motions.append(deque())
        self._motions[-1].extend(
            (first + k, Row(*row)) for k, row in enumerate(zip(*rows, strict=True))
        )

    def last_position(self, stamp: int) -> Array:
        """Return the planned position just before a stamp, as far as it is known, (n,)."""
        before = (stamp - 1 - self._origin) // self._step
        for motion in reversed(self._motions):
            if motion[0][0] <= before:
                return motion[min(before, motion[-1][0]) - motion[0][0]][1].position
        return self._last.position

    def at(self, step: int) -> Row:
        """Return the reference of a step; steps have to be requested in order."""
        if self._following:
            self._advance()
        if not self._following:
            self._begin(step)
        self.delay = step - self._head if self._following else 0.0
        return self._last

    def starving(self) -> bool:
        """Return whether the arm is moving and the stream is about to end."""
        return self._following and self._feed() < 1.0

    def _step_at(self, stamp: int) -> int:
        """Return the first step at or after a stamp."""
        return -(-(stamp - self._origin) // self._step)

    def _cut(self, stamp: int, keep: bool = False) -> None:
        """Discard the points after a stamp; with `keep` not those that the arm has already
        reached."""
        first = self._step_at(stamp)
        if keep and self._motions and self._motions[-1][0][0] >= first - 1:
            return
        while self._motions:
            motion = self._motions[-1]
            while motion and motion[-1][0] >= first:
                motion.pop()
            if motion:
                return
            self._motions.pop()
            self._following = self._following and bool(self._motions)

    def _begin(self, step: int) -> None:
        """Start the next motion if it is due, even if late."""
        while self._motions:
            motion = self._motions[0]
            while motion and motion[0][0] < step - OLDEST * NANOSECONDS / self._step:
                motion.popleft()
                self.late += 1
            if motion:
                break
            self._motions.popleft()
        if not self._motions:
            return
        # A rest that has passed need not be waited through.
        while (
            len(motion) > 1
            and motion[0][0] < step
            and _still(motion[0][1])
            and _still(motion[1][1])
        ):
            motion.popleft()
        if motion[0][0] <= step:
            self._following = True
            self._speed = 1.0
            self._head = float(motion[0][0])
            self._last = motion[0][1]

    def _advance(self) -> None:
        """Continue along the current motion, at full speed or slower."""
        motion = self._motions[0]
        before = self._speed
        feed = self._feed()
        self.starved += feed < 1.0 <= before
        over = self._head >= motion[-1][0] and _still(motion[-1][1])
        # What is left of a motion that broke off is given up for the next.
        if over or (feed < SLOWEST and len(self._motions) > 1):
            self._motions.popleft()
            self._following = False
            self._last = resting(self._last)
            return
        self._speed = min(feed, before + 1.0 / self._braking) if feed >= SLOWEST else 0.0
        self._head = min(self._head + self._speed, float(motion[-1][0]))
        while motion[0][0] < int(self._head):
            motion.popleft()
        self._last = self._row((self._speed - before) * NANOSECONDS / self._step)

    def _feed(self) -> float:
        """Return the relative speed: 1, or less if the stream is about to end."""
        end, row = self._motions[0][-1]
        left = (end - self._head - 1.0) / self._braking
        if left >= 1.0 or _still(row):
            return 1.0
        left = max(left, 0.0)
        return left * (2.0 - left)  # meets full speed without a kink

    def _row(self, rise: float) -> Row:
        """Return the motion at the head, at the present speed, which increases by `rise` per
        second."""
        motion = self._motions[0]
        rest = self._head - motion[0][0]
        row = motion[0][1]
        if rest > 0.0:
            both = Row(*map(np.array, zip(row, motion[1][1], strict=True)))
            grid = Points(np.array([0, self._step]), both, np.array([QUINTIC, QUINTIC]))
            row = grid.at(np.array([rest * self._step])).at(0)
        if self._speed == 0.0:
            return resting(row)
        if self._speed == 1.0 and rise == 0.0:
            return row
        return Row(
            row.position,
            self._speed * row.velocity,
            self._speed**2 * row.acceleration + rise * row.velocity,
        )


def _still(row: Row) -> bool:
    return bool(np.max(np.abs(row.velocity)) <= STILL)
