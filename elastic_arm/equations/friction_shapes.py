"""How the friction of a joint differs from the laws that describe it, in proportion to itself.

    F' = F + F_d (sum_k c_k (z_k - s) + a) + |F| s (sum_k b_k h_k(|w|) + l |tau| / tau_max + p t/T)

F is what the laws of friction make at a side of a joint, F_d the magnitude of its part with the
sign s of the velocity w, t/T from -1/2 to 1/2. No drive is as simple as Coulomb and viscous
friction: friction turns over within a distance (z_k, of the distance d_k), differs by direction,
speed (h_k, hats over ln |w|) and load, and falls as the joint warms up. Each c, a, b, l and p is a
number with a prior, so that an ordinary difference is no cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from elastic_arm.arrays import Array

# of the highest speed: between them friction differs smoothly, below and above it is as at the ends
NODES = (0.02, 0.1, 0.5)
# rad: distances over which dry friction turns over; between two, a sum of both is as good
DISTANCES = tuple(5e-4 * 2.0**k for k in range(7))
TURNOVER = 0.5  # prior deviation of the share of dry friction that turns over within one of them


@dataclass(frozen=True)
class FrictionShape:
    """One of the functions of the motion by which friction differs, and what it refers to."""

    kind: str  # "distance", "direction", "speed", "load" or "time"
    # rad of a distance, rad/s of the highest speed, Nm of the largest load
    scale: float = 1.0
    node: int = 0  # of a speed: which of :data:`NODES`

    @property
    def is_dry(self) -> bool:
        """Whether it belongs to the friction that has the sign of the velocity."""
        return self.kind in ("distance", "direction")

    def of(self, angle: Array, speed: Array, sign: Array, load: Array, progress: Array) -> Array:
        """Return its course (N,) in units of the friction's magnitude.

        angle, speed, sign: (N,) of the side on which the friction acts; load: (N,) Nm in the joint;
        progress: (N,) from -1/2 to 1/2 over the recording.
        """
        if self.kind == "distance":
            return over_distance(angle, sign, self.scale) - sign
        if self.kind == "direction":
            return np.ones_like(sign)
        if self.kind == "speed":
            place = np.log(np.maximum(np.abs(speed) / self.scale, 1e-9))
            values = np.eye(len(NODES))[self.node]
            return sign * np.interp(place, np.log(NODES), values)
        if self.kind == "load":
            return sign * np.abs(load) / self.scale
        return sign * progress


def over_distance(angle: Array, sign: Array, distance: float) -> Array:
    """Return the course (N,) of dry friction of 1 that turns over within a distance.

        dz/dq = (1 - z sign(dq)) / d                                       (Dahl 1968)

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
        gone = np.abs(angle[first + 1 : last + 1] - angle[first])
        state[first + 1 : last + 1] = way + (z - way) * np.exp(-gone / distance)
        z = float(state[last])
    return state


def shapes_of(
    speed: float, load: float, spread: float
) -> Sequence[tuple[str, FrictionShape, float]]:
    """Return name, shape and prior standard deviation of each shape of the friction of a side.

    speed: highest of the joint, rad/s; load: largest in it, Nm; spread: relative prior standard
    deviation of the friction at one speed.
    """
    found = [
        (f"distance_{k}", FrictionShape("distance", distance), TURNOVER)
        for k, distance in enumerate(DISTANCES)
    ]
    found += [(f"speed_{k}", FrictionShape("speed", speed, k), spread) for k in range(len(NODES))]
    found += [
        ("direction", FrictionShape("direction"), 0.5 * spread),
        ("load", FrictionShape("load", load), spread),
        ("time", FrictionShape("time"), 0.5 * spread),
    ]
    return found
