"""FollowJointTrajectory on a real DDS graph, as MoveIt and other clients of
joint_trajectory_controller use it."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from ament_index_python import get_package_share_directory
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.nodes.support.graph import STREAM
from tests.helpers.ros_graph import Graph, NodeProcess, ros_graph

pytestmark = pytest.mark.graph

TEXTS = Path(__file__).parents[2] / "tools" / "interfaces" / "control_msgs"
JOINTS = ["joint_1", "joint_2", "joint_3"]
Result = FollowJointTrajectory.Result


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    with ros_graph(tmp_path_factory.mktemp("action")) as made:
        yield made


@pytest.fixture(scope="module")
def simulator(graph: Graph) -> NodeProcess:
    return graph.start("simulator", real_time_factor=0.5, torque_noise=0.0)


@pytest.fixture(scope="module")
def states(graph: Graph, simulator: NodeProcess) -> list[JointState]:
    return graph.listen(JointState, "/motor_states")


class Client:
    """Sends goals, and gathers what comes back."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._client = ActionClient(
            graph.peer, FollowJointTrajectory, "/simulator/follow_joint_trajectory"
        )
        graph.until(self._client.server_is_ready, "the action is offered")
        self.feedback: list[Any] = []

    def send(self, trajectory: JointTrajectory, **rest: Any) -> Any:
        """Return the handle of a goal once it is accepted."""
        goal = FollowJointTrajectory.Goal(trajectory=trajectory, **rest)
        future = self._client.send_goal_async(
            goal, feedback_callback=lambda m: self.feedback.append(m.feedback)
        )
        self._graph.until(future.done, "the goal is taken")
        assert future.result().accepted
        return future.result()

    def outcome(self, handle: Any) -> tuple[int, Any]:
        """Return status and result of a goal once it has ended."""
        future = handle.get_result_async()
        self._graph.until(future.done, "the goal ends")
        return future.result().status, future.result().result


@pytest.fixture
def client(graph: Graph, states: list[JointState]) -> Client:
    """A client of an arm that is back at rest at zero."""
    made = Client(graph)
    assert graph.call(Trigger, "/simulator/reset", Trigger.Request()).success
    # States from before the reset may still wait to be read, so what they say counts and not how
    # many have come.
    graph.until(
        lambda: len(states) > 50 and all(at_zero(state) for state in states[-50:]),
        "the arm stands at zero",
    )
    return made


def at_zero(state: JointState) -> bool:
    return bool(np.all(np.abs(state.position) < 0.05) and np.all(np.abs(state.velocity) < 0.05))


def to(
    *positions: float, seconds: int = 1, names: list[str] | None = None, **rest: list[float]
) -> JointTrajectory:
    point = JointTrajectoryPoint(
        positions=list(positions), time_from_start=Duration(sec=seconds), **rest
    )
    return JointTrajectory(joint_names=JOINTS if names is None else names, points=[point])


