"""Dry friction that changes its sign within a distance after a reversal.

    z = s + sum_k c_k (z_k - s)         c_k >= 0 the share that turns over within d_k
    dz_k/dq = (1 - z_k sign(dq)) / d_k                                             (Dahl 1968)

s is the sign of the velocity and q the angle.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.estimation.regressors import Signals

# rad, m for slides: between two of them, a sum of both is as good
DISTANCES = tuple(1.25e-4 * 2.0**k for k in range(9))


class FrictionPlace(NamedTuple):
    """Where friction acts."""

    joint: str
    side: str  # "link" or "motor"


def turned_over(signals: Signals, place: FrictionPlace, j: int, shares: Array) -> Array:
    """Return z (N,) of a place, the sign of its velocity after shares (K,) have turned over.

    j: index of the joint.
    """
    sign = _sign(signals, place, j)
    return sign + shares @ late_signs(signals, place, j) if np.any(shares) else sign


def late_signs(signals: Signals, place: FrictionPlace, j: int) -> Array:
    """Return z_k - s (K, N) of a place; j is the index of the joint."""
    sign = _sign(signals, place, j)
    coordinates = signals.values["x"]
    n = signals.values["tau_J"].shape[1]
    of_motor = place.side == "motor" and coordinates.shape[1] > n
    angle = coordinates[:, n + j] if of_motor else coordinates[:, j]
    return np.array([over_distance(angle, sign, distance) - sign for distance in DISTANCES])


def _sign(signals: Signals, place: FrictionPlace, j: int) -> Array:
    return signals.values[f"sign_{place.side}"][:, j]


def over_distance(angle: Array, sign: Array, distance: float) -> Array:
    """Return the course (N,) of dry friction of 1 that turns over within a distance.

    While the angle (N,) rad goes one way, s, the difference z - s falls by exp(-|way| / d). sign:
    (N,) of the velocity, with the first of which it begins.
    """
    steps = np.diff(angle)
    ways = np.sign(steps)
    turns = np.flatnonzero(np.diff(ways)) + 1
    state = np.empty_like(angle)
    z = float(sign[0])
    state[0] = z
    for first, last in pairwise([0, *turns.tolist(), len(steps)]):
        way = ways[first]
        if way == 0.0:  # at rest it stays
            state[first + 1 : last + 1] = z
            continue
        gone = np.abs(angle[first + 1 : last + 1] - angle[first])
        state[first + 1 : last + 1] = way + (z - way) * np.exp(-gone / distance)
        z = float(state[last])
    return state
