"""Two arms on one DDS graph, each in a namespace of its own."""

from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from elastic_arm.recording import read_recording
from tests.helpers.motions import lively_excitation
from tests.helpers.ros_graph import Graph, NodeProcess

pytestmark = pytest.mark.graph

CONFIG = Path(__file__).parents[2] / "config" / "elastic_arm.yaml"
RATE = 200.0


def start_in(graph: Graph, namespace: str, node: str, **parameters: object) -> NodeProcess:
    """Start a node as the launch files do: in a namespace, with the parameters of the package."""
    return graph.start(
        node, "-r", f"__ns:=/{namespace}", "--params-file", str(CONFIG), **parameters
    )


def test_two_arms_do_not_meet(graph: Graph) -> None:
    """Topics, references, bags and diagnostics of /left and /right are apart; a third arm in /left
    is refused."""
    heard = {name: graph.listen(JointState, f"/{name}/joint_states") for name in ("left", "right")}
    status: list[DiagnosticArray] = graph.listen(DiagnosticArray, "/diagnostics")
    # Two arms and all that listens to them on a busy machine: at 1 kHz it would hold them up.
    start_in(graph, "left", "simulator", seed=1, rate=RATE)
    start_in(graph, "right", "simulator", initial_position="[0.4]", rate=RATE)
    recorder = start_in(graph, "left", "recorder", bag=graph.folder / "bag")
    graph.until(lambda: min(map(len, heard.values())) > 100, "both arms are there")
    generator = start_in(
        graph, "left", "trajectory_generator", trajectory=lively_excitation(graph.folder, 2.0)
    )
    graph.until(lambda: generator.process.poll() is not None, "the motion ends")
    assert generator.process.returncode == 0
    graph.until(
        lambda: any(abs(m.position[0]) > 0.2 for m in heard["left"]),
        "an arm that is behind has moved",
    )
    assert recorder.stop() == 0
    recording = read_recording(graph.folder / "bag")
    assert recording.source.endswith("(/left)")
    assert recording.reference is not None
    assert recording.robot_description
    assert np.ptp(recording.link.position) > 0.1
    assert np.ptp([list(m.position) for m in heard["right"]], axis=0).max() < 1e-3
    assert {m.header.frame_id for m in heard["right"]} == {"right/base"}
    by_name = {array.status[0].name: array.status[0] for array in status}
    assert {"left/simulator: pace", "right/simulator: pace", "left/recorder: bag"} <= set(by_name)
    assert by_name["right/simulator: pace"].hardware_id == "right"
    assert not any("publishes" in array.status[0].message for array in status)
    assert not graph.peer.count_publishers("/joint_states")
    third = start_in(graph, "left", "simulator")
    assert third.wait() == 2
    assert "/left/simulator already publishes /left/motor_states" in third.output


def test_two_clocks_in_one_graph_are_refused(graph: Graph) -> None:
    """A second arm with a clock of its own ends, whatever its namespace: all arms of a graph share
    /clock."""
    heard = graph.listen(JointState, "/left/joint_states")
    start_in(graph, "left", "simulator", real_time_factor=0.5, rate=RATE)
    graph.until(lambda: len(heard) > 100, "the first arm is there")
    second = start_in(graph, "right", "simulator", real_time_factor=0.5)
    assert second.wait() == 2
    assert "/left/simulator already publishes /clock" in second.output
    assert "real_time_factor:=1.0" in second.output


def test_a_renamed_topic_raises_no_alarm(graph: Graph) -> None:
    """An arm whose topic is remapped by hand is not taken for another one that publishes it."""
    heard = graph.listen(JointState, "/drives")
    status: list[DiagnosticArray] = graph.listen(DiagnosticArray, "/diagnostics")
    simulator = graph.start("simulator", "-r", "motor_states:=/drives", real_time_factor=0.5)
    graph.until(lambda: len(heard) > 100 and len(status) > 2, "the arm is there")
    assert simulator.stop() == 0
    assert not any("publishes" in array.status[0].message for array in status)
    sec = [array.header.stamp.sec for array in status]
    assert max(sec) < 60, "diagnostics carry the arm's time, not the time of day"
