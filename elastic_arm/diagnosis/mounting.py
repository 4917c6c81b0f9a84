"""Which way gravity pulls on the arm as the torques show it, where the description has another way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.texts.notes import mounting_note
from elastic_arm.dynamics import build_model
from elastic_arm.estimation.motion import CompletedMotion
from elastic_arm.robot import Robot

Array = NDArray[np.float64]

ENOUGH = 2000  # samples of a motion that are looked at; bounds the time
TURNED = 0.35  # rad from the described direction: beyond the tilts that a search finds; convention
LEFT = 0.3  # of the squares that the described direction leaves; convention
SIZE = (0.6, 1.5)  # of the described gravity: masses are off as well; convention


def mounting_notes(robot: Robot, name: str, motions: Sequence[CompletedMotion], channel: str) -> list[str]:
    """Return a note where another direction of gravity explains the torques far better than the described one.

    Torques are linear in gravity, whatever its direction: three columns, beside dry friction of each joint. The joints
    that carry most decide. An arm on a wall is further from its description than the columns of a small tilt reach.

    Parameters
    ----------
    robot
        The description.
    name
        Variant of the model.
    motions
        Of the recordings.
    channel
        The torque that was recorded nearest to the links: "tau_J" or "tau_m".
    """
    described = np.asarray(robot.gravity, dtype=float)
    size, turning = float(np.linalg.norm(described)), [not joint.prismatic for joint in robot.joints]
    if not (size and motions and any(turning)):
        return []
    measured, pull, friction = (each[:, turning] for each in _torques(robot, name, max(motions, key=len), channel))
    coefficients, left = _least_squares(np.concatenate([pull, friction], axis=2), measured)
    _, before = _least_squares(friction, measured - pull @ described)
    found = coefficients[:3]
    length = float(np.linalg.norm(found))
    turned = np.arccos(np.clip(found @ described / max(length * size, 1e-12), -1.0, 1.0))
    likely = turned > TURNED and SIZE[0] * size <= length <= SIZE[1] * size and left < LEFT * before
    return [mounting_note(found.tolist(), described.tolist())] if likely else []


def _torques(robot: Robot, name: str, motion: CompletedMotion, channel: str) -> tuple[Array, Array, Array]:
    """Return torques (N, n) less those of the motion, what gravity pulls (N, n, 3), and directions of dry friction."""
    every, n = slice(0, None, max(1, len(motion) // ENOUGH)), robot.n
    x, dx, ddx = (motion.coordinates(rate, elastic=robot.elastic)[every] for rate in ("", "d", "dd"))

    def torque(gravity: Array) -> Array:
        rows = build_model(robot.with_(gravity=gravity), name).inverse_dynamics(x, dx, ddx)
        return np.asarray(rows[:, :n] + rows[:, n:] if robot.elastic and channel == "tau_m" else rows[:, :n])

    moved = torque(np.zeros(3))
    pull = np.stack([torque(axis) - moved for axis in np.eye(3)], axis=2)
    return getattr(motion, channel)[every] - moved, pull, np.sign(dx[:, -n:])[:, :, None] * np.eye(n)


def _least_squares(columns: Array, target: Array) -> tuple[Array, float]:
    """Return the coefficients (m,) of columns (N, n, m), and the sum of squares that they leave."""
    flat, wanted = columns.reshape(-1, columns.shape[2]), target.ravel()
    found = np.asarray(np.linalg.lstsq(flat, wanted, rcond=None)[0], dtype=np.float64)
    return found, float(np.sum((wanted - flat @ found) ** 2))
