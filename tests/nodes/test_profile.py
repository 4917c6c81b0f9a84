"""The profile of Fast DDS that the suite's nodes start with."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from sensor_msgs.msg import JointState

from elastic_arm.nodes.support.running import PROFILE, PROFILE_VARIABLE, run
from tests.helpers.ros_graph import ros_graph

LONGEST = 0.1  # seconds that a reader may wait to learn what it has missed


def test_writers_send_heartbeats_often() -> None:
    """In the default profile of writers, which is the one that ROS's publishers begin with."""
    space = {"p": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
    writer = ET.parse(PROFILE).getroot().find("p:data_writer[@is_default_profile='true']", space)
    assert writer is not None
    seconds, nanoseconds = (
        writer.findtext(f"p:times/p:heartbeatPeriod/p:{unit}", namespaces=space) for unit in ("sec", "nanosec")
    )
    assert 0.0 < int(seconds or 0) + int(nanoseconds or 0) / 1e9 <= LONGEST


def test_a_profile_of_the_user_s_own_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The nodes' profile is set where there is none, and never instead of another."""

    def ended() -> None:
        raise SystemExit

    for before, after in (("/mine.xml", "/mine.xml"), (None, str(PROFILE))):
        if before is None:
            monkeypatch.delenv(PROFILE_VARIABLE)
        else:
            monkeypatch.setenv(PROFILE_VARIABLE, before)
        monkeypatch.setattr("rclpy.init", lambda **_: ended())
        monkeypatch.setattr("elastic_arm.nodes.support.running._Stop", lambda: None)
        with pytest.raises(SystemExit):
            run(lambda: pytest.fail("no node is made"), [])
        assert os.environ[PROFILE_VARIABLE] == after


@pytest.mark.graph
def test_fast_dds_takes_the_profile(tmp_path: Path) -> None:
    """A node starts with it and publishes, and Fast DDS reports no mistake in it."""
    with ros_graph(tmp_path) as graph:
        heard = graph.listen(JointState, "/joint_states")
        simulator = graph.start("simulator")
        graph.until(lambda: heard, "the arm is there")
        assert simulator.stop() == 0
        assert "XMLPARSER" not in simulator.output
