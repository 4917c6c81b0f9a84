"""`ros2 run elastic_arm simulator`: a simulated arm, measured a thousand times per second."""

import sys
import time
from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from elastic_arm_msgs.msg import JointTorques
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from elastic_arm.effects import parse
from elastic_arm.effects.effect import EffectInstance
from elastic_arm.errors import ElasticArmError, GraphError
from elastic_arm.nodes.following.action import TrajectoryAction
from elastic_arm.nodes.following.follower import Follower
from elastic_arm.nodes.following.goals import POLICIES, Goal
from elastic_arm.nodes.following.reference_message import commanded
from elastic_arm.nodes.following.splines import Row
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.description import ros_description
from elastic_arm.nodes.support.node import ArmNode, Health, Listener
from elastic_arm.nodes.support.parameters import Setting, declared, texts
from elastic_arm.nodes.support.running import run
from elastic_arm.nodes.support.wire import NANOSECONDS, Form, stamp_of
from elastic_arm.recording import topics
from elastic_arm.robot import load_robot
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import SimulationSettings, Simulator

# Simulated seconds between two messages on /clock.
CLOCK_PERIOD = 0.01
# How long the arm waits for a stream that is behind, where it can, real seconds.
STREAM_PATIENCE = 5.0
# The clock that waits publishes its time again after so long, real seconds: whoever missed it would
# wait as well.
REMINDER = 0.05
# In real time, how much of what was missed is caught up on, seconds: a busy machine should leave no
# holes.
CATCH_UP = 10.0
# With a clock of its own there is nothing to catch up with: a short delay is made good, or the pace
# would suffer.
MAKE_GOOD = 0.5
# Behind the time of day by more, seconds, is worth a word; and what of the stream is missing is
# still on its way in.
BEHIND = 0.2
# Nobody notices a pace that is off by less.
PACE_TOLERANCE = 0.02
# Before the first sample, seconds on an idle machine, others can see that this one is about to
# publish, and it sees those that start with it. Later another one is the newcomer, and this one
# stays.
SETTLING = 1.0
# What is published of a sample: fields of the messages, and the channels that they hold.
MEASURED: dict[str, tuple[Any, dict[str, str]]] = {
    topics.JOINT_STATES: (JointState, {"position": "q", "velocity": "dq", "effort": "tau_J"}),
    topics.MOTOR_STATES: (
        JointState,
        {"position": "theta", "velocity": "dtheta", "effort": "tau_m"},
    ),
    topics.JOINT_TORQUES: (JointTorques, {"joint_torque": "tau_J", "motor_torque": "tau_m"}),
}
PARAMETERS = {
    "robot": Setting("", "Arm file (YAML) or URDF; empty: the arm of the package"),
    "model": Setting("mod3", "Model of the arm", choices=("mod1", "mod2", "mod3")),
    "bearings": Setting(False, "Simulate the tilt of the bearings"),
    "effects": Setting([], "Effects of the true arm: EFFECT[:JOINT][:NAME=VALUE,…]", live=True),
    "torque_noise": Setting(
        0.26, "Standard deviation of the torque noise, Nm", between=(0.0, 1000.0)
    ),
    "encoder_noise": Setting(
        0.0, "Standard deviation of the encoder noise, rad", between=(0.0, 0.1)
    ),
    "velocity_noise": Setting(
        0.0, "Standard deviation of the velocity noise, rad/s", between=(0.0, 10.0)
    ),
    "seed": Setting(1, "Seed of the noise", between=(0, 2**31 - 1)),
    "rate": Setting(1000.0, "Samples per second", between=(10.0, 10_000.0)),
    "real_time_factor": Setting(
        1.0,
        "Simulated time per real time; with a value other than 1: with /clock",
        between=(0.01, 20.0),
        live=True,
    ),
    "limits": Setting(
        "refuse",
        "Reaction to a goal that violates a limit of position, velocity or acceleration",
        choices=POLICIES,
    ),
    "command_period": Setting(
        0.02, "Time in which the arm reaches a message on ~/joint_commands, s", between=(0.001, 0.5)
    ),
    "initial_position": Setting(
        [0.0], "Initial position of the arm, rad; one angle per joint, or one for all"
    ),
}


