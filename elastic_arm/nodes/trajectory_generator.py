"""`ros2 run elastic_arm trajectory_generator`: stream an excitation on `/reference`."""

import sys
import time
from array import array
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.arrays import Array
from elastic_arm.errors import GraphError
from elastic_arm.excitation import FourierTrajectory, load_trajectory
from elastic_arm.nodes.following.splines import QUINTIC, Points, Row
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode, Health, Listener
from elastic_arm.nodes.support.parameters import Setting, declared
from elastic_arm.nodes.support.running import run
from elastic_arm.nodes.support.wire import NANOSECONDS, Form, nanoseconds, span_of
from elastic_arm.recording import topics

# The first points go out so long before their time: what arrives late is followed late.
HEAD_START_NS = NANOSECONDS
# Clocks further apart than this, seconds, are two clocks; an arm may be late with its samples, but
# not that late.
LARGEST_OFFSET = 15.0
# With two clocks there is nothing to wait for but a mistake to mend, or /clock that has not been
# heard yet: seconds. States that say nothing of where the arm is are waited out as long: a driver
# may be starting.
PATIENCE = 10.0
# Joints stand at no larger angles, rad (or positions, m).
LARGEST_POSITION = 1e4
# The arm has this long, seconds, to find the generator that has found it; and this long where the
# arm's states and the reader of the reference are two nodes, one of which may be a recorder.
SETTLING = 0.3
READER_PATIENCE = 3.0
POINTS = 20  # in a message
LEAD_NS = NANOSECONDS  # how far ahead of the clock they are streamed
PARAMETERS = {
    "trajectory": Setting("", "Trajectory file (YAML, from `elastic-arm excite`)"),
    "repeat": Setting(1, "Number of repetitions; 0: until stopped", between=(0, 1_000_000)),
    "rate": Setting(1000.0, "Points per second", between=(10.0, 10_000.0)),
    "approach_speed": Setting(
        1.0, "Joint velocity on the way to the start, rad/s", between=(0.01, 3.0)
    ),
}


# Peak speed and acceleration of a quintic from rest to rest: distance / duration and distance /
# duration² times these.
QUINTIC_SPEED = 15.0 / 8.0
QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
# Highest acceleration on the way to the start, rad/s².
GENTLE = 0.5


class Plan:
    """The approach to the start of a trajectory, and the trajectory, one or more times.

    position: (n,) present position of the arm.
    """

    def __init__(
        self, trajectory: FourierTrajectory, position: Array, repeat: int = 1, speed: float = 0.3
    ) -> None:
        self._trajectory = trajectory
        self._repeat = repeat
        first = np.array([values[0] for values in trajectory.evaluate(np.zeros(1))])
        distance = float(np.max(np.abs(first[0] - position)))
        self.approach = max(
            QUINTIC_SPEED * distance / speed,
            float(np.sqrt(QUINTIC_ACCELERATION * distance / GENTLE)),
        )
        start = Row(position, np.zeros_like(position), np.zeros_like(position))
        self._way = Points(
            np.array([0, round(self.approach * NANOSECONDS)]),
            Row(*map(np.vstack, zip(start, first, strict=True))),
            np.array([QUINTIC, QUINTIC]),
        )

    @property
    def duration(self) -> float:
        """Seconds from the first to the last point; infinite when repeated for ever."""
        return self.approach + (
            self._repeat * self._trajectory.duration if self._repeat else np.inf
        )

    def evaluate(self, t: Array) -> Row:
        """Return the points at times t (N,), seconds from the beginning of the approach."""
        rest = t - self.approach
        cycle = np.floor(rest / self._trajectory.duration)
        if self._repeat:
            cycle = np.minimum(cycle, self._repeat - 1)
        inside = np.clip(rest - cycle * self._trajectory.duration, 0.0, self._trajectory.duration)
        points = [np.array(values) for values in self._trajectory.evaluate(inside)]
        before = rest < 0.0
        if before.any():
            way = self._way.at(t[before] * NANOSECONDS)
            for values, approaching in zip(points, way, strict=True):
                values[before] = approaching
        return Row(*points)


