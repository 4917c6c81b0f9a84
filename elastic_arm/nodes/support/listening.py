"""Subscriptions that receive from every publisher of a topic, whatever its quality of service."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from elastic_arm.nodes.support import graph
from elastic_arm.nodes.support.running import ArmNode

ADAPTING = 0.1  # s between looks at who publishes


class Listener:
    """A subscription that is made anew where publishers offer less than it requests, or something latched."""

    def __init__(self, node: ArmNode, kind: Any, topic: str, take: Callable[[Any], None], *, raw: bool = False) -> None:
        self._node, self._what, self._raw, self._closed = node, (kind, topic, take), raw, False
        self._subscribe(graph.qos(topic))
        self._timer = node.every(ADAPTING, self.adapt)
        self.adapt()

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        return str(self._subscription.topic_name)

    def adapt(self) -> None:
        """Ask for what all publishers offer."""
        if self._closed:  # a timer that was due already calls once more
            return
        if infos := self._node.get_publishers_info_by_topic(self.topic):
            wanted = matching(infos)
            if (wanted.reliability, wanted.durability) != (self._qos.reliability, self._qos.durability):
                self._node.destroy_subscription(self._subscription)
                self._subscribe(wanted)

    def _subscribe(self, qos: QoSProfile) -> None:
        self._qos = qos
        # No warning of publishers that offer less: an event of a subscription that is gone would end the node.
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._subscription = self._node.create_subscription(*self._what, qos, raw=self._raw, event_callbacks=silent)

    def close(self) -> None:
        """Receive nothing more."""
        self._closed = True
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)


def matching(infos: list[TopicEndpointInfo]) -> QoSProfile:
    """Return a quality of service that receives from all these publishers, also what was latched."""
    reliable = all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE for info in infos)
    latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)
    return QoSProfile(
        depth=graph.STREAM.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
