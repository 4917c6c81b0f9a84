"""Recorder and replayer on a real DDS graph: topics of any type, what is latched, and a disk that
fills up."""

import time
from pathlib import Path

import numpy as np
import pytest
from control_msgs.msg import JointTolerance
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from elastic_arm.nodes.support.graph import LATCHED, STREAM
from elastic_arm.recording import read_recording
from elastic_arm.recording.storage.messages import read_topics
from tests.helpers.ros_graph import Graph, ros_graph
from tests.helpers.small_disk import mounted

pytestmark = pytest.mark.graph


def test_a_topic_of_any_type_is_recorded_and_played_back(graph: Graph) -> None:
    """A type that is not the suite's is kept with its definition; every message comes back in
    order."""
    topics = "['/foreign/tolerance', '/robot_description']"
    recorder = graph.start("recorder", bag=graph.folder / "bag", topics=topics)
    latched = graph.peer.create_publisher(String, "/robot_description", LATCHED)
    output = graph.peer.create_publisher(JointTolerance, "/foreign/tolerance", STREAM)
    latched.publish(String(data="<robot/>"))
    found = (latched.get_subscription_count, output.get_subscription_count)
    graph.until(lambda: all(count() for count in found), "the recorder has found the topics")
    for k in range(10):
        output.publish(JointTolerance(name="joint_1", position=float(k)))
        end = time.monotonic() + 0.02
        graph.until(lambda end=end: time.monotonic() > end, "a moment has passed")
    assert recorder.stop() == 0
    graph.peer.destroy_publisher(latched)
    graph.peer.destroy_publisher(output)
    (topic,) = [
        topic for topic in read_topics(graph.folder / "bag") if topic.name == "/foreign/tolerance"
    ]
    assert "float64 acceleration" in topic.definition
    heard = graph.listen(JointTolerance, "/foreign/tolerance")
    told = graph.listen(String, "/robot_description")
    replayer = graph.start("replayer", bag=graph.folder / "bag", topics=topics, clock=False)
    graph.until(lambda: replayer.process.poll() is not None, "the bag ends")
    assert replayer.process.returncode == 0, replayer.output
    graph.until(lambda: told and len(heard) == 10, "the whole bag has come")
    assert [message.position for message in heard] == [float(k) for k in range(10)]


def test_a_disk_that_fills_up_ends_the_recorder_alone(tmp_path: Path) -> None:
    """It ends with one line and code 2, what was written is read again, and the arm goes on."""
    with mounted(tmp_path / "disk", 300) as disk, ros_graph(tmp_path) as graph:
        heard = graph.listen(JointState, "/motor_states")
        recorder = graph.start("recorder", bag=disk / "bag")
        simulator = graph.start("simulator", rate=500.0)
        graph.until(lambda: recorder.process.poll() is not None, "the disk is full")
        assert recorder.process.returncode == 2
        (line,) = [line for line in recorder.output.splitlines() if "recording to" not in line]
        assert line.startswith("error: ") and "No space left on device" in line
        motor = read_recording(disk / "bag").motor
        assert len(motor) > 500
        assert set(np.diff(motor.stamp_ns)) == {2_000_000}
        count = len(heard)
        graph.until(lambda: len(heard) > count + 100, "the arm goes on")
        assert simulator.stop() == 0
