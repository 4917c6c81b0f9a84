"""A node's health on `/diagnostics`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from elastic_arm.nodes.support.running import ArmNode
from elastic_arm.recording import topics

# Once a second is what monitoring tools expect.
PERIOD = 1.0


class Health:
    """Publishes the status of a node once a second, and logs it when it gets worse or better.

    fine: what to say without problems; look: returns the problems, in words, and figures; now: time of the status,
    that of the node's clock where there is no other.
    """

    def __init__(
        self,
        node: ArmNode,
        what: str,
        fine: str,
        look: Callable[[], tuple[list[str], dict[str, Any]]],
        now: Callable[[], Time] | None = None,
    ) -> None:
        self._node, self._fine, self._look = node, fine, look
        self._now = now or (lambda: node.get_clock().now().to_msg())
        self._publisher = node.output(topics.DIAGNOSTICS, DiagnosticArray)
        self._name = f"{node.get_fully_qualified_name().lstrip('/')}: {what}"
        self._arm = node.get_namespace().strip("/") or "elastic_arm"
        self._level = DiagnosticStatus.OK
        node.every(PERIOD, self._report)

    def _report(self) -> None:
        problems, values = self._look()
        level = DiagnosticStatus.WARN if problems else DiagnosticStatus.OK
        message = "; ".join(problems) or self._fine
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
