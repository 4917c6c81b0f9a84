"""Units that were mistaken show in sizes that no arm has; arms within their limits are not
blamed."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.recording import Recording, Side
from elastic_arm.recording.inspection.magnitudes import beyond_limits, hardly_usable
from elastic_arm.robot import Robot
from elastic_arm.robot.parts import Limits
from tests.helpers.random_arms import random_arm

T = np.arange(0.0, 4.0, 0.005)[:, None]
W = np.array([1.0, 1.5, 2.0])


def arm() -> Robot:
    """Three joints, the last of which turns without limits."""
    robot = random_arm(3, np.random.default_rng(1), elastic=False)
    bounds = [
        Limits(-2.0, 2.0, velocity=2.0),
        Limits(-1.0, 2.5, velocity=2.0),
        Limits(velocity=2.0),
    ]
    for joint, limits in zip(robot.joints, bounds, strict=True):
        robot = robot.with_joint(joint.name, limits=limits)
    return robot


def recorded(size: float = 1.0, zero: float = 0.0, step_ns: int = 5_000_000) -> Recording:
    """Sines of 1 rad, with their velocities."""
    stamp_ns = 10**18 + step_ns * np.arange(len(T), dtype=np.int64)
    return Recording(
        arm().joint_names,
        link=Side(stamp_ns, size * np.sin(W * T) + zero, size * W * np.cos(W * T)),
    )


@pytest.mark.parametrize("zero", [0.0, 2 * np.pi, -4 * np.pi])
def test_an_arm_within_its_limits_is_not_blamed(zero: float) -> None:
    """Angles that are given by other whole turns are within, too."""
    assert beyond_limits(recorded(zero=zero), arm()) == []


def test_degrees_taken_as_radians_are_beyond_all_limits() -> None:
    """The positions of joints with a range, and the velocities of all."""
    position, velocity = beyond_limits(recorded(180 / np.pi), arm())
    assert position.message.startswith("link position of joint_1, joint_2 exceeds the limits")
    assert (
        "after division by 57.3 all are within: check the unit (degrees taken as radians)"
        in position.message
    )
    assert (
        "velocity of all joints" in velocity.message
        and "degrees taken as radians" in velocity.message
    )


def test_a_zero_that_is_off_is_no_unit() -> None:
    """Angles beyond the limits by an offset."""
    (finding,) = beyond_limits(recorded(zero=1.9), arm())
    assert "check units, columns and zeros (offset)" in finding.message


def test_a_rail_in_millimetres_is_named() -> None:
    """Its limits are lengths."""
    robot = arm()
    robot = replace(robot, joints=(replace(robot.joints[0], prismatic=True), *robot.joints[1:]))
    recording = recorded()
    given = replace(recording.link, position=recording.link.position * [1000.0, 1.0, 1.0])
    (finding,) = beyond_limits(replace(recording, link=given), robot)
    assert (
        "to 1e+03 m, its limits are -2 to 2" in finding.message and "millimetres" in finding.message
    )


def test_a_recording_that_can_hardly_be_used_says_so() -> None:
    """Few samples, joints without positions; of a whole one nothing."""
    whole = recorded()
    assert hardly_usable(whole) == []
    (few,) = hardly_usable(replace(whole, link=whole.link.at(slice(5))))
    assert few.startswith("only 5 samples")
    (none,) = hardly_usable(replace(whole, link=replace(whole.link, position=None)))
    assert none.startswith("no position of any joint")
    lacking = whole.link.position * [1.0, np.nan, 1.0]
    (some,) = hardly_usable(replace(whole, link=replace(whole.link, position=lacking)))
    assert some.startswith("no position of joint_2")
