"""Nodes that use samples of an arm: subscriptions, services and status."""

import time
from functools import partial
from types import SimpleNamespace
from typing import Any

from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.collecting import Collector
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode, Health, Listener
from elastic_arm.recording import ChannelMap, load_channels
from elastic_arm.robot import Robot

# Samples are taken in batches of this length, seconds: arrays are cheap, single samples are not.
BATCH = 0.1


class SamplingNode(ArmNode):
    """A node that processes samples of an arm.

    Subclasses define the processing, and prepare it before :meth:`listen`.

    problem: the current problem, in words.
    """

    settings: SimpleNamespace
    problem = ""
    paused = False

    def collect(self, robot: Robot) -> ChannelMap | None:
        """Prepare to receive the samples of an arm; return the map of its channels, if any."""
        channels = load_channels(self.settings.channels) if self.settings.channels else None
        self.collector = Collector(
            robot.joint_names, self.settings.sides, partial(graph.resolved, self), channels
        )
        return channels

    def listen(self, what: str, fine: str) -> None:
        """Subscribe, offer the services, and report the health of `what`.

        Without problems the status is `fine`.
        """
        self.serve_words(Trigger, "reset", self._reset)
        self.serve_words(SetBool, "pause", self._pause)
        self.serve_words(Trigger, "save", self.save)
        for topic, inbox in self.collector.inboxes.items():
            Listener(self, JointState, graph.relative(topic), inbox.put, raw=True)
        Health(self, what, fine, self._status)
        self._due = time.monotonic()

    def tick(self) -> float:
        """Process a batch if it is due."""
        if (now := time.monotonic()) >= self._due:
            self._due = now + BATCH
            self.work(now)
        return min(self._due - time.monotonic(), LONGEST_REST)

    def work(self, now: float) -> None:
        """Read the new samples, and publish what is due."""

    def forget(self) -> None:
        """Discard the results of all samples."""

    def pause(self, paused: bool) -> None:
        """Ignore samples, or use them again."""
        self.paused = paused

    def save(self, request: Trigger.Request) -> str:
        """Write the results; return in words what was done."""
        raise NotImplementedError

    def status(self) -> tuple[list[str], dict[str, Any]]:
        """Return problems, in words, and figures."""
        return [], {}

    def _reset(self, _: Trigger.Request) -> str:
        self.collector.reset()
        self.forget()
        self.problem = ""
        return "all samples discarded"

    def _pause(self, request: SetBool.Request) -> str:
        self.pause(request.data)
        return "paused" if request.data else "running"

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        problems, figures = self.status()
        problems = [*self.collector.problems(), *problems, *(["paused"] if self.paused else [])]
        losses = {f"samples {name}": count for name, count in vars(self.collector.losses).items()}
        return [*problems, *filter(None, [self.problem])], {**figures, **losses}