class Pace:
    """A schedule of steps at intervals of `1 / rate` of simulated time, at `factor` times real
    time.

    Late steps are caught up: the schedule consists of absolute times, so delays do not accumulate.
    Only if the delay exceeds `patience` seconds is the schedule shifted, which :attr:`slipped`
    counts.
    """

    def __init__(self, rate: float, factor: float = 1.0, patience: float = 0.5) -> None:
        self.rate = rate
        self.patience = patience
        self.slipped = 0.0
        self._interval = 1.0 / (rate * factor)
        self._due: float | None = None
        self._window: tuple[float, int] | None = None
        self._steps = 0

    def set_factor(self, factor: float) -> None:
        """Continue at another speed."""
        self._interval = 1.0 / (self.rate * factor)

    def wait(self, now: float) -> float:
        """Return the seconds until the next step is due; zero or less if it is."""
        if self._due is None:
            self._due = now
            self._window = (now, 0)
        return self._due - now

    def stepped(self, now: float) -> None:
        """Register that a step was made."""
        assert self._due is not None, "wait() comes before stepped()"
        self._steps += 1
        self._due += self._interval
        if now - self._due > self.patience:
            self.slipped += now - self._due
            self._due = now

    def hold(self, now: float) -> None:
        """Pause until `now`: steps that were due earlier are due from then on, without a slip."""
        if self._due is not None:
            self._due = max(self._due, now)

    def achieved(self, now: float) -> float:
        """Return the steps per real second since the last call, relative to the set rate.

        1 before the first step.
        """
        if self._window is None or now <= self._window[0]:
            return 1.0
        began, steps = self._window
        self._window = (now, self._steps)
        return (self._steps - steps) * self._interval / (now - began)


