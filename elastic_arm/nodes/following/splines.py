"""Motion between points in time: linear, cubic or quintic, depending on the contents of the points,
as in joint_trajectory_controller.

The rule of ros2_controls: between two points with accelerations, the quintic through positions,
velocities and accelerations; between two points with velocities, the cubic through positions and
velocities; otherwise a straight line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from elastic_arm.arrays import Array, Indices, Mask

# Degree of the polynomial that a point allows: by its position alone, with its velocity, with its
# acceleration too.
LINEAR = 1
CUBIC = 3
QUINTIC = 5


class Row(NamedTuple):
    """Position, velocity and acceleration, each (n,), or (N, n) for several points."""

    position: Array
    velocity: Array
    acceleration: Array

    def at(self, index: int | Indices | Mask) -> Row:
        """Return some of several points, or one."""
        return Row(self.position[index], self.velocity[index], self.acceleration[index])

    def followed_by(self, other: Row) -> Row:
        """Return these points followed by those of `other`."""
        return Row(*map(np.vstack, zip(self, other, strict=True)))


def resting(row: Row) -> Row:
    """Return the same position at rest."""
    return Row(row.position, np.zeros_like(row.position), np.zeros_like(row.position))


@dataclass(frozen=True, eq=False)
class Points:
    """Points in time, N of them."""

    stamps: NDArray[np.int64]  # (N,) ns, increasing
    row: Row  # (N, n) each; rad, rad/s, rad/s²
    degree: NDArray[np.int64]  # (N,) of the polynomials that they allow: LINEAR, CUBIC or QUINTIC

    @property
    def last(self) -> Points:
        """The last point alone."""
        return Points(
            self.stamps[-1:], Row(*(values[-1:] for values in self.row)), self.degree[-1:]
        )

    def where(self, chosen: Mask) -> Points:
        """Return some of the points."""
        return Points(self.stamps[chosen], self.row.at(chosen), self.degree[chosen])

    def moved(self, by_ns: int) -> Points:
        """Return the points at later times."""
        return replace(self, stamps=self.stamps + by_ns)

    def followed_by(self, other: Points) -> Points:
        """Return these points followed by those of `other`."""
        return Points(
            np.concatenate((self.stamps, other.stamps)),
            self.row.followed_by(other.row),
            np.concatenate((self.degree, other.degree)),
        )

    def at(self, wanted: NDArray[np.int64] | Array) -> Row:
        """Return position, velocity and acceleration at times (M,) ns, (M, n) each.

        Before the first point its polynomial is extrapolated. At the last point its stated velocity
        applies, or zero without one. No time is after the last stamp.
        """
        if len(self.stamps) == 1:
            return self.row.at(np.zeros(len(wanted), dtype=np.intp))
        found = np.searchsorted(self.stamps, wanted, side="right") - 1
        left = np.clip(found, 0, len(self.stamps) - 2)
        h = np.asarray((self.stamps[left + 1] - self.stamps[left]) * 1e-9)[:, None]
        u = ((wanted - self.stamps[left]) * 1e-9)[:, None] / h
        end = self.row.at(left + 1)
        kind = np.minimum(self.degree[left], self.degree[left + 1])[:, None]
        c = _coefficients(self.row.at(left), end, h, kind)
        rate = polyder(c)
        position = polyval(u, c, tensor=False)
        velocity = polyval(u, rate, tensor=False) / h
        acceleration = polyval(u, polyder(rate), tensor=False) / h**2
        # At a point its own numbers hold, without the rounding of a polynomial in a millisecond.
        over = u == 1.0
        return Row(
            np.where(over, end.position, position),
            np.where(over, np.where(kind >= CUBIC, end.velocity, 0.0), velocity),
            np.where(over & (kind == QUINTIC), end.acceleration, acceleration),
        )


def _coefficients(start: Row, end: Row, h: Array, kind: NDArray[np.int64]) -> Array:
    """Return the coefficients of the powers 0 to 5 of the relative time, (6, M, n).

    A line and a cubic are quintics with the corresponding velocities and accelerations.
    """
    rise = end.position - start.position
    v0 = np.where(kind >= CUBIC, start.velocity * h, rise)
    v1 = np.where(kind >= CUBIC, end.velocity * h, rise)
    a0 = np.where(kind == QUINTIC, start.acceleration * h**2, 6 * rise - 4 * v0 - 2 * v1)
    a1 = np.where(kind == QUINTIC, end.acceleration * h**2, 2 * v0 + 4 * v1 - 6 * rise)
    third = 10 * rise - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1
    fourth = -15 * rise + 8 * v0 + 7 * v1 + 1.5 * a0 - a1
    fifth = 6 * rise - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1
    return np.stack([start.position, v0, 0.5 * a0, third, fourth, fifth])
