"""Goals: trajectories of few points, gone to from where the arm is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.joint_limits import JointLimits
from elastic_arm.nodes.following.reference_message import Points, reference_points
from elastic_arm.nodes.following.splines import CUBIC, QUINTIC, Row, interpolate
from elastic_arm.nodes.support.wire import NANOSECONDS

POLICIES = ("refuse", "slow_down", "ignore")
# A goal is looked at so often between two points: the peaks of a quintic are met within a percent.
SAMPLES = 16
# A goal that is due later, seconds, is a mistake in the units or of a clock; times a thousand it
# fits 64 bits of ns.
LATEST = 1e6
# Slower by more is no plan but a mistake in the units; and how often a slower plan is tried.
SLOWEST = 1000.0
TRIES = 8
# The last point's velocity is zero within this, rad/s.
AT_REST = 1e-3
# An arm that is stopped takes at least so long, seconds.
STOPPING = 0.2


@dataclass(frozen=True, eq=False)
class Goal:
    """A motion from the present state through points."""

    stamps: NDArray[np.int64]  # (K,) ns: of the state that it begins with, and of its points
    points: Row  # (K, n) each
    degree: NDArray[np.int64]  # (K,) of the polynomials that the points allow
    slower: float = 1.0  # how many times slower it is than it was asked for
    reason: str = ""  # why, in words

    @property
    def end_ns(self) -> int:
        """Stamp of the last point."""
        return int(self.stamps[-1])

    def at(self, stamps: NDArray[np.int64]) -> Row:
        """Return the motion at `stamps` (N,) ns; the last position at rest after the end."""
        rows = interpolate(self.stamps, self.points, self.degree, np.minimum(stamps, self.end_ns))
        over = (stamps >= self.end_ns)[:, None]
        return Row(
            rows.position,
            np.where(over, 0.0, rows.velocity),
            np.where(over, 0.0, rows.acceleration),
        )


def plan_goal(
    message: JointTrajectory,
    joints: Sequence[str],
    now_ns: int,
    present: Row,
    limits: JointLimits,
    policy: str,
) -> Goal:
    """Return the motion to a goal as joint_trajectory_controller plans it.

    From the present state through the points.

    Points at or before the present are left out. Joints that are not named stay where they are.
    Along a straight line the velocity is limited, but not its steps at the ends.

    message: the goal; its stamp is the time from which its points count, zero for now; joints: of
    the arm, (n,); now_ns, present: time and reference from which it begins, (n,) each; policy: one
    of POLICIES: what to do with a motion that breaks a limit.

    Raises a GraphError if the message is malformed, ends in motion, lies in the past or in weeks,
    or breaks a limit (where the policy is to slow down: one that slowing down does not mend).
    """
    after_ns, points = reference_points(message, joints, present.position)
    begin = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec or now_ns
    coming = begin + after_ns > now_ns
    if not coming[-1]:
        late = (now_ns - begin - after_ns[-1]) * 1e-9
        raise GraphError(
            f"is in the past: its last point was due {late:.3g} s ago",
            "Give time_from_start, and a stamp of the arm's clock, or zero for now.",
        )
    if (ahead := (begin + after_ns[-1] - now_ns) * 1e-9) > LATEST:
        raise GraphError(
            f"is due {ahead:.3g} s from now",
            "Give time_from_start, and a stamp of the arm's clock, or zero for now.",
        )
    if np.max(np.abs(points.velocity[-1])) > AT_REST:
        raise GraphError(
            "ends with a nonzero velocity", "Give the last point zero velocities, or omit them."
        )
    goal = _from_present(begin + after_ns[coming], points.where(coming), now_ns, present)
    return goal if policy == "ignore" else _within(goal, limits, policy)


def plan_stop(now_ns: int, present: Row, limits: JointLimits) -> Goal:
    """Return the way to a standstill at an even deceleration within the limits.

    present: (n,) position, velocity and acceleration at that time.
    """
    speed = np.abs(present.velocity)
    seconds = max(STOPPING, float(np.max(speed / limits.acceleration)))
    end = present.position + 0.5 * seconds * present.velocity
    zeros = np.zeros((1, len(end)))
    points = Points(end[None], zeros, zeros, np.array([CUBIC]))
    return _from_present(np.array([now_ns + round(seconds * NANOSECONDS)]), points, now_ns, present)


def _from_present(stamps: NDArray[np.int64], points: Points, now_ns: int, present: Row) -> Goal:
    rows = Row(
        *(np.vstack((before, values)) for before, values in zip(present, points.row, strict=True))
    )
    return Goal(
        np.concatenate(([now_ns], stamps)), rows, np.concatenate(([QUINTIC], points.degree))
    )


def _within(goal: Goal, limits: JointLimits, policy: str) -> Goal:
    """Return the goal if it keeps the limits, or a slower one that does."""
    tried = goal
    reason = ""
    slower = 1.0
    for _ in range(TRIES):
        broken = limits.violation(_samples(tried), goal.points.position[0])
        if broken is None:
            return tried
        reason = reason or broken.problem
        slower *= max(broken.slower, 1.01)
        if policy == "refuse" or slower > SLOWEST:
            break
        tried = _slowed(goal, slower, reason)
    whose = " (default: the arm file gives none for some joints)" if limits.assumed else ""
    vain = ", at any speed" if policy == "slow_down" else ""
    raise GraphError(
        f"{reason}{whose}{vain}", "Plan within the limits, or set the parameter limits."
    )


def _slowed(goal: Goal, slower: float, reason: str) -> Goal:
    """Return the goal with all times stretched; the state it begins with stays what it is."""
    start = goal.stamps[0]
    stamps = start + np.rint((goal.stamps - start) * slower).astype(np.int64)
    position, velocity, acceleration = (values.copy() for values in goal.points)
    velocity[1:] /= slower
    acceleration[1:] /= slower**2
    return Goal(stamps, Row(position, velocity, acceleration), goal.degree, slower, reason)


def _samples(goal: Goal) -> Row:
    """Return the motion at times so close that no peak between them exceeds them much."""
    share = np.arange(1, SAMPLES + 1) / SAMPLES
    stamps = goal.stamps[:-1, None] + (np.diff(goal.stamps)[:, None] * share).astype(np.int64)
    return goal.at(np.concatenate((goal.stamps[:1], stamps.ravel())))
