"""Nodes receive from whoever publishes, whatever quality of service they offer, and from the first
message on."""

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from elastic_arm.nodes.support.graph import STREAM
from elastic_arm.recording.storage.messages import read_messages
from tests.helpers.ros_graph import Graph

pytestmark = pytest.mark.graph
BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
COUNT = 50


class Driver:
    """Publishes numbered joint states."""

    def __init__(self, graph: Graph, qos: QoSProfile) -> None:
        self.output = graph.peer.create_publisher(JointState, "/joint_states", qos)
        self.count = 0
        graph.until(self.output.get_subscription_count, "somebody listens")

    def publish(self) -> None:
        """Publish the next one."""
        names = ["joint_1", "joint_2", "joint_3"]
        message = JointState(
            name=names, position=[0.0] * 3, velocity=[0.0] * 3, effort=[float(self.count), 0.0, 0.0]
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            10_000_000 * self.count + 10**9, 10**9
        )
        self.output.publish(message)
        self.count += 1


def test_the_identifier_hears_a_publisher_of_best_effort(graph: Graph) -> None:
    """Its subscription was there before, and asked for more."""
    graph.start("identifier", sides="link")
    status = graph.status("identifier")
    graph.until(lambda: "samples received" in status, "the identifier listens")
    driver = Driver(graph, BEST_EFFORT)
    graph.until(lambda: driver.publish() or int(status["samples received"]) > 10, "samples arrive")


def test_the_recorder_listens_before_anybody_publishes(graph: Graph) -> None:
    """So that it keeps all that comes from the first moment on."""
    recorder = graph.start("recorder", bag=graph.folder / "bag")
    graph.until(lambda: "recording to" in recorder.output, "it says so")
    graph.until(lambda: graph.peer.count_subscribers("/joint_states") == 1, "it listens")
    driver = Driver(graph, STREAM)
    status = graph.status("recorder")
    for _ in range(COUNT):
        driver.publish()
    graph.until(lambda: int(status.get("/joint_states", 0)) == COUNT, "all are in the bag")
    assert recorder.stop() == 0
    assert len(list(read_messages(graph.folder / "bag", {"/joint_states"}))) == COUNT


def test_the_recorder_adapts_to_best_effort(graph: Graph) -> None:
    """Where it had asked for more before anybody published."""
    graph.start("recorder", bag=graph.folder / "bag")
    status = graph.status("recorder")
    graph.until(lambda: graph.peer.count_subscribers("/joint_states") == 1, "it listens")
    driver = Driver(graph, BEST_EFFORT)
    graph.until(
        lambda: driver.publish() or int(status.get("/joint_states", 0)) > 10, "they are in the bag"
    )
