"""Common parts of all nodes: a schedule, health on `/diagnostics`, and subscriptions that match all
publishers."""

from collections.abc import Callable, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.timer import Timer
from rclpy.topic_endpoint_info import TopicEndpointInfo

from elastic_arm.errors import ElasticArmError
from elastic_arm.nodes.support import graph
from elastic_arm.recording import topics

# How long a stop signal may wait for a node that has nothing to do.
LONGEST_REST = 0.1
# Seconds between two reports of health: what monitoring tools expect.
PERIOD = 1.0
ADAPTING = 0.1  # s between looks at who publishes


class ArmNode(Node):
    """A node with a rhythm of its own.

    The process calls :meth:`tick`, spins until the next is due, and so on.

    failure: set by a callback that met an error, which ends the node; an exception out of a
    callback would be logged by the executor with its traceback first.
    """

    failure: ElasticArmError | None = None

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call a function periodically, in real time.

        This also works if the node uses a clock that nobody publishes.
        """
        return self.create_timer(seconds, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def output(self, topic: str, kind: Any) -> Publisher:
        """Return a publisher of one of the suite's topics."""
        return self.create_publisher(kind, graph.relative(topic), graph.qos(topic))

    def serve(
        self, kind: Any, name: str, answer: Callable[[Any], Mapping[str, Any] | None]
    ) -> Service:
        """Offer a service: `answer` returns the fields of the response that differ from the
        defaults."""

        def reply(request: Any, response: Any) -> Any:
            for field, value in (answer(request) or {}).items():
                setattr(response, field, value)
            return response

        return self.create_service(kind, f"~/{name}", reply)

    def serve_words(self, kind: Any, name: str, act: Callable[[Any], str]) -> Service:
        """Offer a service that answers whether it succeeded, and the reason in words."""

        def answer(request: Any) -> Mapping[str, Any]:
            try:
                return {"message": act(request), "success": True}
            except ElasticArmError as error:
                return {"message": str(error), "success": False}

        return self.serve(kind, name, answer)

    def tick(self) -> float:
        """Do what is due; return the seconds until the next call."""
        return LONGEST_REST

    def done(self) -> bool:
        """Return whether the node has finished its work by itself."""
        return False

    def close(self) -> None:
        """Complete everything that outlives the process; called once, whatever ended it."""


class Health:
    """Publishes the status of a node once per second, and logs changes for the better or worse.

    fine: text without problems; look: returns the problems, in words, and figures; now: time of the
    status, by default that of the node's clock.
    """

    def __init__(
        self,
        node: ArmNode,
        what: str,
        fine: str,
        look: Callable[[], tuple[list[str], dict[str, Any]]],
        now: Callable[[], Time] | None = None,
    ) -> None:
        self._node = node
        self._fine = fine
        self._look = look
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
        status = DiagnosticStatus(
            level=level, name=self._name, message=message, hardware_id=self._arm
        )
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


class Listener:
    """A subscription that is renewed if publishers offer less, or latch messages."""

    def __init__(
        self,
        node: ArmNode,
        kind: Any,
        topic: str,
        take: Callable[[Any], None],
        *,
        raw: bool = False,
    ) -> None:
        self._node = node
        self._what = (kind, topic, take)
        self._raw = raw
        self._closed = False
        self._subscribe(graph.qos(topic))
        self._timer = node.every(ADAPTING, self.adapt)
        self.adapt()

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        return str(self._subscription.topic_name)

    def adapt(self) -> None:
        """Request what all publishers offer."""
        if self._closed:  # a timer that was due already calls once more
            return
        if infos := self._node.get_publishers_info_by_topic(self.topic):
            wanted = matching(infos)
            if (wanted.reliability, wanted.durability) != (
                self._qos.reliability,
                self._qos.durability,
            ):
                self._node.destroy_subscription(self._subscription)
                self._subscribe(wanted)

    def _subscribe(self, qos: QoSProfile) -> None:
        self._qos = qos
        # No warning of publishers that offer less: an event of a subscription that is gone would
        # end the node.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._subscription = self._node.create_subscription(
            *self._what, qos, raw=self._raw, event_callbacks=silent
        )

    def close(self) -> None:
        """Stop receiving."""
        self._closed = True
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)


def matching(infos: list[TopicEndpointInfo]) -> QoSProfile:
    """Return a quality of service that receives from all publishers, including latched ones."""
    reliable = all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE for info in infos)
    latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)
    return QoSProfile(
        depth=graph.STREAM.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
