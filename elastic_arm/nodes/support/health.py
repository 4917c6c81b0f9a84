"""A node's health on `/diagnostics`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from elastic_arm.nodes.support import graph
from elastic_arm.recording import topics

# Once a second is what monitoring tools expect.
PERIOD = 1.0


class Health:
    """Publishes one status of a node, and logs it when it gets worse or better.

    now: time of the status; that of the node's clock where there is no other.
    """

    def __init__(self, node: Node, what: str, now: Callable[[], Time] | None = None) -> None:
        self._now = now or (lambda: node.get_clock().now().to_msg())
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, graph.qos(topics.DIAGNOSTICS))
        self._name = f"{node.get_fully_qualified_name().lstrip('/')}: {what}"
        self._arm = node.get_namespace().strip("/") or "elastic_arm"
        self._level = DiagnosticStatus.OK

    def report(self, problems: list[str], fine: str, values: dict[str, Any]) -> None:
        """Publish the problems (or, if there are none, that all is `fine`) with figures beside them."""
        level = DiagnosticStatus.WARN if problems else DiagnosticStatus.OK
        message = "; ".join(problems) or fine
        status = DiagnosticStatus(level=level, name=self._name, message=message, hardware_id=self._arm)
        status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._now()
        self._publisher.publish(array)
        if level != self._level:
            log = self._node.get_logger()
            log.warning(message) if problems else log.info(message)
            self._level = level


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