class SimulatorNode(ArmNode):
    """Steps a simulated arm in real time, or by a factor faster or slower with `/clock`."""

    def __init__(self) -> None:
        super().__init__("simulator")
        self._wanted = declared(self, PARAMETERS)
        began = time.monotonic()
        self._arm = self._build()
        real_time = self._wanted.real_time_factor == 1.0
        self._exclusive = [topics.MOTOR_STATES]
        if not real_time:
            self._exclusive.append(topics.CLOCK)
        # Discovery went on while the arm was built; a busy machine leaves it little time then.
        discovery = graph.DISCOVERY * graph.slowness() - (time.monotonic() - began)
        graph.require_single_publisher(self, self._exclusive, max(discovery, 0.5))
        self._waited = self._reminded = 0.0
        self._refusal = ""
        self._publish_setup(list(self._arm.robot.joint_names), real_time)
        graph.require_single_publisher(self, self._exclusive, SETTLING * graph.slowness())
        self._start_clock(real_time)
        self._reference_topic = graph.resolved(self, topics.REFERENCE)
        for kind, topic, take in (
            (JointTrajectory, self._reference_topic, lambda message: self._reference.take(message)),
            (JointTrajectory, "~/joint_trajectory", lambda message: self._reference.go_to(message)),
            (JointState, "~/joint_commands", self._obey),
        ):
            Listener(self, kind, topic, partial(self._take_points, take, topic))
        self._action = TrajectoryAction(self, lambda: self._reference)
        self.serve_words(Trigger, "reset", self._reset)
        Health(self, "pace", "achieved pace", self._status, self._now)
        self.add_on_set_parameters_callback(self._change)

    def _build(self) -> Simulator:
        wanted = self._wanted
        robot = load_robot(wanted.robot or None)
        if len(wanted.initial_position) not in (1, robot.n):
            given = (
                f"initial_position has {len(wanted.initial_position)} values for {robot.n} joints"
            )
            raise GraphError(given, "Give one per joint, or one for all.")
        self._start = np.broadcast_to(wanted.initial_position, (robot.n,)).astype(float)
        torque = TorqueSensor(noise=wanted.torque_noise)
        encoder = Encoder(noise=wanted.encoder_noise, velocity_noise=wanted.velocity_noise)
        settings = SimulationSettings(
            model=wanted.model,
            bearings=wanted.bearings,
            effects=[parse(text, robot) for text in wanted.effects],
            sensors=Sensors(encoder, encoder, torque, torque),
            rate=wanted.rate,
        )
        return Simulator(robot, settings, rng=np.random.default_rng(wanted.seed), q0=self._start)

    def _publish_setup(self, names: list[str], real_time: bool) -> None:
        """Create the publishers, and the message forms that they publish."""
        zeros = array("d", bytes(8 * len(names)))
        std = array("d", [self._wanted.torque_noise] * len(names))
        header = Header(frame_id=f"{self.get_namespace().strip('/')}/base".lstrip("/"))
        self._measured: list[tuple[Publisher, Form, dict[str, str]]] = []
        for topic, (kind, fields) in MEASURED.items():
            own = {
                field: channel
                for field, channel in fields.items()
                if channel != "tau_J" or self._arm.robot.elastic
            }
            example = kind(header=header, name=names, **dict.fromkeys(own, zeros))
            if kind is JointTorques:
                for field in own:
                    setattr(example, f"{field}_std", std)
            form = Form(topics.TYPES[topic], example)
            self._measured.append((self.output(topic, kind), form, own))
        self._clock_output = None if real_time else self.output(topics.CLOCK, Clock)
        self._clock_form = Form(topics.TYPES[topics.CLOCK], Clock())
        self._clock_every = max(round(CLOCK_PERIOD * self._arm.rate), 1)
        description = ros_description(self._arm.nominal, self.get_namespace())
        self.output(topics.ROBOT_DESCRIPTION, String).publish(String(data=description))

    def close(self) -> None:
        """Remove the action from the graph while the node still exists."""
        self._action.destroy()

    def _start_clock(self, real_time: bool) -> None:
        self._step_ns = round(NANOSECONDS / self._arm.rate)
        # Stamps lie on the grid of the time of day; a clock of its own begins at zero.
        self._origin_ns = time.time_ns() // self._step_ns * self._step_ns if real_time else 0
        self._step = 0 if real_time else 1  # a stamp of zero means no time at all
        self._skipped = self._refused = 0
        self._told = Counter[str]()
        self._reference = self._standing()
        self._pace = Pace(
            self._arm.rate, self._wanted.real_time_factor, CATCH_UP if real_time else MAKE_GOOD
        )
        self._pace.wait(time.monotonic())

    def tick(self) -> float:
        """Make the step that is due."""
        now = time.monotonic()
        wait = self._pace.wait(now)
        if wait > 0:
            return wait
        if self._stream_is_behind(now):
            return 0.001
        self._publish(self._reference.at(self._step))
        slipped = self._pace.slipped
        self._pace.stepped(now)
        lost = self._pace.slipped - slipped
        self._step += 1
        if lost and self._clock_output is None:
            self._skip(round(lost * self._arm.rate))
        return self._pace.wait(time.monotonic())

    def _skip(self, steps: int) -> None:
        """Advance without publishing, because real time does not wait for a process that was
        delayed, and neither does an arm."""
        rows = [self._reference.at(self._step + k) for k in range(steps)]
        self._arm.follow(*(np.array(values) for values in zip(*rows, strict=True)))
        self._step += steps
        self._skipped += steps

    def _publish(self, row: Row) -> None:
        _, measured = self._arm.step(row)
        stamp = self._origin_ns + self._step * self._step_ns
        for output, form, fields in self._measured:
            values = {field: measured[channel][0] for field, channel in fields.items()}
            output.publish(form.filled(stamp, **values))
        if self._step % self._clock_every == 0:
            self._tell_time(stamp)
        self._action.observe(stamp, row, measured["theta"][0], measured["dtheta"][0])

    def _stream_is_behind(self, now: float) -> bool:
        """Return whether to wait for more of the reference; in real time only while catching up."""
        if not self._reference.stream.starving():
            self._waited = now
            return False
        own_clock = self._clock_output is not None
        behind = -self._pace.wait(now)
        if now - self._waited > STREAM_PATIENCE or not (own_clock or behind > BEHIND):
            return False
        if own_clock:
            self._pace.hold(now)
            if now - self._reminded > REMINDER:
                self._reminded = now
                self._tell_time(self._origin_ns + (self._step - 1) * self._step_ns)
        return True

    def _now(self) -> Time:
        """Return the time of the arm: that of its last sample if it has its own clock."""
        if self._clock_output is None:
            return self.get_clock().now().to_msg()
        return stamp_of(self._origin_ns + (self._step - 1) * self._step_ns)

    def _tell_time(self, stamp: int) -> None:
        if self._clock_output is not None:
            self._clock_output.publish(self._clock_form.filled(stamp))

    def _standing(self) -> Follower:
        """Return a reference that holds the arm at its initial position."""
        return Follower(
            self._arm.nominal, self._start, self._origin_ns, self._step_ns, self._wanted.limits
        )

    def _reset(self, _: Trigger.Request) -> str:
        self._arm.reset(self._start)
        self._reference = self._standing()
        return "the arm is at rest at its initial position"

    def _obey(self, message: JointState) -> None:
        """Accept the command of one controller cycle, as the topic-based system of ros2_control
        sends it."""
        if (goal := commanded(message, self._wanted.command_period)) is not None:
            self._reference.obey(goal)

    def _take_points(self, take: Callable[[Any], Goal | None], topic: str, message: Any) -> None:
        """Accept streamed points or a goal; what cannot be followed is refused, and the arm
        continues as before."""
        try:
            goal = take(message)
        except GraphError as error:
            self._refused += 1
            self._refusal = error.problem
            self.get_logger().error(
                f"refused a message on {topic} that {error}", throttle_duration_sec=5.0
            )
            return
        if goal is not None and goal.reason:
            self.get_logger().warning(
                f"slowed a goal down by a factor of {goal.slower:.3g}: the requested motion"
                f" {goal.reason}"
            )

    def _change(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Change the speed or the effects during the simulation."""
        for parameter in parameters:
            if parameter.name == "real_time_factor":
                if self._clock_output is None and parameter.value != 1.0:
                    return SetParametersResult(
                        successful=False, reason="started in real time, without /clock"
                    )
                self._pace.set_factor(parameter.value)
            if parameter.name == "effects":
                try:
                    self._take(texts(parameter.value))
                except ElasticArmError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take(self, wanted: list[str]) -> None:
        effects: list[EffectInstance] = [parse(text, self._arm.robot) for text in wanted]
        self._arm.change_effects(effects)
        self.get_logger().info("effects: " + (", ".join(wanted) or "none"))

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        now = time.monotonic()
        others = {topic: graph.other_publishers(self, topic) for topic in self._exclusive}
        pace = self._pace.achieved(now)
        problems = [
            f"{name} also publishes {graph.resolved(self, topic)}: stop one of the two"
            for topic, names in others.items()
            for name in dict.fromkeys(names)  # a node may have several publishers
        ]
        if pace < 1.0 - PACE_TOLERANCE:
            problems.append(f"reaches {100 * pace:.0f} % of the requested rate")
        behind = max(-self._pace.wait(now), 0.0)
        if behind > BEHIND:
            problems.append(f"samples are {behind:.3g} s late because the machine is busy")
        reference = self._reference.stream
        counts = Counter(skipped=self._skipped, starved=reference.starved, refused=self._refused)
        new = counts - self._told
        self._told = counts
        if new["skipped"]:
            problems.append(f"{new['skipped']} samples skipped because the process was delayed")
        delay = reference.delay / self._arm.rate
        if new["starved"]:
            problems.append(
                f"the stream on {self._reference_topic} stopped during motion: the arm slowed down"
            )
        elif delay > 0:
            problems.append(
                f"the reference was late: it is followed {delay:.3g} s behind its stamps"
            )
        if new["refused"]:
            said = f"refused, the last of which {self._refusal}"
            problems.append(f"{new['refused']} messages on {self._reference_topic} {said}")
        figures = {
            "rate, Hz": pace * self._arm.rate * self._wanted.real_time_factor,
            "delay behind the clock, s": behind,
            "samples skipped": self._skipped,
            "delay behind the reference, s": delay,
            "late reference points": reference.late,
            "interrupted streams": reference.starved,
            "refused reference messages": self._refused,
        }
        return problems, figures


if __name__ == "__main__":
    sys.exit(run(SimulatorNode))
