"""Dry friction turns over within a distance, not at once.

    F' = F + F_d sum_k c_k (z_k - s),        dz_k/dq = (1 - z_k sign(dq)) / d_k    (Dahl 1968)

F is what the laws of friction make at a side of a joint, F_d the magnitude of its part with the
sign s of the velocity. The share of F_d that turns over within the distance d_k is c_k, a number
with a prior. Without these, friction that turns over late is taken for a delay or a low pass of the
torque.
"""

from itertools import pairwise

import numpy as np

from elastic_arm.arrays import Array

# rad: between two of them, a sum of both is as good
DISTANCES = tuple(5e-4 * 2.0**k for k in range(7))
TURNOVER = 0.5  # prior deviation of the share of dry friction that turns over within one of them


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
