"""`ros2 run elastic_arm gap_monitor`: where model and arm part, and why, while the arm moves."""

from __future__ import annotations

import json
import re
import sys
import time
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from elastic_arm_msgs.msg import GapDiagnosis, GapResidual
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from elastic_arm.diagnosis.live import ResidualLevels, Sizes, Window, answering
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import OutputError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.collecting import Collector
from elastic_arm.nodes.support.gap_messages import diagnosis_message, in_words, residual_messages
from elastic_arm.nodes.support.health import PERIOD, Health
from elastic_arm.nodes.support.listening import Listener
from elastic_arm.nodes.support.managed import AUTOSTART, ManagedNode
from elastic_arm.nodes.support.parameters import declare, declare_texts
from elastic_arm.nodes.support.running import LONGEST_REST, run
from elastic_arm.nodes.support.wire import NANOSECONDS
from elastic_arm.nodes.support.worker_process import Answer, WorkerProcess
from elastic_arm.output_files import write_result
from elastic_arm.recording import load_channels, topics
from elastic_arm.robot import load_robot

# Samples are taken in batches of this length, seconds.
BATCH = 0.1
# Residuals are measured over the last so many seconds: shorter, and filtering would leave too little.
STRETCH = 3.0


class GapMonitorNode(ManagedNode):
    """Keeps the last seconds of samples, and has them diagnosed in a worker process."""

    def __init__(self) -> None:
        super().__init__("gap_monitor")
        self._file = declare(self, "robot", "", "Nominal arm: file (YAML) or URDF; empty: the arm of the package")
        self._model = declare(self, "model", "mod3", "What the arm is taken to be", choices=("mod1", "mod2", "mod3"))
        self._known = declare_texts(
            self, "known", "Effects that count as part of the model: EFFECT[:JOINT][:NAME=VALUE,…]"
        )
        self._files = declare_texts(
            self, "effects_files", "Python files with effects of your own, in addition to the catalogue"
        )
        self._refit = declare(self, "refit", False, "The description cannot be exact: its numbers are fitted too")
        self._map = declare(self, "channels", "", "Channel map (YAML) of a driver's joint states: names, units")
        self._sides = declare(self, "sides", "both", "What the arm measures", choices=("both", "link", "motor"))
        self._seconds = declare(
            self, "window", 15.0, "Samples diagnosed, s; the last third of them judges", between=(8.0, 120.0)
        )
        self._every = declare(
            self, "period", 20.0, "From one diagnosis to the next, s; each takes some seconds", between=(1.0, 3600.0)
        )
        self._folder = declare(self, "save_to", "diagnosis", "Folder of what ~/save writes")
        self._save_every = declare(
            self, "save_period", 3600.0, "Between reports that it keeps by itself, s; 0: none", between=(0.0, 86400.0)
        )
        self._residuals_every = declare(
            self, "residual_period", 1.0, "Between two measurements of the residuals, s", between=(0.2, 3600.0)
        )
        autostart = declare(self, "autostart", True, AUTOSTART)
        self._health = Health(self, "diagnosis")
        self.every(PERIOD, self._report)
        self.start(autostart)

    def configure(self) -> None:
        """Start the process that diagnoses; offer diagnoses and services."""
        robot = load_robot(self._file or None)
        # A mistake is to be heard of here.
        known_effects(self._known, robot, Catalogue.default().with_files(self._files))
        self._worker = WorkerProcess(answering, self._file or None, self._model, self._known, self._refit, self._files)
        channels = load_channels(self._map) if self._map else None
        self._collector = Collector(robot.joint_names, self._sides, partial(graph.resolved, self), channels)
        source = " ".join(graph.resolved(self, topic) for topic in self._collector.inboxes)
        self._window = Window(robot.joint_names, self._seconds, source, channels.currents() if channels else ())
        self._output = self.create_publisher(GapDiagnosis, graph.relative(topics.GAP), graph.qos(topics.GAP))
        self._residual_outputs: dict[tuple[str, str], Publisher] = {}
        self._offered = [
            self.create_service(Trigger, "~/reset", self._reset),
            self.create_service(SetBool, "~/pause", self._pause),
            self.create_service(Trigger, "~/save", self._save),
        ]
        self._paused = False
        # The question under way: what was asked, the stamp of its last sample, when; None when it no longer matters.
        self._asked: tuple[str, int, float] | None = None
        self._latest_ns = 0
        self._found: dict[str, Any] | None = None
        self._sizes, self._changes = Sizes(), list[str]()
        self._save_due = time.monotonic() + self._save_every
        self._last = ""
        self._problem = ""
        self._said = ""
        self._count = self._restarts = 0
        self._took = 0.0

    def activate(self) -> None:
        """Subscribe to the arm's samples."""
        self._inputs = [
            Listener(self, JointState, graph.relative(topic), inbox.put, raw=True)
            for topic, inbox in self._collector.inboxes.items()
        ]
        self._due = self._diagnosis_due = self._residuals_due = time.monotonic()

    def deactivate(self) -> None:
        """Unsubscribe, and forget the samples, which later ones do not follow, and the diagnosis under way."""
        for listener in self._inputs:
            listener.close()
        self._collector.reset()
        self._window.clear()
        self._asked = None

    def cleanup(self) -> None:
        """End the process that diagnoses; take diagnoses and services out of the graph."""
        self._worker.close()
        for publisher in (self._output, *self._residual_outputs.values()):
            self.destroy_publisher(publisher)
        for service in self._offered:
            self.destroy_service(service)

    def tick(self) -> float:
        """Take what has arrived, publish what was found, and start the next diagnosis."""
        if self.state != "active":
            return LONGEST_REST
        now = time.monotonic()
        if now >= self._due:
            self._due = now + BATCH
            samples = self._collector.take()
            if samples is not None and not self._paused:
                self._window.add(samples)
            if (answer := self._worker.answer()) is not None:
                self._publish(answer)
            if not self._worker.busy and not self._paused:
                self._ask(now)
        return self._due - time.monotonic()

    def close(self) -> None:
        """End the process that diagnoses."""
        if self.configured:
            self._worker.close()

    def _ask(self, now: float) -> None:
        """Start the diagnosis that is due, of samples that none was made of yet."""
        if self._collector.last_ns == self._latest_ns:
            return
        due = {
            "diagnosis": self._window.full and now >= self._diagnosis_due,
            "where": self._window.seconds >= STRETCH and now >= self._residuals_due,
        }
        # In turns where both are due: on a busy machine either takes longer than its period.
        what = next((w for w in sorted(due, key=lambda w: w == self._last) if due[w]), None)
        if what is None:
            return
        if what == "diagnosis":
            self._diagnosis_due = now + self._every
        else:
            self._residuals_due = now + self._residuals_every
        self._last = what
        question = (what, self._window.recording(STRETCH if what == "where" else None))
        self._latest_ns = self._collector.last_ns
        self._asked = (what, self._latest_ns, now)
        self._worker.ask(question)

    def _publish(self, answer: Answer) -> None:
        if self._asked is None:
            return
        what, stamp_ns, began = self._asked
        self._problem = answer.problem
        if answer.problem:
            if self._worker.restarts > self._restarts:
                self._restarts = self._worker.restarts
                self.get_logger().error(answer.problem)
            return
        if what == "diagnosis":
            self._took = time.monotonic() - began
            self._publish_diagnosis(answer.value, stamp_ns)
        else:
            self._publish_residuals(answer.value)

    def _publish_diagnosis(self, found: dict[str, Any], stamp_ns: int) -> None:
        self._found = found
        message = diagnosis_message(found)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NANOSECONDS)
        self._output.publish(message)
        self._count += 1
        self._changes = self._sizes.changes(found)
        if (said := in_words(found)) != self._said:
            self.get_logger().info(said)
            self._said = said

    def _publish_residuals(self, where: ResidualLevels) -> None:
        """Publish each residual on a topic of its own: what a plot takes without knowing joints by number."""
        for place, message in residual_messages(where).items():
            if place not in self._residual_outputs:
                name = "/".join(re.sub(r"\W", "_", part) for part in place)
                self._residual_outputs[place] = self.create_publisher(GapResidual, f"~/residuals/{name}", graph.STREAM)
            self._residual_outputs[place].publish(message)

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Service: forget all samples, and what is being made of them."""
        self._collector.reset()
        self._window.clear()
        self._asked, self._problem, self._said, self._found = None, "", "", None
        self._sizes, self._changes = Sizes(), []
        self._diagnosis_due = time.monotonic()
        response.success, response.message = True, "all samples forgotten"
        return response

    def _pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Service: ignore samples while `data` is true."""
        self._paused = request.data
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Service: write the last diagnosis as diagnosis.json."""
        try:
            response.message, response.success = self._write("diagnosis.json"), self._found is not None
        except OutputError as error:
            response.message = error.problem
        return response

    def _write(self, name: str) -> str:
        """Write the last diagnosis; return what was done, in words."""
        if self._found is None:
            return "there is no diagnosis yet"
        file = Path(self._folder) / name
        write_result(file, json.dumps(self._found, indent=2) + "\n")
        return f"the last diagnosis was written to {file}"

    def _keep(self) -> None:
        """Write the last diagnosis, by its time, where a report is due."""
        if not self._save_every or time.monotonic() < self._save_due:
            return
        self._save_due = time.monotonic() + self._save_every
        stamp = datetime.fromtimestamp(self._latest_ns // NANOSECONDS, UTC)
        try:
            self.get_logger().info(self._write(f"diagnosis_{stamp:%Y-%m-%d_%H%M%S}.json"))
        except OutputError as error:
            self.get_logger().error(str(error))

    def _report(self) -> None:
        if self.state != "active":
            self._health.report([self.state], "", {})
            return
        self._keep()
        problems = [*self._collector.problems(), *self._changes]
        if self._paused:
            problems.append("paused")
        if self._problem:
            problems.append(self._problem)
        figures = {
            "seconds kept": self._window.seconds,
            "diagnoses": self._count,
            "last verdict": self._said,
            "restarts of the diagnosing process": self._worker.restarts,
            "last diagnosis took, s": self._took,
            **{f"samples {name}": count for name, count in vars(self._collector.losses).items()},
        }
        self._health.report(problems, "diagnosing", figures)


if __name__ == "__main__":
    sys.exit(run(GapMonitorNode))
