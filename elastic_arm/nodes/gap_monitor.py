"""`ros2 run elastic_arm gap_monitor`: find where model and arm differ, and why, while the arm
moves."""

import json
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from elastic_arm_msgs.msg import GapDiagnosis
from std_srvs.srv import Trigger

from elastic_arm.diagnosis.live import Sizes, Window, answering
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import ElasticArmError, GraphError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.gap_messages import diagnosis_message, in_words
from elastic_arm.nodes.support.parameters import CHANNELS, MODEL, ROBOT, SIDES, Setting, declared
from elastic_arm.nodes.support.running import run
from elastic_arm.nodes.support.sampling import SamplingNode
from elastic_arm.nodes.support.wire import NANOSECONDS, stamp_of
from elastic_arm.nodes.support.worker_process import Answer, WorkerProcess
from elastic_arm.output_files import write_result
from elastic_arm.recording import topics
from elastic_arm.robot import load_robot

# Shorter recordings are not diagnosed; where no sample comes for so long, the data are over. Both
# s.
LEAST = 8.0
QUIET = 2.0

PARAMETERS = {
    "robot": ROBOT,
    "model": MODEL,
    "known": Setting(
        [], "Known effects, which are part of the model: EFFECT[:JOINT][:NAME=VALUE,…]"
    ),
    "effects_files": Setting(
        [], "Python files with your own effects, in addition to the catalogue"
    ),
    "refit": Setting(False, "Treat the parameters of the description as inexact, and fit them"),
    "channels": CHANNELS,
    "sides": SIDES,
    "window": Setting(
        15.0,
        "Duration of the diagnosed samples, s; the last third is used for validation",
        between=(LEAST, 120.0),
    ),
    "period": Setting(
        20.0, "Time between two diagnoses, s; each takes some seconds", between=(1.0, 3600.0)
    ),
    "save_to": Setting("diagnosis", "Folder for the results of ~/save"),
    "save_period": Setting(
        3600.0, "Time between automatically saved reports, s; 0: none", between=(0.0, 86400.0)
    ),
}


class GapMonitorNode(SamplingNode):
    """Keeps the samples of the last seconds, and diagnoses them in a worker process."""

    def __init__(self) -> None:
        super().__init__("gap_monitor")
        self.settings = declared(self, PARAMETERS)
        wanted = self.settings
        robot = load_robot(wanted.robot or None)
        # A mistake is to be heard of here.
        known_effects(wanted.known, robot, Catalogue.default().with_files(wanted.effects_files))
        channels = self.collect(robot)
        question = (
            wanted.robot or None,
            wanted.model,
            wanted.known,
            wanted.refit,
            wanted.effects_files,
        )
        self._worker = WorkerProcess(answering, *question)
        source = " ".join(graph.resolved(self, topic) for topic in self.collector.inboxes)
        self._window = Window(
            robot.joint_names, wanted.window, source, channels.currents() if channels else ()
        )
        self._output = self.output(topics.GAP, GapDiagnosis)
        self._latest_ns = 0
        self._arrived = time.monotonic()
        self._save_due = time.monotonic() + wanted.save_period
        self._count = self._restarts = 0
        self._took = 0.0
        self.forget()
        self.listen("diagnosis", "diagnosing")

    def forget(self) -> None:
        """Discard all samples and the running diagnosis."""
        self._window.clear()
        # The question under way: the stamp of its last sample, and when it was asked; None when it
        # no longer matters.
        self._asked: tuple[int, float] | None = None
        self._found: dict[str, Any] | None = None
        self._sizes = Sizes()
        self._changes = list[str]()
        self._said = ""
        self._diagnosis_due = time.monotonic()

    def work(self, now: float) -> None:
        """Read the new samples, publish results, and start the next diagnosis."""
        samples = self.collector.take()
        if samples is not None and not self.paused:
            self._window.add(samples)
            self._arrived = now
        if (answer := self._worker.answer()) is not None:
            self._publish(answer)
        if not self._worker.busy and not self.paused:
            self._ask(now)

    def close(self) -> None:
        """End the worker process."""
        self._worker.close()

    def _ask(self, now: float) -> None:
        """Start the diagnosis of new samples if it is due; the last one when the data end."""
        over = now > self._arrived + QUIET
        enough = (
            self._window.seconds >= LEAST
            if over
            else self._window.full and now >= self._diagnosis_due
        )
        if not enough or self.collector.last_ns == self._latest_ns:
            return
        self._diagnosis_due = now + self.settings.period
        self._latest_ns = self.collector.last_ns
        self._asked = (self._latest_ns, now)
        self._worker.ask(self._window.recording())

    def _publish(self, answer: Answer) -> None:
        if self._asked is None:
            return
        stamp_ns, began = self._asked
        self.problem = answer.problem
        if not answer.problem:
            self._took = time.monotonic() - began
            self._publish_diagnosis(answer.value, stamp_ns)
        elif self._worker.restarts > self._restarts:
            self._restarts = self._worker.restarts
            self.get_logger().error(answer.problem)

    def _publish_diagnosis(self, found: dict[str, Any], stamp_ns: int) -> None:
        self._found = found
        message = diagnosis_message(found)
        message.header.stamp = stamp_of(stamp_ns)
        self._output.publish(message)
        self._count += 1
        self._changes = self._sizes.changes(found)
        if (said := in_words(found)) != self._said:
            self.get_logger().info(said)
            self._said = said

    def save(self, request: Trigger.Request) -> str:
        """Write the last diagnosis as diagnosis.json."""
        return self._write("diagnosis.json")

    def _write(self, name: str) -> str:
        """Write the last diagnosis; return in words what was done."""
        if self._found is None:
            raise GraphError("there is no diagnosis yet", "Wait for the first one.")
        file = Path(self.settings.save_to) / name
        write_result(file, json.dumps(self._found, indent=2) + "\n")
        return f"the last diagnosis was written to {file}"

    def _keep(self) -> None:
        """Write the last diagnosis, named by its time, if a report is due."""
        period = self.settings.save_period
        if not period or self._found is None or time.monotonic() < self._save_due:
            return
        self._save_due = time.monotonic() + period
        stamp = datetime.fromtimestamp(self._latest_ns // NANOSECONDS, UTC)
        try:
            self.get_logger().info(self._write(f"diagnosis_{stamp:%Y-%m-%d_%H%M%S}.json"))
        except ElasticArmError as error:
            self.get_logger().error(str(error))

    def status(self) -> tuple[list[str], dict[str, Any]]:
        """Return problems, in words, and figures; save a report if one is due."""
        self._keep()
        figures = {
            "buffered time, s": self._window.seconds,
            "diagnoses": self._count,
            "last verdict": self._said,
            "restarts of the diagnosis process": self._worker.restarts,
            "duration of the last diagnosis, s": self._took,
        }
        return self._changes, figures


if __name__ == "__main__":
    sys.exit(run(GapMonitorNode))
