"""How the nodes' samples travel, and the profiles of Fast DDS that they start with."""

import signal
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from sensor_msgs.msg import JointState

from elastic_arm.nodes.transport import (
    LOCALHOST_VARIABLE,
    LOOPBACK_PROFILE,
    PEERS_VARIABLE,
    PROFILE,
    PROFILE_VARIABLE,
    RANGE_VARIABLE,
    TRANSPORTS_VARIABLE,
    choose_transport,
)
from tests.helpers.bags import holds_samples
from tests.helpers.ros_graph import NodeProcess, ros_graph

LONGEST = 0.1  # seconds that a reader may wait to learn what it has missed
SPACE = {"p": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
LOOPBACK = {PROFILE_VARIABLE: str(LOOPBACK_PROFILE), RANGE_VARIABLE: "SYSTEM_DEFAULT"}


def shared_memory_of(node: NodeProcess) -> set[str]:
    """Return the files of shared memory that a node's Fast DDS has mapped."""
    maps = Path(f"/proc/{node.process.pid}/maps").read_text()
    return {
        line.split()[-1] for line in maps.splitlines() if "fastrtps" in line and "/dev/shm" in line
    }


@pytest.mark.parametrize("profile", [PROFILE, LOOPBACK_PROFILE])
def test_writers_send_heartbeats_often(profile: Path) -> None:
    """In the default profile of writers, which is the one that ROS's publishers begin with."""
    writer = ET.parse(profile).getroot().find("p:data_writer[@is_default_profile='true']", SPACE)
    seconds, nanoseconds = (
        writer.findtext(f"p:times/p:heartbeatPeriod/p:{unit}", namespaces=SPACE)
        for unit in ("sec", "nanosec")
    )
    assert 0.0 < int(seconds or 0) + int(nanoseconds or 0) / 1e9 <= LONGEST


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, {PROFILE_VARIABLE: str(PROFILE), TRANSPORTS_VARIABLE: "UDPv4"}),
        (
            {RANGE_VARIABLE: "SUBNET"},
            {
                RANGE_VARIABLE: "SUBNET",
                PROFILE_VARIABLE: str(PROFILE),
                TRANSPORTS_VARIABLE: "UDPv4",
            },
        ),
        ({RANGE_VARIABLE: "LOCALHOST"}, LOOPBACK),
        ({LOCALHOST_VARIABLE: "1"}, LOOPBACK),
    ],
)
def test_no_range_of_discovery_takes_shared_memory(
    before: dict[str, str], after: dict[str, str]
) -> None:
    """Variables that the user has not set are set so that samples travel by UDP."""
    choose_transport(before)
    assert before == after


@pytest.mark.parametrize(
    "chosen",
    [{PROFILE_VARIABLE: "/mine.xml"}, {TRANSPORTS_VARIABLE: "SHM"}, {PEERS_VARIABLE: "10.0.0.7"}],
)
def test_the_user_s_own_settings_count(chosen: dict[str, str]) -> None:
    """A profile, transports and static peers of the user's stay, and the range of discovery with
    them."""
    environment = {RANGE_VARIABLE: "LOCALHOST", **chosen}
    choose_transport(environment)
    assert {**environment, RANGE_VARIABLE: "LOCALHOST", **chosen} == environment


@pytest.mark.graph
def test_a_killed_recorder_holds_no_lock_of_the_arm_s(tmp_path: Path) -> None:
    """Nodes meet, Fast DDS reports no mistake in its profile, and no process maps memory that
    outlives another."""
    with ros_graph(tmp_path) as graph:
        heard = graph.listen(JointState, "/joint_states")
        simulator = graph.start("simulator")
        recorder = graph.start("recorder", bag=tmp_path / "bag")
        graph.until(lambda: heard, "the arm is there")
        graph.until(lambda: holds_samples(tmp_path / "bag"), "the recorder has met it")
        assert shared_memory_of(simulator) == shared_memory_of(recorder) == set()
        recorder.process.send_signal(signal.SIGKILL)
        recorder.wait()
        killed = time.monotonic()
        before = len(heard)
        graph.until(lambda: len(heard) > before + 100, "the arm goes on", patience=30.0)
        assert time.monotonic() - killed < 30.0
        assert simulator.stop() == 0
        assert "XMLPARSER" not in simulator.output


@pytest.mark.graph
def test_nodes_of_a_whole_subnet_take_no_shared_memory(tmp_path: Path) -> None:
    """Also where rmw_fastrtps leaves the transports to Fast DDS."""
    with ros_graph(tmp_path) as graph:
        graph.env[RANGE_VARIABLE] = "SUBNET"
        simulator = graph.start("simulator", rate=100.0)
        recorder = graph.start("recorder", bag=tmp_path / "bag")
        graph.until(lambda: holds_samples(tmp_path / "bag"), "the recorder has met it")
        assert shared_memory_of(simulator) == shared_memory_of(recorder) == set()
        assert recorder.stop() == 0 == simulator.stop()
        assert "XMLPARSER" not in simulator.output
