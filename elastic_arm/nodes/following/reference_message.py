"""Messages of the reference, which are checked before an arm follows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.splines import CUBIC, LINEAR, QUINTIC, Points, Row
from elastic_arm.nodes.support.wire import NANOSECONDS, nanoseconds, span_of

# A message of more points would hold up the arm while it is looked at.
MOST_POINTS = 20_000
# Larger numbers, rad, rad/s or rad/s², are of no arm, and their powers are not finite.
LARGEST = 1e9
_FIELDS = ("positions", "velocities", "accelerations")


def reference_points(
    message: JointTrajectory, joints: Sequence[str], held: NDArray[np.float64] | None = None
) -> Points:
    """Return the points of a message in the order of the arm's joints.

    message: points with positions, and velocities and accelerations where they are given, zero
    elsewhere; joints: names of the arm's joints, (n,); held: (n,) where joints that the message
    does not name stay; names of other joints are a mistake then. None where it has to name all
    joints; further ones are left out.

    Stamps of the points count from the message's stamp. Raises a GraphError where names, times, or
    the number or size of values are not those of a motion of this arm.
    """
    names = list(message.joint_names)
    _check_names(names, joints, partial=held is not None)
    if not message.points:
        raise GraphError("contains no points", "Send at least one point.")
    if len(message.points) > MOST_POINTS:
        raise GraphError(
            f"contains {len(message.points)} points", f"Send at most {MOST_POINTS}, or stream them."
        )
    after = np.array([nanoseconds(point.time_from_start) for point in message.points])
    if np.any(np.diff(after) <= 0):
        raise GraphError("has points whose times do not increase", "Sort them by time_from_start.")
    columns = [_column(message, field, len(names)) for field in _FIELDS]
    if not np.all(np.isfinite(columns)):
        raise GraphError("has a value that is not finite", "Send finite numbers.")
    if (largest := max(float(np.max(np.abs(column))) for column in columns)) > LARGEST:
        raise GraphError(
            f"has a value of {largest:.3g}", "Send angles in rad, velocities in rad/s."
        )
    named = [k for k, joint in enumerate(joints) if joint in names]
    order = [names.index(joints[k]) for k in named]
    position, velocity, acceleration = np.zeros((3, len(after), len(joints)))
    if held is not None:
        position[:] = held
    for values, column in zip((position, velocity, acceleration), columns, strict=True):
        values[:, named] = column[:, order]
    degree = np.array([_degree(point) for point in message.points])
    return Points(after, Row(position, velocity, acceleration), degree)


def _degree(point: JointTrajectoryPoint) -> int:
    """Return the degree of the polynomial that ends at a point."""
    if not point.velocities:
        return LINEAR
    return QUINTIC if point.accelerations else CUBIC


def commanded(command: JointState, period: float) -> JointTrajectory | None:
    """Return a controller's command as the goal to reach after `period` s.

    None without numbers. If a velocity is also commanded, the goal lies further ahead by it, so
    that the arm follows without a lag.
    """
    position = np.array(command.position)
    velocity = np.array(command.velocity)
    if not len(position) or np.all(np.isnan(position)):
        return None  # interfaces that no controller has claimed yet
    if len(velocity) == len(position) and np.all(np.isfinite(velocity)):
        position = position + period * velocity
    after = span_of(round(period * NANOSECONDS))
    point = JointTrajectoryPoint(positions=position.tolist(), time_from_start=after)
    return JointTrajectory(joint_names=command.name, points=[point])


def _check_names(names: list[str], joints: Sequence[str], partial: bool) -> None:
    said = f"names {', '.join(names) or 'no joint'}"
    if len(set(names)) != len(names):
        raise GraphError(said, f"Name each of {', '.join(joints)} once.")
    if partial:
        if not names or not set(names) <= set(joints):
            raise GraphError(said, f"Name at least one of {', '.join(joints)}.")
    elif not set(joints) <= set(names):
        raise GraphError(said, f"Name each of {', '.join(joints)} once.")


def _column(message: JointTrajectory, field: str, n: int) -> NDArray[np.float64]:
    """Return one field of all points for the n joints that the message names, (N, n); zeros if a
    point does not state it."""
    rows = []
    for k, point in enumerate(message.points):
        values = getattr(point, field)
        if len(values) == 0 and field != "positions":
            values = np.zeros(n)
        if len(values) != n:
            raise GraphError(
                f"has {len(values)} {field} for {n} joints in point {k}",
                "Give one value per joint.",
            )
        rows.append(values)
    return np.array(rows, dtype=float)
