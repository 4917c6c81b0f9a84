"""Messages of the reference: what is followed, and what is refused in words."""

from collections.abc import Callable

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from elastic_arm.errors import GraphError
from elastic_arm.nodes.following.reference_message import reference_points

JOINTS = ("a", "b", "c")


def message(*positions: list[float], names: tuple[str, ...] = JOINTS) -> JointTrajectory:
    """Points of positions, a millisecond apart."""
    points = [
        JointTrajectoryPoint(positions=row, time_from_start=Duration(nanosec=1_000_000 * k))
        for k, row in enumerate(positions)
    ]
    return JointTrajectory(joint_names=list(names), points=points)


def test_points_come_in_the_order_of_the_arm() -> None:
    """Names may come in any order and with further joints; velocities that are not given are
    zero."""
    sent = message([3.0, 9.0, 1.0, 2.0], [6.0, 9.0, 4.0, 5.0], names=("c", "gripper", "a", "b"))
    points = reference_points(sent, JOINTS)
    assert points.stamps.tolist() == [0, 1_000_000]
    np.testing.assert_array_equal(points.row.position, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(points.row.velocity, np.zeros((2, 3)))


def with_field(field: str, values: list[float]) -> JointTrajectory:
    sent = message([1.0, 2.0, 3.0])
    setattr(sent.points[0], field, values)
    return sent


def at_one_time() -> JointTrajectory:
    sent = message([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    sent.points[1].time_from_start = Duration()
    return sent


BAD: dict[str, tuple[Callable[[], JointTrajectory], str]] = {
    "three names and one position": (
        lambda: message([1.0]),
        "has 1 positions for 3 joints in point 0",
    ),
    "ragged": (
        lambda: message([1.0, 2.0, 3.0], [1.0, 2.0]),
        "has 2 positions for 3 joints in point 1",
    ),
    "no points": (message, "contains no points"),
    "no names": (lambda: message([], names=()), "names no joint"),
    "other names": (lambda: message([1.0, 2.0, 3.0], names=("a", "b", "d")), "names a, b, d"),
    "more names than positions": (
        lambda: message([1.0, 2.0, 3.0], names=(*JOINTS, "d")),
        "3 positions for 4 joints",
    ),
    "a name twice": (
        lambda: message([1.0, 2.0, 3.0, 4.0], names=(*JOINTS, "a")),
        "names a, b, c, a",
    ),
    "velocities of another length": (lambda: with_field("velocities", [1.0]), "has 1 velocities"),
    "velocities alone": (lambda: with_field("positions", []), "has 0 positions"),
    "not a number": (lambda: message([1.0, float("nan"), 3.0]), "not finite"),
    "infinite acceleration": (
        lambda: with_field("accelerations", [0.0, 0.0, float("inf")]),
        "not finite",
    ),
    "a huge number": (lambda: message([1.0, 1e308, 3.0]), "has a value of 1e.308"),
    "a huge velocity": (
        lambda: with_field("velocities", [0.0, -1e200, 0.0]),
        "has a value of 1e.200",
    ),
    "too many points": (lambda: message(*[[1.0, 2.0, 3.0]] * 20_001), "contains 20001 points"),
    "a name of codes": (
        lambda: message([1.0, 2.0, 3.0], names=("a", "b", "\x1b[31m" * 9999)),
        "names a, b",
    ),
    "two points at one time": (at_one_time, "do not increase"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_followed_is_refused_in_words(name: str) -> None:
    """Every malformed message is an error of the library, which the node counts, and nothing
    else."""
    make, words = BAD[name]
    with pytest.raises(GraphError, match=words):
        reference_points(make(), JOINTS)
