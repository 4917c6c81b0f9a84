"""`~/follow_joint_trajectory`: the action by which MoveIt and other clients of
joint_trajectory_controller move an arm.

Tolerances, their defaults and outcomes are those of joint_trajectory_controller.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectoryPoint

from elastic_arm.arrays import Array
from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.follower import Follower
from elastic_arm.nodes.following.goals import Goal
from elastic_arm.nodes.following.splines import Row
from elastic_arm.nodes.support.wire import NANOSECONDS, nanoseconds, span_of, stamp_of

Result = FollowJointTrajectory.Result
NAME = "~/follow_joint_trajectory"
# Between two messages of feedback, in the arm's time.
FEEDBACK_NS = NANOSECONDS // 20
# At the end of a goal, rad/s, where its request states none: joint_trajectory_controller's default.
STOPPED = 0.01


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Largest permitted errors of position and velocity, (n,) each, rad and rad/s.

    Infinite without a limit.
    """

    position: Array
    velocity: Array

    @classmethod
    def of(
        cls, stated: Sequence[JointTolerance], joints: Sequence[str], velocity: float = 0.0
    ) -> Self:
        """Return the tolerances of a request: 0 means the default, a negative value no limit.

        joints: of the arm, (n,).

        Raises a GraphError if a tolerance names another joint.
        """
        values = {"position": np.zeros(len(joints)), "velocity": np.full(len(joints), velocity)}
        for tolerance in stated:
            if tolerance.name not in joints:
                raise GraphError(
                    f"has a tolerance for {tolerance.name!r}",
                    f"The joints are {', '.join(joints)}.",
                )
            for name, column in values.items():
                if getattr(tolerance, name) != 0.0:
                    column[list(joints).index(tolerance.name)] = getattr(tolerance, name)
        return cls(
            **{name: np.where(column > 0.0, column, np.inf) for name, column in values.items()}
        )

    def exceeded(self, joints: Sequence[str], position: Array, velocity: Array) -> str:
        """Return in words which error (n,) exceeds its tolerance first; empty if none does."""
        for name, errors, limits, unit in (
            ("position", position, self.position, "rad"),
            ("velocity", velocity, self.velocity, "rad/s"),
        ):
            for joint, error, limit in zip(joints, np.abs(errors), limits, strict=True):
                if error > limit:
                    return (
                        f"the {name} of {joint} deviates by {error:.3g} {unit}, more than the"
                        f" tolerance of {limit:.3g} {unit}"
                    )
        return ""


@dataclass(eq=False)
class _Active:
    """A goal that is being followed."""

    handle: ServerGoalHandle
    goal: Goal
    path: Tolerances
    end: Tolerances
    patience_ns: int
    outcome: Future
    told_ns: int = 0