class TrajectoryGenerator(ArmNode):
    """Waits for the arm, moves it to the start, and streams the trajectory.

    The stream is slightly ahead of time.
    """

    def __init__(self) -> None:
        super().__init__("trajectory_generator")
        wanted = declared(self, PARAMETERS)
        if not wanted.trajectory:
            raise GraphError(
                "parameter trajectory is empty",
                "Create one by `elastic-arm excite --out FILE`, and give it: -p trajectory:=FILE.",
            )
        self._trajectory = load_trajectory(Path(wanted.trajectory))
        self._repeat = wanted.repeat
        self._speed = wanted.approach_speed
        self._step_ns = round(NANOSECONDS / wanted.rate)
        self._publisher = self.output(topics.REFERENCE, JointTrajectory)
        self._wait()
        Health(self, "stream", "streaming", self._status)

    def _wait(self) -> None:
        """Wait for an arm, to begin at its position."""
        self._plan: Plan | None = None
        self._prepared_ns = self._start_ns = self._sent = 0
        self._matched: float | None = None
        self._names: list[str] = []
        self._trouble: GraphError | None = None
        self._born = time.monotonic()
        self._position = np.zeros(0)
        self._form: Form | None = None
        self._states = Listener(self, JointState, graph.relative(topics.MOTOR_STATES), self._found)

    def tick(self) -> float:
        """Stream what is due."""
        if self._plan is None:
            self._prepare()
            return 0.01
        if not self._start_ns:
            self._start()
            return 0.01
        if not self._publisher.get_subscription_count() and not self.done():
            self.get_logger().warning(
                f"the arm has disappeared: {self._publisher.topic_name} has no subscriber;"
                " waiting for the arm"
            )
            self._wait()
            return LONGEST_REST
        now = self.get_clock().now().nanoseconds
        horizon = max(now, self._start_ns) + LEAD_NS
        while not self._all_sent() and self._time(self._sent) < horizon:
            self._send()
        ahead = self._time(self._sent) - horizon
        return LONGEST_REST if self._all_sent() else ahead / NANOSECONDS

    def done(self) -> bool:
        """Return whether the last point's time has passed."""
        return self._all_sent() and self.get_clock().now().nanoseconds > self._time(self._sent)

    def _found(self, message: JointState) -> None:
        """Store the position of the arm."""
        if not message.position or self._names:
            return
        self._trouble = self._wrong_clock(message) or self._no_position(message)
        if self._trouble is None:
            self._names = list(message.name)
            self._position = np.array(message.position)

    def _wrong_clock(self, message: JointState) -> GraphError | None:
        """Return the problem if arm and node do not use the same clock."""
        remedy = "A simulator that does not run in real time publishes /clock."
        now = self.get_clock().now().nanoseconds
        offset = (nanoseconds(message.header.stamp) - now) / NANOSECONDS
        # as a clock of the arm's own reads until it is heard; a start reckoned from there would be
        # over
        if not now:
            return GraphError(f"use_sim_time is set, but {topics.CLOCK} has no publisher", remedy)
        if abs(offset) > LARGEST_OFFSET:
            return GraphError(
                f"the arm's clock differs by {offset:+.0f} s: set use_sim_time for both,"
                " or for neither",
                remedy,
            )
        return None

    def _no_position(self, message: JointState) -> GraphError | None:
        """Return the problem if a message does not contain the position of each joint."""
        said = f"{graph.resolved(self, topics.MOTOR_STATES)} holds"
        joints = len(message.name)
        remedy = "Check it with `ros2 topic echo`: the motion starts at the position of the arm."
        if len(message.position) != joints:
            return GraphError(
                f"{said} {len(message.position)} positions for {joints} joints", remedy
            )
        if len(set(message.name)) != joints:
            return GraphError(f"{said} a joint twice: {', '.join(message.name)}", remedy)
        for name, position in zip(message.name, message.position, strict=True):
            if not abs(position) <= LARGEST_POSITION:  # nor where it is no number
                return GraphError(f"{said} a position of {position:.3g} rad for {name}", remedy)
        return None

    def _prepare(self) -> None:
        """Plan the motion as soon as the position of the arm is known."""
        if (
            self._trouble is not None
            and time.monotonic() - self._born > PATIENCE * graph.slowness()
        ):
            raise self._trouble
        if not self._names:
            return
        self._states.close()
        names = self._trajectory.joints or tuple(self._names)
        if sorted(names) != sorted(self._names) or len(names) != self._trajectory.n:
            moved = ", ".join(self._trajectory.joints) or f"{self._trajectory.n} joints"
            raise GraphError(
                f"the trajectory has the joints {moved}; the arm has {', '.join(self._names)}",
                "Create one for this arm with `elastic-arm excite`.",
            )
        position = self._position[[self._names.index(name) for name in names]]
        self._names = list(names)
        self._form = self._make_form()
        self._plan = Plan(self._trajectory, position, self._repeat, self._speed)
        self._prepared_ns = self.get_clock().now().nanoseconds

    def _start(self) -> None:
        """Set the time of the first point, once the arm listens and the clock is current."""
        assert self._plan is not None
        now = self.get_clock().now().nanoseconds
        if not self._settled() or now == self._prepared_ns:
            return
        # On the grid of the clock, so that an arm stepping on the same grid needs no interpolation.
        self._start_ns = -(-(now + HEAD_START_NS) // self._step_ns) * self._step_ns
        self.get_logger().info(
            f"streaming {self._plan.duration:.1f} s, including {self._plan.approach:.1f} s"
            " to reach the start"
        )

    def _settled(self) -> bool:
        """Return whether the arm reads the reference: its own node, or a subscriber that has done
        so for a while."""
        readers = self.get_subscriptions_info_by_topic(self._publisher.topic_name)
        if not readers or not self._publisher.get_subscription_count():
            self._matched = None
            return False
        now = time.monotonic()
        self._matched = self._matched or now
        states = graph.resolved(self, topics.MOTOR_STATES)
        arms = {
            (info.node_namespace, info.node_name)
            for info in self.get_publishers_info_by_topic(states)
        }
        own = any((info.node_namespace, info.node_name) in arms for info in readers)
        return now - self._matched >= (SETTLING if own else READER_PATIENCE) * graph.slowness()

    def _time(self, index: int) -> int:
        return self._start_ns + index * self._step_ns

    def _all_sent(self) -> bool:
        if self._plan is None:
            return False
        return self._sent * self._step_ns > self._plan.duration * NANOSECONDS

    def _send(self) -> None:
        assert self._plan is not None
        assert self._form is not None
        # Messages are all alike; the last one goes on at rest behind the end of the motion.
        rows: Row = self._plan.evaluate(
            (self._sent + np.arange(POINTS)) * self._step_ns / NANOSECONDS
        )
        for i in range(POINTS):
            self._form.fields[f"points.{i}.positions"][:] = rows.position[i]
            self._form.fields[f"points.{i}.velocities"][:] = rows.velocity[i]
            self._form.fields[f"points.{i}.accelerations"][:] = rows.acceleration[i]
        self._publisher.publish(self._form.filled(self._time(self._sent)))
        self._sent += POINTS

    def _make_form(self) -> Form:
        message = JointTrajectory(joint_names=self._names)
        zeros = array("d", bytes(8 * len(self._names)))
        for i in range(POINTS):
            point = JointTrajectoryPoint(positions=zeros, velocities=zeros, accelerations=zeros)
            point.time_from_start = span_of(i * self._step_ns)
            message.points.append(point)
        return Form(topics.TYPES[topics.REFERENCE], message)

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        problems = []
        if not self._publisher.get_subscription_count():
            problems.append(f"{self._publisher.topic_name} has no subscriber")
        elif not self._names:
            problems.append(f"no arm on {graph.resolved(self, topics.MOTOR_STATES)}")
        streamed = self._sent * self._step_ns / NANOSECONDS
        total = self._plan.duration if self._plan else 0.0
        return problems, {"streamed, s": streamed, "total duration, s": total}


if __name__ == "__main__":
    sys.exit(run(TrajectoryGenerator))
