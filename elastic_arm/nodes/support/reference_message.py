"""The messages of the reference: checked before an arm follows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from elastic_arm.errors import GraphError
from elastic_arm.nodes.support.reference import Row
from elastic_arm.nodes.support.wire import NANOSECONDS

_FIELDS = ("positions", "velocities", "accelerations")


def reference_points(message: JointTrajectory, joints: Sequence[str]) -> tuple[NDArray[np.int64], Row]:
    """Return the points of a message in the order of the arm's joints; further joints are left out.

    Parameters
    ----------
    message
        Points with positions, and velocities and accelerations where they are given, zero elsewhere.
    joints
        Names of the arm's joints, (n,).

    Returns
    -------
    after_ns : (N,)
        Time of each point after the message's stamp, increasing.
    points
        Position, velocity and acceleration, (N, n) each.

    Raises
    ------
    GraphError
        If a joint of the arm is missing or a name is repeated, there are no points, a point lacks its positions or has
        another number of values than there are names, a value is not finite, or times do not increase.
    """
    names = list(message.joint_names)
    if len(set(names)) != len(names) or not set(joints) <= set(names):
        raise GraphError(f"names {', '.join(names) or 'no joint'}", f"Name each of {', '.join(joints)} once.")
    if not message.points:
        raise GraphError("holds no points", "Send one point or more.")
    order = [names.index(joint) for joint in joints]
    after = [point.time_from_start.sec * NANOSECONDS + point.time_from_start.nanosec for point in message.points]
    if np.any(np.diff(after) <= 0):
        raise GraphError("has points whose times do not increase", "Sort them by time_from_start.")
    columns = [_column(message, field, len(names))[:, order] for field in _FIELDS]
    if not np.all(np.isfinite(columns)):
        raise GraphError("has a value that is not finite", "Send finite numbers.")
    return np.array(after, dtype=np.int64), Row(*columns)


def _column(message: JointTrajectory, field: str, n: int) -> NDArray[np.float64]:
    """One field of all points for the n joints that the message names, (N, n); zeros where a point does not give it."""
    rows = []
    for k, point in enumerate(message.points):
        values = getattr(point, field)
        if len(values) == 0 and field != "positions":
            values = np.zeros(n)
        if len(values) != n:
            raise GraphError(f"has {len(values)} {field} for {n} joints in point {k}", "Give one value a joint.")
        rows.append(values)
    return np.array(rows, dtype=float)
