"""Follow the streamed reference or a goal, whichever arrived last."""

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from elastic_arm.arrays import Array
from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.goals import Goal, plan_goal, plan_stop
from elastic_arm.nodes.following.joint_limits import JointLimits
from elastic_arm.nodes.following.reference import ReferenceQueue
from elastic_arm.nodes.following.reference_message import reference_points
from elastic_arm.nodes.following.splines import CUBIC, QUINTIC, Points, Row
from elastic_arm.nodes.support.wire import NANOSECONDS, nanoseconds
from elastic_arm.robot import Robot

# A stream that begins farther from where the arm stands, rad, would be a jump.
LARGEST_JUMP = 0.1
# Those of a stream are made when it arrives: it ends at most so far ahead, seconds, and no message
# takes longer. The trajectory generator sends 100 s at a time at most, and 10 s ahead.
LONGEST_STREAM = 150
# Rows of a goal are made so many steps ahead, in parts: no goal is so long that the arm has to wait
# for it.
AHEAD = 1000
PART = 500


class Follower:
    """Takes messages of points, and gives the reference of every step.

    A message whose stamp is set and whose first point is at that stamp is part of a stream, as the
    trajectory generator sends it: its points are followed as they are, and the limits that the arm
    states are checked (or those of any arm). Any other message is a goal
    (:func:`elastic_arm.nodes.following.goals.plan_goal`); where the arm states no limit, that of
    the excitation's search counts.

    start: (n,) rad where it stands; policy: what to do with a goal that breaks limits: refuse,
    slow_down or ignore (streams too). `stream` is the queue of streamed points, `goal` the goal
    followed now or last; None after a stream.
    """

    def __init__(
        self, robot: Robot, start: Array, origin_ns: int, step_ns: int, policy: str = "refuse"
    ) -> None:
        self.joints = robot.joint_names
        self.stream = ReferenceQueue(start, origin_ns, step_ns)
        self.goal: Goal | None = None
        self._origin = origin_ns
        self._step_ns = step_ns
        self._policy = policy
        self._stated = JointLimits.of(robot, False)
        self._assumed = JointLimits.of(robot, True)
        self._step = 0
        self._made = 0

    @property
    def now_ns(self) -> int:
        """Stamp of the last step."""
        return self._origin + self._step * self._step_ns

    def at(self, step: int) -> Row:
        """Return the reference of a step; steps have to be requested in order."""
        self._step = step
        self._feed(step + AHEAD)
        return self.stream.at(step)

    def take(self, message: JointTrajectory) -> Goal | None:
        """Accept a message; return its goal, or None for a part of a stream.

        Raises a GraphError if it cannot be followed; the arm then continues as before.
        """
        stamp = nanoseconds(message.header.stamp)
        if stamp and message.points and not nanoseconds(message.points[0].time_from_start):
            self._take_stream(reference_points(message, self.joints).moved(stamp))
            return None
        return self.go_to(message)

    def go_to(self, message: JointTrajectory, policy: str | None = None) -> Goal:
        """Accept a message as a goal, whatever its stamp, with its own policy for limits.

        Raises a GraphError if it cannot be followed; the arm then continues as before.
        """
        present = self.stream.present
        goal = plan_goal(
            message, self.joints, self.now_ns, present, self._assumed, policy or self._policy
        )
        self._begin(goal)
        return goal

    def obey(self, command: JointTrajectory) -> None:
        """Accept a command of one cycle.

        If it cannot be reached in time, the arm moves as fast as the limits allow.
        """
        self.go_to(command, "ignore" if self._policy == "ignore" else "slow_down")

    def stop(self) -> Goal:
        """Bring the arm to a standstill, whatever it follows."""
        goal = plan_stop(self.now_ns, self.stream.present, self._assumed)
        self._begin(goal)
        return goal

    def _begin(self, goal: Goal) -> None:
        self.stream.clear()
        self.goal = goal
        self._made = self._step

    def _take_stream(self, points: Points) -> None:
        stamp = int(points.stamps[0])
        seconds = (int(points.stamps[-1]) - stamp) / NANOSECONDS
        ahead = (int(points.stamps[-1]) - self.now_ns) / NANOSECONDS
        if max(ahead, seconds) > LONGEST_STREAM:
            raise GraphError(
                f"streams points over {seconds:.3g} s, the last of them due {ahead:.3g} s from now",
                f"Stream at most {LONGEST_STREAM} s at a time and ahead of the arm's clock.",
            )
        if self._policy != "ignore":
            self._check_stream(points)
        if self.goal is not None:
            self._feed((stamp - self._origin) // self._step_ns)
            self.goal = None
        self.stream.add(points)

    def _check_stream(self, points: Points) -> None:
        stamp = int(points.stamps[0])
        bridge = None if self.goal is not None else self.stream.bridge(stamp)
        if bridge is None:
            before = self._planned(stamp)
            jump = np.abs(points.row.position[0] - before)
            joint = int(np.argmax(jump))
            if jump[joint] > LARGEST_JUMP:
                raise GraphError(
                    f"starts {jump[joint]:.3g} rad from the position of {self.joints[joint]} at"
                    " that time",
                    "Start at the arm's position, or give time_from_start to move there.",
                )
        else:  # what leads there from the last point counts as well
            points = bridge.followed_by(points)
        known = points.degree[:, None]
        between = _slopes(points)
        stated = np.where(known >= CUBIC, points.row.velocity, 0.0)
        motion = Row(
            points.row.position,
            # Points that state low velocities may lie far apart all the same.
            np.where(np.abs(stated) > np.abs(between), stated, between),
            np.where(known >= QUINTIC, points.row.acceleration, 0.0),
        )
        if (broken := self._stated.violation(motion, self.stream.present.position)) is not None:
            raise GraphError(
                broken.problem,
                "Stream within the limits of the arm file, or set the parameter limits.",
            )

    def _planned(self, stamp: int) -> Array:
        """The planned position, as far as it is known, (n,)."""
        if self.goal is not None:
            return self.goal.at(np.array([stamp])).position[0]
        return self.stream.last_position(stamp)

    def _feed(self, until: int) -> None:
        """Pass the rows of the goal on, up to a step."""
        if self.goal is None:
            return
        end = -(-(self.goal.end_ns - self._origin) // self._step_ns)
        while self._made < min(until, end):
            steps = np.arange(self._made + 1, min(self._made + PART, end) + 1)
            self.stream.extend(int(steps[0]), self.goal.at(self._origin + steps * self._step_ns))
            self._made = int(steps[-1])


def _slopes(points: Points) -> Array:
    """Return the velocity from each point to the next, zero for the last, (N, n)."""
    slopes = np.zeros_like(points.row.position)
    seconds = np.diff(points.stamps)[:, None] * 1e-9
    slopes[:-1] = np.diff(points.row.position, axis=0) / seconds
    return slopes
