"""Motion between points in time: linear, cubic or quintic by what the points hold, as
joint_trajectory_controller does.

The rule of ros2_controls: between two points that both hold accelerations, the quintic through
positions, velocities and accelerations; where both hold velocities, the cubic through positions and
velocities; otherwise a straight line.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array

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


def resting(row: Row) -> Row:
    """Return the same position at rest."""
    return Row(row.position, np.zeros_like(row.position), np.zeros_like(row.position))


def interpolate(
    stamps: NDArray[np.int64],
    points: Row,
    degree: NDArray[np.int64] | int,
    wanted: NDArray[np.int64],
) -> Row:
    """Return position, velocity and acceleration at the times `wanted` (M,), (M, n) each.

    Before the first point its polynomial is continued; the last point's own velocity holds at its
    time, and zero where it states none.

    stamps: (N,) ns, increasing; points: (N, n) each; rad, rad/s, rad/s²; degree: of each point,
    (N,), or of all: LINEAR, CUBIC or QUINTIC; wanted: (M,) ns, not behind the last stamp.
    """
    if len(stamps) == 1:
        index = np.zeros(len(wanted), dtype=int)
        return Row(*(values[index] for values in points))
    degree = np.broadcast_to(degree, len(stamps))
    left = np.clip(np.searchsorted(stamps, wanted, side="right") - 1, 0, len(stamps) - 2)
    h = np.asarray((stamps[left + 1] - stamps[left]) * 1e-9, dtype=np.float64)[:, None]
    u = ((wanted - stamps[left]) * 1e-9)[:, None] / h
    start = Row(*(values[left] for values in points))
    end = Row(*(values[left + 1] for values in points))
    kind = np.minimum(degree[left], degree[left + 1])[:, None]
    c = _coefficients(start, end, h, kind)
    rate = _derivative(c)
    position = _polynomial(c, u)
    velocity = _polynomial(rate, u) / h
    acceleration = _polynomial(_derivative(rate), u) / h**2
    # At a point its own numbers hold, without the rounding of a polynomial in a millisecond.
    over = u == 1.0
    return Row(
        np.where(over, end.position, position),
        np.where(over, np.where(kind >= CUBIC, end.velocity, 0.0), velocity),
        np.where(over & (kind == QUINTIC), end.acceleration, acceleration),
    )


def _polynomial(coefficients: Sequence[Array], u: Array) -> Array:
    """Return the sum of coefficients times powers of u, by Horner's rule."""
    *lower, total = coefficients
    for coefficient in reversed(lower):
        total = total * u + coefficient
    return total


def _derivative(coefficients: Sequence[Array]) -> list[Array]:
    return [power * c for power, c in enumerate(coefficients)][1:]


def _coefficients(start: Row, end: Row, h: Array, kind: NDArray[np.int64]) -> list[Array]:
    """Coefficients of the powers 0 to 5 of the share of the way in time, (M, n) each."""
    rise = end.position - start.position
    v0 = start.velocity * h
    v1 = end.velocity * h
    a0 = 0.5 * start.acceleration * h**2
    a1 = 0.5 * end.acceleration * h**2
    cubic = kind >= CUBIC
    quintic = kind >= QUINTIC
    zero = np.zeros_like(rise)
    of_cubic = (v0, 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise, zero, zero)
    of_quintic = (
        v0,
        a0,
        10 * rise - 6 * v0 - 4 * v1 - 3 * a0 + a1,
        -15 * rise + 8 * v0 + 7 * v1 + 3 * a0 - 2 * a1,
        6 * rise - 3 * v0 - 3 * v1 - a0 + a1,
    )
    of_line = (rise, zero, zero, zero, zero)
    found = [start.position]
    for line, third, fifth in zip(of_line, of_cubic, of_quintic, strict=True):
        found.append(np.where(quintic, fifth, np.where(cubic, third, line)))
    return found
