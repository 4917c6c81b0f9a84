"""Nodes with a managed life that take an arm's samples: configured, activated and so on from outside, or at start."""

from __future__ import annotations

import time
import traceback
from functools import partial, partialmethod
from types import SimpleNamespace
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from elastic_arm.errors import ElasticArmError
from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.collecting import Collector
from elastic_arm.nodes.support.node import LONGEST_REST, ArmNode, Health, Listener
from elastic_arm.recording import ChannelMap, load_channels
from elastic_arm.robot import Robot

# Samples are taken in batches of this length, seconds: arrays are cheap, single samples are not.
BATCH = 0.1


class ManagedNode(LifecycleNode, ArmNode):
    """A lifecycle node of ROS 2: `unconfigured`, `inactive`, `active` or `finalized`.

    Subclasses say what the transitions do. What is wrong in one is logged in a line, and the state stays; a node that
    starts by itself ends with that line. A node that is shut down ends, as by Ctrl-C.

    configured: whether what :meth:`configure` has made is there; problem: what is wrong, in words.
    """

    state = "unconfigured"
    configured = False
    settings: SimpleNamespace
    _refusal: ElasticArmError | None = None
    _starting = False

    def configure(self) -> None:
        """Load and prepare what the parameters name, then :meth:`offer`."""

    def offer(self, robot: Robot) -> ChannelMap | None:
        """Offer the services, and prepare to take the samples of an arm; return the map of its channels, if any."""
        channels = load_channels(self.settings.channels) if self.settings.channels else None
        self.collector = Collector(robot.joint_names, self.settings.sides, partial(graph.resolved, self), channels)
        self.paused, self.problem = False, ""
        self._offered = [
            self.serve_words(Trigger, "reset", self._reset),
            self.serve_words(SetBool, "pause", self._pause),
            self.serve_words(Trigger, "save", self.save),
        ]
        return channels

    def activate(self) -> None:
        """Subscribe to the arm's samples."""
        self._inputs = [
            Listener(self, JointState, graph.relative(topic), inbox.put, raw=True)
            for topic, inbox in self.collector.inboxes.items()
        ]
        self._due = time.monotonic()

    def deactivate(self) -> None:
        """Unsubscribe; what was made of the samples before stays."""
        for listener in self._inputs:
            listener.close()

    def cleanup(self) -> None:
        """Give up all that :meth:`configure` has made: publishers and services leave the graph."""
        for service in self._offered:
            self.destroy_service(service)

    def tick(self) -> float:
        """Do the work of a batch, when it is due."""
        if self.state != "active":
            return LONGEST_REST
        if (now := time.monotonic()) >= self._due:
            self._due = now + BATCH
            self.work(now)
        return self._due - time.monotonic()

    def work(self, now: float) -> None:
        """Take what has arrived, and publish what is due."""

    def forget(self) -> None:
        """Forget what was made of all samples."""

    def pause(self, paused: bool) -> None:
        """Ignore samples, or take them again."""
        self.paused = paused

    def save(self, request: Trigger.Request) -> str:
        """Write what was found; return what was done, in words."""
        raise NotImplementedError

    def status(self) -> tuple[list[str], dict[str, Any]]:
        """Return what is wrong, in words, and figures."""
        return [], {}

    def start(self, what: str, fine: str, autostart: bool) -> None:
        """Report the health of `what`, which is `fine` without problems; configure and activate, where that is wanted.

        Raises an ElasticArmError what was wrong.
        """
        Health(self, what, fine, self._status)
        self._starting = True
        for transition in (self.trigger_configure, self.trigger_activate) if autostart else ():
            transition()
            if self._refusal is not None:
                raise self._refusal
        self._starting = False

    def done(self) -> bool:
        """Return whether the node was shut down."""
        return self.state == "finalized"

    def _reset(self, _: Trigger.Request) -> str:
        self.collector.reset()
        self.forget()
        self.problem = ""
        return "all samples forgotten"

    def _pause(self, request: SetBool.Request) -> str:
        self.pause(request.data)
        return "paused" if request.data else "running"

    def _status(self) -> tuple[list[str], dict[str, Any]]:
        if self.state != "active":
            return [self.state], {}
        problems, figures = self.status()
        problems = [*self.collector.problems(), *problems, *(["paused"] if self.paused else [])]
        losses = {f"samples {name}": count for name, count in vars(self.collector.losses).items()}
        return [*problems, *filter(None, [self.problem])], {**figures, **losses}

    def _carry_out(self, work: str, state: str, configured: bool | None, _: LifecycleState) -> TransitionCallbackReturn:
        """Do the work of a transition, the method of this name."""
        finished = False
        try:
            if work:
                getattr(self, work)()
            self.state, finished = state, True
            self.configured = self.configured if configured is None else configured
        except ElasticArmError as error:
            self._refusal, finished = error, True
            if not self._starting:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        finally:
            if not finished:  # rclpy would lose what was raised
                self.get_logger().error(traceback.format_exc())
        return TransitionCallbackReturn.SUCCESS

    # The transitions: of what they do, where they lead to, and whether it is configured there.
    on_configure = partialmethod(_carry_out, "configure", "inactive", True)
    on_activate = partialmethod(_carry_out, "activate", "active", None)
    on_deactivate = partialmethod(_carry_out, "deactivate", "inactive", None)
    on_cleanup = partialmethod(_carry_out, "cleanup", "unconfigured", False)
    on_shutdown = partialmethod(_carry_out, "", "finalized", None)
