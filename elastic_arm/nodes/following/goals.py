"""Goals: trajectories of a few points that start at the present state of the arm."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory

from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.joint_limits import JointLimits
from elastic_arm.nodes.following.reference_message import reference_points
from elastic_arm.nodes.following.splines import CUBIC, QUINTIC, Points, Row, resting
from elastic_arm.nodes.support.wire import NANOSECONDS, nanoseconds

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

    path: Points  # the state that it begins with, and its points
    slower: float = 1.0  # how many times slower it is than it was asked for
    reason: str = ""  # why, in words

    @property
    def begin_ns(self) -> int:
        """Stamp of the initial state."""
        return int(self.path.stamps[0])

    @property
    def end_ns(self) -> int:
        """Stamp of the last point."""
        return int(self.path.stamps[-1])

    def at(self, stamps: NDArray[np.int64]) -> Row:
        """Return the motion at `stamps` (N,) ns; the last position at rest after the end."""
        rows = self.path.at(np.minimum(stamps, self.end_ns))
        moving = (stamps < self.end_ns)[:, None]
        return Row(rows.position, rows.velocity * moving, rows.acceleration * moving)


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
    begin = nanoseconds(message.header.stamp) or now_ns
    points = reference_points(message, joints, present.position).moved(begin)
    ahead = float(points.stamps[-1] - now_ns) * 1e-9
    if ahead <= 0.0:
        raise GraphError(
            f"is in the past: its last point was due {-ahead:.3g} s ago",
            "Give time_from_start, and a stamp of the arm's clock, or zero for now.",
        )
    if ahead > LATEST:
        raise GraphError(
            f"is due {ahead:.3g} s from now",
            "Give time_from_start, and a stamp of the arm's clock, or zero for now.",
        )
    if np.max(np.abs(points.row.velocity[-1])) > AT_REST:
        raise GraphError(
            "ends with a nonzero velocity", "Give the last point zero velocities, or omit them."
        )
    coming = points.where(points.stamps > now_ns)
    goal = Goal(_standing(now_ns, present).followed_by(coming))
    return goal if policy == "ignore" else _within(goal, limits, policy)


def plan_stop(now_ns: int, present: Row, limits: JointLimits) -> Goal:
    """Return the motion to a standstill with a constant deceleration within the limits.

    present: (n,) position, velocity and acceleration at that time.
    """
    speed = np.abs(present.velocity)
    seconds = max(STOPPING, float(np.max(speed / limits.acceleration)))
    end = present.position + 0.5 * seconds * present.velocity
    stopped = _standing(now_ns + round(seconds * NANOSECONDS), resting(Row(end, end, end)), CUBIC)
    return Goal(_standing(now_ns, present).followed_by(stopped))


def _standing(stamp_ns: int, state: Row, degree: int = QUINTIC) -> Points:
    """Return a state (n,) as a point."""
    row = Row(*(values[None] for values in state))
    return Points(np.array([stamp_ns]), row, np.array([degree]))


def _within(goal: Goal, limits: JointLimits, policy: str) -> Goal:
    """Return the goal if it observes the limits, or a slower one that does."""
    tried = goal
    reason = ""
    slower = 1.0
    for _ in range(TRIES):
        broken = limits.violation(_samples(tried), goal.path.row.position[0])
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
    """Return the goal with all times stretched; the initial state is unchanged."""
    after = goal.path.stamps - goal.begin_ns
    stamps = goal.begin_ns + np.rint(after * slower).astype(np.int64)
    position, velocity, acceleration = (values.copy() for values in goal.path.row)
    velocity[1:] /= slower
    acceleration[1:] /= slower**2
    path = Points(stamps, Row(position, velocity, acceleration), goal.path.degree)
    return Goal(path, slower, reason)


def _samples(goal: Goal) -> Row:
    """Return the motion at times so close that no peak between them exceeds the samples
    noticeably."""
    stamps = goal.path.stamps
    share = np.arange(1, SAMPLES + 1) / SAMPLES
    between = stamps[:-1, None] + (np.diff(stamps)[:, None] * share).astype(np.int64)
    return goal.at(np.concatenate((stamps[:1], between.ravel())))
