"""`ros2 run elastic_arm identifier`: estimate base parameters while the arm moves."""

import contextlib
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from elastic_arm_msgs.msg import ParameterEstimate
from std_srvs.srv import Trigger

from elastic_arm.arrays import rms
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.formatting import rounded
from elastic_arm.identification import identifier_of, parse_laws
from elastic_arm.identification.least_squares import Fit
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.parameters import CHANNELS, MODEL, ROBOT, SIDES, Setting, declared
from elastic_arm.nodes.support.running import run
from elastic_arm.nodes.support.sampling import SamplingNode
from elastic_arm.nodes.support.screening import StreamScreen
from elastic_arm.nodes.support.wire import stamp_of
from elastic_arm.output_files import plain
from elastic_arm.recording import topics
from elastic_arm.robot import load_robot

PARAMETERS = {
    "robot": ROBOT,
    "model": MODEL,
    "effects": Setting([], "Effects to identify as well: EFFECT[:JOINT][:side=link]"),
    "channels": CHANNELS,
    "sides": SIDES,
    "estimate_period": Setting(1.0, "Time between estimates, s", between=(0.1, 3600.0)),
    "save_to": Setting("identified", "Folder for the results of ~/save"),
    "save_at_exit": Setting(False, "Save also when the node stops"),
    "print": Setting(False, "Print each estimate as a line of JSON on stdout"),
}


class IdentifierNode(SamplingNode):
    """Passes samples to the estimator, and publishes the estimates."""

    def __init__(self) -> None:
        super().__init__("identifier")
        self.settings = declared(self, PARAMETERS)
        robot = load_robot(self.settings.robot or None)
        self._identifier = identifier_of(
            robot, self.settings.model, parse_laws(self.settings.effects, robot)
        )
        self._screen = StreamScreen()
        self._warm_up(robot.n)
        self._output = self.output(topics.PARAMETER_ESTIMATE, ParameterEstimate)
        self._fit: Fit | None = None
        self._estimate_due = time.monotonic()
        self.collect(robot)
        self.listen("estimate", "identifying")

    def work(self, now: float) -> None:
        """Read the new samples, and estimate from time to time."""
        self._take()
        if now >= self._estimate_due:
            self._estimate_due = now + self.settings.estimate_period
            self._estimate()

    def close(self) -> None:
        """Process the remaining samples, make the last estimate, and save it if requested."""
        self._take(everything=True)
        with contextlib.suppress(IdentificationError):  # too few samples wait to make anything of
            self._identifier.finish()
        self._estimate()
        if self.settings.save_at_exit:
            self.get_logger().info(self.save(Trigger.Request()))

    def _warm_up(self, n: int) -> None:
        """Compile the equations before samples arrive, which takes seconds the first time."""
        channels: dict[str, Any] = dict.fromkeys(
            ("q", "dq", "ddq", "theta", "dtheta", "ddtheta", "tau_J", "tau_m"), np.zeros((2, n))
        )
        motion = Motion(t=np.arange(2.0), **channels)
        self._identifier.choose_equations(motion).information(motion)
        self._identifier.reset()

    def _take(self, everything: bool = False) -> None:
        samples = self.collector.take(everything)
        if samples is None:
            return
        try:
            self._identifier.add(self._screen.take(samples))
            self.problem = ""
        except IdentificationError as error:
            self.problem = str(error)

    def _estimate(self) -> None:
        try:
            self._fit = self._identifier.fit()
        except IdentificationError as error:
            self.problem = self.problem or error.problem
            return
        base = self._identifier.equations.base
        message = ParameterEstimate(
            model=self.settings.model,
            name=list(base.names),
            value=self._fit.Psi,
            std=self._fit.std,
            unit=list(base.units),
            residual_rms=float(rms(self._fit.noise, None)),
            condition_number=self._fit.condition,
            samples=self._identifier.progress.samples,
        )
        message.header.stamp = stamp_of(self.collector.last_ns)
        self._output.publish(message)
        if self.settings.print:
            self._print(message)

    def _print(self, message: ParameterEstimate) -> None:
        numbers = ("samples", "residual_rms", "condition_number")
        line = {name: getattr(message, name) for name in numbers}
        line |= {name: list(getattr(message, name)) for name in ("name", "value", "std", "unit")}
        sys.stdout.write(json.dumps(plain(line)) + "\n")
        sys.stdout.flush()

    def forget(self) -> None:
        """Discard all samples."""
        self._screen.reset()
        self._identifier.reset()
        self._fit = None

    def pause(self, paused: bool) -> None:
        """Ignore samples, or use them again."""
        super().pause(paused)
        (self._identifier.pause if paused else self._identifier.resume)()

    def save(self, request: Trigger.Request) -> str:
        """Write the estimate; return in words what was done."""
        result = self._identifier.estimate(
            tuple(graph.resolved(self, topic) for topic in self.collector.inboxes)
        )
        file = Path(self.settings.save_to) / "identification.json"
        result.to_json(file)
        # the smoother keeps some at both ends of every piece
        received = self._identifier.progress.received
        laws = [e for e in result.estimates if e.is_friction]
        sizes = [f"{e.short} {' ± '.join(rounded(e.value, e.std))} {e.unit}" for e in laws]
        sentences = list(result.summary())
        if sizes:
            sentences.append(f"{'; '.join(sizes)}.")
        found = " ".join(sentences)
        return (
            f"{found} Estimate of {result.samples} samples, of {received} received, written to"
            f" {file}"
        )

    def status(self) -> tuple[list[str], dict[str, Any]]:
        """Return problems, in words, and figures."""
        progress = self._identifier.progress
        absurd = self._screen.left_out
        figures: dict[str, Any] = {
            "samples received": progress.received,
            "samples used": progress.samples,
            "samples at rest": progress.resting,
            "intervals without a gap": progress.pieces,
            "implausible samples": absurd,
        }
        if self._fit is not None:
            figures |= {
                "residual RMS, Nm": float(rms(self._fit.noise, None)),
                "condition number": self._fit.condition,
            }
        return (
            [f"{absurd} samples contain implausible numbers and are excluded"] if absurd else []
        ), figures


if __name__ == "__main__":
    sys.exit(run(IdentifierNode))
