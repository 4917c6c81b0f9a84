"""Dry friction turns over within a distance, not at once.

    F' = F + F_d sum_k c_k (z_k - s),        dz_k/dq = (1 - z_k sign(dq)) / d_k    (Dahl 1968)

F is what the laws of friction make at a side of a joint, F_d the magnitude of its part with the
sign s of the velocity, and c_k >= 0 the share of F_d that turns over within the distance d_k.
Without this, friction that turns over late is taken for a delay or a low pass of the torque.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.regressors import Entries, Signals
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.robot import Robot

# rad: between two of them, a sum of both is as good
DISTANCES = tuple(5e-4 * 2.0**k for k in range(7))


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


def places_of_friction(acting: Sequence[ActingEffect]) -> list[tuple[str, str]]:
    """Return the joints and sides at which friction acts."""
    features = [effect.feature for effect in acting if effect.feature.effect.friction]
    return list(dict.fromkeys((str(one.joint), side) for one in features for side in one.sides))


def turnover_columns(
    data: WhitenedData, robot: Robot, acting: Sequence[ActingEffect], joint: str, side: str
) -> list[Array]:
    """Return the columns (N', R, K) Nm of each stretch, one for each distance; none at all where no
    friction has the sign of the velocity.

    acting: effects that act; of them the friction of this joint and side turns over.
    """
    n = robot.n
    j = robot.joint_names.index(joint)
    of_motor = robot.elastic and side == "motor"
    rows = np.full(len(DISTANCES), 2 * n + j if of_motor else j)
    dry = [
        np.sum([_dry(effect, part.signals, joint, side) for effect in acting], axis=0)
        for part in data.parts
    ]
    if not any(one.any() for one in dry):
        return []
    found = []
    for part, size in zip(data.parts, dry, strict=True):
        motion = part.stretch.quiet
        angle = (motion.theta if of_motor else motion.q)[:, j]
        sign = part.signals.values[f"sign_{side}"][:, j]
        courses = [over_distance(angle, sign, distance) - sign for distance in DISTANCES]
        values = np.stack(courses, axis=1) * size[:, None]
        columns = Entries(values, rows, np.arange(len(DISTANCES)), (3 * n, len(DISTANCES)))
        found.append(data.in_band(part, columns))
    return data.weighted(found, in_place=True)


def _dry(effect: ActingEffect, signals: Signals, joint: str, side: str) -> Array:
    """Return the magnitude (N,) Nm of what has the sign of the velocity in the friction that an
    effect makes at a side of a joint."""
    feature = effect.feature
    if not feature.effect.friction or feature.joint != joint or side not in feature.sides:
        return np.zeros(len(signals.t))
    moving = _one_way(effect, signals, side, 1.0)
    resting = _one_way(effect, signals, side, 0.0)
    j = feature.equations.robot.joint_names.index(joint)
    return np.asarray((moving - resting)[:, j])


def _one_way(effect: ActingEffect, signals: Signals, side: str, sign: float) -> Array:
    """Return the friction (N, n) Nm at the magnitudes of the velocities, with one sign."""
    signs = np.full_like(signals.values["sign_motor"], sign)
    forward = {"dx": np.abs(signals.values["dx"]), "sign_link": signs, "sign_motor": signs}
    of_joint, of_motor, *_ = effect.torques(replace(signals, values={**signals.values, **forward}))
    return of_joint if side == "link" else of_motor - of_joint
