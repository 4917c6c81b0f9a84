"""`ros2 run elastic_arm identifier`: base parameters while the arm moves."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from elastic_arm_msgs.msg import ParameterEstimate
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from elastic_arm.errors import ElasticArmError, IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import rounded
from elastic_arm.identification import identifier_of, parse_laws
from elastic_arm.identification.least_squares import Fit
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.collecting import Collector
from elastic_arm.nodes.support.health import PERIOD, Health
from elastic_arm.nodes.support.listening import Listener
from elastic_arm.nodes.support.managed import AUTOSTART, ManagedNode
from elastic_arm.nodes.support.parameters import declare, declare_texts
from elastic_arm.nodes.support.running import LONGEST_REST, run
from elastic_arm.nodes.support.screening import StreamScreen
from elastic_arm.nodes.support.wire import NANOSECONDS
from elastic_arm.recording import load_channels, topics
from elastic_arm.robot import load_robot

# Samples are taken in batches of this length, seconds: arrays are cheap, single samples are not.
BATCH = 0.1


class IdentifierNode(ManagedNode):
    """Feeds what arrives to the estimator, and publishes what it finds."""

    def __init__(self) -> None:
        super().__init__("identifier")
        self._file = declare(self, "robot", "", "Nominal arm: file (YAML) or URDF; empty: the arm of the package")
        self._name = declare(self, "model", "mod3", "What the arm is taken to be", choices=("mod1", "mod2", "mod3"))
        self._laws = declare_texts(self, "effects", "Laws identified too: EFFECT[:JOINT][:side=link]")
        self._map = declare(self, "channels", "", "Channel map (YAML) of a driver's joint states: names, units")
        self._sides = declare(self, "sides", "both", "What the arm measures", choices=("both", "link", "motor"))
        self._every = declare(self, "estimate_period", 1.0, "Between estimates, s", between=(0.1, 3600.0))
        self._folder = declare(self, "save_to", "identified", "Folder of what ~/save writes")
        self._save_at_exit = declare(self, "save_at_exit", False, "Save also when the node stops")
        self._lines = declare(self, "print", False, "Print each estimate as a line of JSON on stdout")
        autostart = declare(self, "autostart", True, AUTOSTART)
        self._health = Health(self, "estimate")
        self.every(PERIOD, self._report)
        self.start(autostart)

    def configure(self) -> None:
        """Compile the model's equations; offer estimates and services."""
        robot = load_robot(self._file or None)
        self._identifier = identifier_of(robot, self._name, parse_laws(self._laws, robot))
        channels = load_channels(self._map) if self._map else None
        self._collector = Collector(robot.joint_names, self._sides, partial(graph.resolved, self), channels)
        self._screen = StreamScreen()
        self._warm_up(robot.n)
        self._output = self.create_publisher(
            ParameterEstimate, graph.relative(topics.PARAMETER_ESTIMATE), graph.qos(topics.PARAMETER_ESTIMATE)
        )
        self._offered = [
            self.create_service(Trigger, "~/reset", self._reset),
            self.create_service(SetBool, "~/pause", self._pause),
            self.create_service(Trigger, "~/save", self._save),
        ]
        self._fit: Fit | None = None
        self._problem = ""

    def activate(self) -> None:
        """Subscribe to the arm's samples."""
        self._inputs = [
            Listener(self, JointState, graph.relative(topic), inbox.put, raw=True)
            for topic, inbox in self._collector.inboxes.items()
        ]
        self._due = self._estimate_due = time.monotonic()

    def deactivate(self) -> None:
        """Unsubscribe, and work off what has arrived."""
        for listener in self._inputs:
            listener.close()
        self._take(everything=True)

    def cleanup(self) -> None:
        """Take estimates and services out of the graph; all samples are forgotten."""
        self.destroy_publisher(self._output)
        for service in self._offered:
            self.destroy_service(service)

    def tick(self) -> float:
        """Take what has arrived; now and then, make an estimate of it."""
        if self.state != "active":
            return LONGEST_REST
        now = time.monotonic()
        if now >= self._due:
            self._due = now + BATCH
            self._take()
            if now >= self._estimate_due:
                self._estimate_due = now + self._every
                self._estimate()
        return self._due - time.monotonic()

    def close(self) -> None:
        """Work off what waits, make the last estimate and save it, if that is wanted."""
        if not self.configured:
            return
        self._take(everything=True)
        with contextlib.suppress(IdentificationError):  # too few samples wait to make anything of
            self._identifier.finish()
        self._estimate()
        if self._save_at_exit:
            self.get_logger().info(self._write())

    def _warm_up(self, n: int) -> None:
        """Compile the equations before samples arrive: that takes seconds, the first time."""
        channels: dict[str, Any] = dict.fromkeys(
            ("q", "dq", "ddq", "theta", "dtheta", "ddtheta", "tau_J", "tau_m"), np.zeros((2, n))
        )
        motion = Motion(t=np.arange(2.0), **channels)
        self._identifier.choose_equations(motion).information(motion)
        self._identifier.reset()

    def _take(self, everything: bool = False) -> None:
        samples = self._collector.take(everything)
        if samples is None:
            return
        try:
            self._identifier.add(self._screen.take(samples))
            self._problem = ""
        except IdentificationError as error:
            self._problem = str(error)

    def _estimate(self) -> None:
        try:
            self._fit = self._identifier.fit()
        except IdentificationError as error:
            self._problem = self._problem or error.problem
            return
        base = self._identifier.equations.base
        message = ParameterEstimate(
            model=self._name,
            name=list(base.names),
            value=self._fit.Psi,
            std=self._fit.std,
            unit=list(base.units),
            residual_rms=rms(self._fit.noise),
            condition_number=self._fit.condition,
            samples=self._identifier.progress.samples,
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._collector.last_ns, NANOSECONDS)
        self._output.publish(message)
        if self._lines:
            self._print(message)

    def _print(self, message: ParameterEstimate) -> None:
        line = {
            "samples": message.samples,
            "residual_rms": message.residual_rms,
            "condition_number": finite(message.condition_number),
            "name": list(message.name),
            "value": [finite(value) for value in message.value],
            "std": [finite(value) for value in message.std],
            "unit": list(message.unit),
        }
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Service: forget all samples."""
        self._collector.reset()
        self._screen.reset()
        self._identifier.reset()
        self._fit = None
        response.success, response.message = True, "all samples forgotten"
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Service: ignore samples while `data` is true."""
        if request.data:
            self._identifier.pause()
        else:
            self._identifier.resume()
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Service: write the estimate."""
        try:
            response.message, response.success = self._write(), True
        except ElasticArmError as error:
            response.message = str(error)
        return response

    def _write(self) -> str:
        """Write the estimate; return what was done, in words."""
        result = self._identifier.estimate(tuple(graph.resolved(self, topic) for topic in self._collector.inboxes))
        file = Path(self._folder) / "identification.json"
        result.to_json(file)
        received = self._identifier.progress.received  # the smoother keeps some at both ends of every piece
        laws = [e for e in result.estimates if e.is_friction]
        sizes = [f"{e.short} {' ± '.join(rounded(e.value, e.std))} {e.unit}" for e in laws]
        found = " ".join([*result.summary(), *([f"{'; '.join(sizes)}."] if sizes else [])])
        return f"{found} Estimate of {result.samples} samples, of {received} received, written to {file}"

    def _report(self) -> None:
        if self.state != "active":
            self._health.report([self.state], "", {})
            return
        progress, losses = self._identifier.progress, self._collector.losses
        problems = self._collector.problems()
        if self._screen.left_out:
            problems.append(f"{self._screen.left_out} samples hold absurd numbers, and are left out")
        if self._identifier.paused:
            problems.append("paused")
        if self._problem:
            problems.append(self._problem)
        figures = {
            "samples received": progress.received,
            "samples used": progress.samples,
            "samples at rest": progress.resting,
            "pieces without a gap": progress.pieces,
            "samples absurd": self._screen.left_out,
            **{f"samples {name}": count for name, count in vars(losses).items()},
        }
        if self._fit is not None:
            figures |= {"residual RMS, Nm": rms(self._fit.noise), "condition number": self._fit.condition}
        self._health.report(problems, "identifying", figures)


def rms(noise: NDArray[np.float64]) -> float:
    """Return the RMS over all equations of their residuals' standard deviations."""
    return float(np.sqrt(np.mean(noise**2)))


def finite(value: float) -> float | None:
    """Return None for what JSON has no number for."""
    return value if np.isfinite(value) else None


if __name__ == "__main__":
    sys.exit(run(IdentifierNode))