def test_a_goal_is_reached_and_its_course_is_fed_back(
    client: Client, states: list[JointState]
) -> None:
    """The arm goes there in the time given; feedback holds what is desired, what is, and the
    difference."""
    status, result = client.outcome(
        client.send(
            to(0.4, -0.2, 0.3, velocities=[0.0] * 3),
            path_tolerance=[JointTolerance(name=name, position=0.05) for name in JOINTS],
            goal_tolerance=[JointTolerance(name=name, position=0.01) for name in JOINTS],
            goal_time_tolerance=Duration(sec=5),
        )
    )
    assert (status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, Result.SUCCESSFUL), (
        result.error_string
    )
    np.testing.assert_allclose(states[-1].position, [0.4, -0.2, 0.3], atol=0.01)
    assert len(client.feedback) > 10
    middle = client.feedback[len(client.feedback) // 2]
    assert list(middle.joint_names) == JOINTS
    np.testing.assert_allclose(
        middle.error.positions,
        np.subtract(middle.desired.positions, middle.actual.positions),
        atol=1e-12,
    )
    assert 0.05 < middle.desired.positions[0] < 0.35


def test_a_cancelled_goal_leaves_the_arm_standing_where_it_is(
    graph: Graph, client: Client, states: list[JointState]
) -> None:
    """After cancel the arm slows down and stands, short of the goal."""
    handle = client.send(to(1.2, 0.0, 0.0, seconds=2, velocities=[0.0] * 3))
    graph.until(lambda: states[-1].position[0] > 0.3, "the arm is under way")
    future = handle.cancel_goal_async()
    status, result = client.outcome(handle)
    assert future.done()
    assert status == GoalStatus.STATUS_CANCELED, result.error_string
    count = len(states)
    graph.until(lambda: len(states) > count + 500, "half a second later")
    assert 0.3 < states[-1].position[0] < 0.9
    assert abs(states[-1].velocity[0]) < 0.01


def test_what_is_out_of_tolerance_is_aborted(
    graph: Graph, client: Client, states: list[JointState]
) -> None:
    """A path or a goal that cannot be kept so closely ends with JTC's code, joint and size; the arm
    stops."""
    tight = [JointTolerance(name="joint_2", position=1e-9)]
    status, result = client.outcome(client.send(to(0.5, 0.5, 0.5), path_tolerance=tight))
    assert (status, result.error_code) == (
        GoalStatus.STATUS_ABORTED,
        Result.PATH_TOLERANCE_VIOLATED,
    )
    assert "the position of joint_2 deviates by" in result.error_string
    assert states[-1].position[0] < 0.2
    brief = Duration(nanosec=50_000_000)
    again = client.send(to(0.1, 0.1, 0.1), goal_tolerance=tight, goal_time_tolerance=brief)
    status, result = client.outcome(again)
    assert (status, result.error_code) == (
        GoalStatus.STATUS_ABORTED,
        Result.GOAL_TOLERANCE_VIOLATED,
    )


def test_unusable_goals_are_refused_with_a_code(client: Client) -> None:
    """Unknown joints, limits and times that have passed end at once, in words."""
    past = to(0.1, 0.1, 0.1)
    past.header.stamp.nanosec = 1
    past.points[0].time_from_start = Duration(nanosec=1)
    cases = {
        Result.INVALID_JOINTS: (to(0.1, names=["joint_9"]), "names joint_9"),
        Result.INVALID_GOAL: (to(3.0, 0.0, 0.0), "beyond the limit of 1.5 rad/s"),
        Result.OLD_HEADER_TIMESTAMP: (past, "is in the past"),
    }
    for code, (trajectory, words) in cases.items():
        status, result = client.outcome(client.send(trajectory))
        assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, code)
        assert words in result.error_string


def test_the_last_goal_counts(graph: Graph, client: Client, states: list[JointState]) -> None:
    """A goal gives way to another one, and to a message on ~/joint_trajectory; both are for some
    joints alone."""
    first = client.send(to(1.0, 0.0, 0.0, seconds=3, velocities=[0.0] * 3))
    second = client.send(to(0.5, seconds=3, names=["joint_2"]))
    status, result = client.outcome(first)
    assert (status, "another goal" in result.error_string) == (GoalStatus.STATUS_ABORTED, True)
    output = graph.peer.create_publisher(JointTrajectory, "/simulator/joint_trajectory", STREAM)
    graph.until(output.get_subscription_count, "the arm listens")
    output.publish(to(0.2, names=["joint_3"]))
    status, result = client.outcome(second)
    assert (status, "another motion" in result.error_string) == (GoalStatus.STATUS_ABORTED, True)
    graph.until(lambda: abs(states[-1].position[2] - 0.2) < 1e-3, "the last one is reached")


def test_types_are_those_of_control_msgs() -> None:
    """The hashes by which nodes recognise a type are those that an independent reader makes of
    control_msgs' fields.

    The texts are those of ros-controls/control_msgs, branch jazzy; where a distribution brings the
    package, its own.
    """
    share = Path(get_package_share_directory("control_msgs"))
    described = json.loads((share / "action" / "FollowJointTrajectory.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in described["type_hashes"]}
    types = get_typestore(Stores.ROS2_JAZZY)
    texts = {
        f"control_msgs/msg/{name}": (TEXTS / "msg" / f"{name}.msg").read_text()
        for name in ("JointTolerance", "JointComponentTolerance")
    }
    text = (TEXTS / "action" / "FollowJointTrajectory.action").read_text()
    parts = re.sub(r"^(?=Joint\w*Tolerance)", "control_msgs/", text, flags=re.MULTILINE).split(
        "---\n"
    )
    texts |= {
        f"control_msgs/action/FollowJointTrajectory_{name}": part
        for name, part in zip(("Goal", "Result", "Feedback"), parts, strict=True)
    }
    for name, text in texts.items():
        types.register(get_types_from_msg(text, name))
    for name in texts:
        assert hashes[name] == types.hash_rihs01(name), name
