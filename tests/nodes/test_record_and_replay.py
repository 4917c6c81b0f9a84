"""Recorder and replayer on a real DDS graph: any topic, several files, and the services of rosbag2's player."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from builtin_interfaces.msg import Time
from control_msgs.msg import JointTolerance
from rosbag2_interfaces.srv import Burst, IsPaused, Pause, PlayNext, Resume, Seek, SetRate, SplitBagfile
from std_msgs.msg import String

from elastic_arm.nodes.support.graph import LATCHED, STREAM
from elastic_arm.recording.storage.messages import read_messages, read_topics
from tests.helpers.ros_graph import Graph, ros_graph

pytestmark = pytest.mark.graph


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    with ros_graph(tmp_path_factory.mktemp("bags")) as made:
        yield made


@pytest.fixture(scope="module")
def bag(graph: Graph) -> Path:
    """A bag of foreign topics, split by the service after five of ten messages."""
    recorder = graph.start("recorder", bag=graph.folder / "bag", all=True)
    latched = graph.peer.create_publisher(String, "/robot_description", LATCHED)
    output = graph.peer.create_publisher(JointTolerance, "/foreign/tolerance", STREAM)
    latched.publish(String(data="<robot/>"))
    found = (latched.get_subscription_count, output.get_subscription_count)
    graph.until(lambda: all(count() for count in found), "the recorder has found the topics")
    for k in range(10):
        if k == 5:
            graph.call(SplitBagfile, "/recorder/split_bagfile", SplitBagfile.Request())
        output.publish(JointTolerance(name="joint_1", position=float(k)))
        end = time.monotonic() + 0.05
        graph.until(lambda end=end: time.monotonic() > end, "a moment has passed")
    graph.call(Pause, "/recorder/pause", Pause.Request())
    output.publish(JointTolerance(name="left out"))
    assert graph.call(IsPaused, "/recorder/is_paused", IsPaused.Request()).paused
    assert recorder.stop() == 0
    graph.peer.destroy_publisher(latched)
    graph.peer.destroy_publisher(output)
    return graph.folder / "bag"


def test_any_topic_is_recorded_into_several_files(bag: Path) -> None:
    """Types that are not the suite's are kept with their definition, and metadata.yaml lists both files."""
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap"]
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts["/foreign/tolerance"] == 10
    assert len(list(read_messages(bag, {"/foreign/tolerance"}))) == 10
    (topic,) = [topic for topic in read_topics(bag) if topic.name == "/foreign/tolerance"]
    assert "float64 acceleration" in topic.definition


def test_a_replay_is_stopped_stepped_and_moved(graph: Graph, bag: Path) -> None:
    """From an offset, paused, it plays single messages, jumps, and goes on; what is latched is there all the same."""
    heard = graph.listen(JointTolerance, "/foreign/tolerance")
    latched = graph.listen(String, "/robot_description")
    stamps = [message.log_ns for message in read_messages(bag, {"/foreign/tolerance"})]
    first_ns = next(message.log_ns for message in read_messages(bag, {"/foreign/tolerance", "/robot_description"}))
    offset = (stamps[2] - 1_000_000 - first_ns) * 1e-9
    topics = "['/foreign/tolerance', '/robot_description']"
    replayer = graph.start("replayer", bag=bag, topics=topics, start_offset=offset, start_paused=True, clock=False)
    graph.until(lambda: latched, "the latched topic is there")
    assert graph.call(IsPaused, "/replayer/is_paused", IsPaused.Request()).paused
    assert graph.call(PlayNext, "/replayer/play_next", PlayNext.Request()).success
    assert graph.call(Burst, "/replayer/burst", Burst.Request(num_messages=2)).actually_burst == 2
    graph.until(lambda: len(heard) == 3, "three messages have come")
    begun = heard[0].position
    assert begun == 2.0
    assert [message.position for message in heard] == [begun, begun + 1, begun + 2]
    assert not graph.call(Seek, "/replayer/seek", Seek.Request(time=Time(sec=1))).success
    sec, nanosec = divmod(stamps[0], 10**9)
    assert graph.call(Seek, "/replayer/seek", Seek.Request(time=Time(sec=sec, nanosec=nanosec))).success
    assert graph.call(SetRate, "/replayer/set_rate", SetRate.Request(rate=2.0)).success
    assert not graph.call(SetRate, "/replayer/set_rate", SetRate.Request(rate=-1.0)).success
    graph.call(Resume, "/replayer/resume", Resume.Request())
    graph.until(lambda: replayer.process.poll() is not None, "the bag ends")
    assert replayer.process.returncode == 0, replayer.output
    graph.until(lambda: len(heard) == 13, "the whole bag has come")
    assert [message.position for message in heard[3:]] == [float(k) for k in range(10)]
