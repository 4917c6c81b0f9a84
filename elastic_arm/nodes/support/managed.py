"""Nodes with a managed life: configured, activated and so on from outside, or all at once at start."""

from __future__ import annotations

import traceback
from functools import partialmethod

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from elastic_arm.errors import ElasticArmError
from elastic_arm.nodes.support.running import ArmNode

AUTOSTART = "Configure and activate the node at once; false: wait for the transitions"


class ManagedNode(LifecycleNode, ArmNode):
    """A lifecycle node of ROS 2: `unconfigured`, `inactive`, `active` or `finalized`.

    Subclasses say what the transitions do. What is wrong in one is logged in a line, and the state stays; a node that
    starts by itself ends with that line. A node that is shut down ends, as by Ctrl-C.

    configured: whether what :meth:`configure` has made is there.
    """

    state = "unconfigured"
    configured = False
    _refusal: ElasticArmError | None = None
    _starting = False

    def configure(self) -> None:
        """Load and prepare what the parameters name, and offer publishers and services."""

    def activate(self) -> None:
        """Begin to take messages."""

    def deactivate(self) -> None:
        """Take no more messages; what was made of those before stays."""

    def cleanup(self) -> None:
        """Give up all that :meth:`configure` has made."""

    def start(self, autostart: bool) -> None:
        """Configure and activate, where that is wanted.

        Raises an ElasticArmError what was wrong.
        """
        self._starting = True
        for transition in (self.trigger_configure, self.trigger_activate) if autostart else ():
            transition()
            if self._refusal is not None:
                raise self._refusal
        self._starting = False

    def done(self) -> bool:
        """Return whether the node was shut down."""
        return self.state == "finalized"

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