class TrajectoryAction:
    """Serves the action; :meth:`observe` is called once a step."""

    def __init__(self, node: Node, follower: Callable[[], Follower]) -> None:
        self._follower = follower
        self._active: _Active | None = None
        self._log = node.get_logger()
        self._server = ActionServer(
            node,
            FollowJointTrajectory,
            NAME,
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def destroy(self) -> None:
        """Remove the action from the graph."""
        self._server.destroy()

    def observe(self, now_ns: int, reference: Row, position: Array, velocity: Array) -> None:
        """Compare the arm with its reference; give feedback, or end the goal.

        A goal ends when it is reached, missed or cancelled.

        reference: of this step, (n,) each; position, velocity: (n,) as measured.
        """
        active = self._active
        if active is None:
            return
        if self._follower().goal is not active.goal:
            self._end(Result.INVALID_GOAL, "replaced by another motion")
        elif active.handle.is_cancel_requested:
            self._follower().stop()
            self._end(
                Result.SUCCESSFUL,
                "cancelled: the arm slows down and stops",
                active.handle.canceled,
            )
        elif now_ns < active.goal.end_ns:
            self._watch(active, reference, position, velocity)
        else:
            self._arrive(active, now_ns, reference, position, velocity)
        if self._active is active and now_ns - active.told_ns >= FEEDBACK_NS:
            active.told_ns = now_ns
            self._tell(active, now_ns, reference, Row(position, velocity, np.zeros(0)))

    def _watch(self, active: _Active, reference: Row, position: Array, velocity: Array) -> None:
        joints = self._follower().joints
        if wrong := active.path.exceeded(
            joints, position - reference.position, velocity - reference.velocity
        ):
            self._follower().stop()
            self._end(Result.PATH_TOLERANCE_VIOLATED, f"along the path, {wrong}")

    def _arrive(
        self, active: _Active, now_ns: int, reference: Row, position: Array, velocity: Array
    ) -> None:
        wrong = active.end.exceeded(
            self._follower().joints, position - reference.position, velocity
        )
        if not wrong:
            words = (
                f"slowed down by a factor of {active.goal.slower:.3g}: the requested motion"
                f" {active.goal.reason}"
            )
            self._end(
                Result.SUCCESSFUL, words if active.goal.reason else "reached", active.handle.succeed
            )
        elif active.patience_ns and now_ns > active.goal.end_ns + active.patience_ns:
            late = (now_ns - active.goal.end_ns) / NANOSECONDS
            self._end(Result.GOAL_TOLERANCE_VIOLATED, f"{late:.3g} s after the end, {wrong}")

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        """Begin a goal, and wait for its outcome."""
        try:
            active = self._begin(handle)
        except GraphError as error:
            handle.abort()
            self._log.error(f"refused a goal that {error}")
            return Result(error_code=_code(error), error_string=str(error))
        if self._active is not None:
            self._end(Result.INVALID_GOAL, "replaced by another goal")
        self._active = active
        return await active.outcome

    def _begin(self, handle: ServerGoalHandle) -> _Active:
        request = handle.request
        follower = self._follower()
        if request.multi_dof_trajectory.points:
            raise GraphError(
                "contains motions of joints with several degrees of freedom",
                "This arm has no such joints.",
            )
        path = Tolerances.of(request.path_tolerance, follower.joints)
        end = Tolerances.of(request.goal_tolerance, follower.joints, STOPPED)
        patience = nanoseconds(request.goal_time_tolerance)
        return _Active(handle, follower.go_to(request.trajectory), path, end, patience, Future())

    def _end(self, code: int, words: str, state: Callable[[], None] | None = None) -> None:
        """Report the outcome of the current goal: aborted, unless `state` sets another one."""
        assert self._active is not None
        active = self._active
        self._active = None
        (state or active.handle.abort)()
        if state is None:
            self._log.warning(f"a goal was aborted: {words}")
        active.outcome.set_result(Result(error_code=code, error_string=words))

    def _tell(self, active: _Active, now_ns: int, desired: Row, actual: Row) -> None:
        feedback = FollowJointTrajectory.Feedback(joint_names=list(self._follower().joints))
        feedback.header.stamp = stamp_of(now_ns)
        elapsed = now_ns - active.goal.begin_ns
        error = Row(
            desired.position - actual.position, desired.velocity - actual.velocity, np.zeros(0)
        )
        feedback.desired = _point(desired, elapsed)
        feedback.actual = _point(actual, elapsed)
        feedback.error = _point(error, elapsed)
        active.handle.publish_feedback(feedback)


def _point(row: Row, elapsed_ns: int) -> JointTrajectoryPoint:
    names = ("positions", "velocities", "accelerations")
    values = {name: column.tolist() for name, column in zip(names, row, strict=True)}
    return JointTrajectoryPoint(**values, time_from_start=span_of(elapsed_ns))


def _code(error: GraphError) -> int:
    if error.problem.startswith("names "):
        return int(Result.INVALID_JOINTS)
    return int(
        Result.OLD_HEADER_TIMESTAMP
        if error.problem.startswith("is in the past")
        else Result.INVALID_GOAL
    )
