"""Identifier and gap monitor as lifecycle nodes: started, stopped and emptied from outside."""

from __future__ import annotations

from pathlib import Path

import pytest
from elastic_arm_msgs.msg import ParameterEstimate
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState

from tests.helpers.motions import lively_excitation
from tests.helpers.ros_graph import Graph

pytestmark = pytest.mark.graph

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE


def state(graph: Graph, node: str) -> str:
    label: str = graph.call(GetState, f"/{node}/get_state", GetState.Request()).current_state.label
    return label


def change(graph: Graph, node: str, transition: int) -> tuple[bool, str]:
    """Ask for a transition; return whether it was made, and the state after it."""
    request = ChangeState.Request(transition=Transition(id=transition))
    return graph.call(ChangeState, f"/{node}/change_state", request).success, state(graph, node)


def listens(graph: Graph, node: str) -> bool:
    """Return whether a node subscribes to the arm's samples."""
    return any(info.node_name == node for info in graph.peer.get_subscriptions_info_by_topic("/motor_states"))


def start_moving_arm(graph: Graph) -> None:
    graph.start("simulator", real_time_factor=0.5, rate=500.0)
    motion = lively_excitation(graph.folder, 60.0)
    graph.start("trajectory_generator", trajectory=motion, use_sim_time=True)


def test_the_identifier_is_managed(graph: Graph) -> None:
    """It estimates while it is active, and only then; what it had found stays until it is cleaned up."""
    estimates: list[ParameterEstimate] = graph.listen(ParameterEstimate, "/parameter_estimate")
    node = graph.start("identifier", autostart=False)
    start_moving_arm(graph)
    assert state(graph, "identifier") == "unconfigured"
    assert change(graph, "identifier", CONFIGURE) == (True, "inactive")
    graph.until(lambda: graph.peer.count_publishers("/parameter_estimate"), "estimates are offered")
    assert not estimates and not listens(graph, "identifier")
    assert change(graph, "identifier", ACTIVATE) == (True, "active")
    graph.until(lambda: len(estimates) > 1, "estimates")
    assert change(graph, "identifier", DEACTIVATE) == (True, "inactive")
    graph.until(lambda: not listens(graph, "identifier"), "it has unsubscribed")
    known = estimates[-1].samples
    count = len(estimates)
    assert change(graph, "identifier", ACTIVATE) == (True, "active")
    graph.until(lambda: len(estimates) > count and estimates[-1].samples > known, "it goes on from what it had")
    assert change(graph, "identifier", DEACTIVATE)[0] and change(graph, "identifier", CLEANUP) == (True, "unconfigured")
    graph.until(lambda: graph.peer.count_publishers("/parameter_estimate") == 0, "estimates are no longer offered")
    count = len(estimates)
    for transition in (CONFIGURE, ACTIVATE):
        assert change(graph, "identifier", transition)[0]
    graph.until(lambda: len(estimates) > count, "estimates again")
    assert estimates[count].samples < estimates[count - 1].samples, "what was known before is forgotten"
    shutdown = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN))
    assert graph.call(ChangeState, "/identifier/change_state", shutdown).success
    assert node.wait() == 0, node.output
    assert "Traceback" not in node.output


def test_the_gap_monitor_is_managed(graph: Graph) -> None:
    """Each transition is made, also a second time round, and the process that diagnoses goes with the cleaning up."""
    node = graph.start("gap_monitor", autostart=False)
    for _ in range(2):
        for transition, after in ((CONFIGURE, "inactive"), (ACTIVATE, "active")):
            assert change(graph, "gap_monitor", transition) == (True, after)
        assert children(node.process.pid)
        graph.until(lambda: listens(graph, "gap_monitor"), "it listens")
        for transition, after in ((DEACTIVATE, "inactive"), (CLEANUP, "unconfigured")):
            assert change(graph, "gap_monitor", transition) == (True, after)
        graph.until(lambda: graph.peer.count_publishers("/gap") == 0, "nothing is offered any more")
        graph.until(lambda: not children(node.process.pid), "the process has ended")
    assert node.stop() == 0, node.output
    assert "Traceback" not in node.output


def children(pid: int) -> list[str]:
    """Return the children of a process that are no helpers of multiprocessing."""
    found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    commands = {child: Path(f"/proc/{child}/cmdline").read_bytes() for child in found}
    return [child for child, command in commands.items() if b"resource_tracker" not in command]


def test_a_mistake_keeps_the_node_unconfigured(graph: Graph) -> None:
    """What is wrong with the parameters is one line of the log; node and process live."""
    mistakes = {"identifier": {"effects": "['frictoin']"}, "gap_monitor": {"known": "['frictoin']"}}
    nodes = {name: graph.start(name, autostart=False, **parameters) for name, parameters in mistakes.items()}
    for name, started in nodes.items():
        assert change(graph, name, CONFIGURE) == (False, "unconfigured")
        (line,) = [line for line in started.output.splitlines() if "[ERROR]" in line]
        assert "frictoin" in line
        assert "Traceback" not in started.output
        assert started.stop() == 0
