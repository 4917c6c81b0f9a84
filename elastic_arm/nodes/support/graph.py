"""The graph around a node: quality of service, and discovery of other nodes."""

import importlib
import os
import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from elastic_arm.errors import GraphError
from elastic_arm.recording import topics

STREAM = QoSProfile(depth=topics.STREAM_DEPTH)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# Peers on the same machine find each other within this time, seconds.
DISCOVERY = 1.0
# An endpoint may be discovered before the name of the node behind it, which is waited for this
# long, seconds.
NAMING = 10.0
UNNAMED = "another node"


def relative(topic: str) -> str:
    """Return the name of one of the suite's topics for nodes of any namespace.

    All namespaces share the topics of clock and diagnostics, as ROS expects.
    """
    return topic if topic in topics.GLOBAL else topic.lstrip("/")


def resolved(node: Node, topic: str) -> str:
    """Return the full name of one of the suite's topics, with namespace and remapping."""
    return str(node.resolve_topic_name(relative(topic)))


def qos(topic: str) -> QoSProfile:
    """Return the quality of service of one of the suite's topics, in any namespace."""
    return LATCHED if f"/{topic.rpartition('/')[2]}" in topics.LATCHED else STREAM


def message_class(type_name: str) -> Any:
    """Return the Python class of a type such as `sensor_msgs/msg/JointState`.

    Raises a GraphError if its package is not installed.
    """
    package, _, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise GraphError(
            f"message type {type_name} is not installed", f"Install or build {package}."
        ) from None


def other_publishers(node: Node, topic: str) -> list[str]:
    """Return the full names of other nodes that publish one of the suite's topics.

    In the namespace of a node.

    A node whose name discovery has not brought yet is `UNNAMED`, and comes last. A node of this
    one's name counts once too often.
    """
    topic = resolved(node, topic)
    names = [
        (
            UNNAMED
            if "UNKNOWN" in info.node_name
            else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        )
        for info in node.get_publishers_info_by_topic(topic)
    ]
    own = sum(1 for publisher in node.publishers if publisher.topic_name == topic)
    for _ in range(own):
        if node.get_fully_qualified_name() in names:
            names.remove(node.get_fully_qualified_name())
    return sorted(names, key=UNNAMED.__eq__)


def slowness() -> float:
    """Return how many times longer discovery may take than on an idle machine.

    1 to 4, depending on the load of each core.
    """
    return min(max(os.getloadavg()[0] / (os.cpu_count() or 1), 1.0), 4.0)


def require_single_publisher(node: Node, wanted: Sequence[str], seconds: float = DISCOVERY) -> None:
    """Wait for discovery; give up if another node publishes the topic.

    The error names the other node: its name may be discovered later than what it publishes, and is
    waited for. Of two that start together one looks a little longer, and finds the other.

    Raises a GraphError if there is one.
    """
    end = time.monotonic() + seconds + (os.getpid() % 8) * 0.05
    while True:
        found = {topic: others for topic in wanted if (others := other_publishers(node, topic))}
        now = time.monotonic()
        for topic, others in found.items():
            if others[0] != UNNAMED or now >= end + NAMING:
                raise company(others, resolved(node, topic))
        if not found and now >= end:
            return
        time.sleep(0.05)


def company(others: list[str], topic: str) -> GraphError:
    """Return the error for a topic that already has another source."""
    problem = f"{others[0]} already publishes {topic}: two sources of one topic would mix"
    if topic in topics.GLOBAL:  # which a namespace does not part
        return GraphError(
            problem, "Start this one with real_time_factor:=1.0, or with another ROS_DOMAIN_ID."
        )
    return GraphError(
        problem,
        "Stop it, or start this one in a namespace (--ros-args -r __ns:=/left) or with another"
        " ROS_DOMAIN_ID.",
    )
