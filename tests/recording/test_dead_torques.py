"""Torques that hold one value were not recorded; of one joint, that is certain while it moves."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.dead_torques import without_dead_torques
from elastic_arm.recording.sides import joints_with
from tests.helpers.bags import two_sided
from tests.helpers.random_arms import random_arm

ROBOT = random_arm(3, np.random.default_rng(0))


def constant_at(joints: list[int], value: float, *, rests: bool = False) -> Recording:
    """Return a recording of three joints with a constant motor torque at some of them."""
    found = two_sided(np.random.default_rng(0), 600)
    motor = found.motor
    assert motor is not None and motor.effort is not None and motor.position is not None
    effort = motor.effort.copy()
    effort[:, joints] = value
    link = found.link
    if rests:
        position = motor.position.copy()
        position[:, joints] = 0.2
        motor = replace(motor, position=position)
        link = None
    return replace(found, link=link, motor=replace(motor, effort=effort))


def torques(recording: Recording) -> list[bool]:
    motor = recording.motor
    assert motor is not None and motor.effort is not None
    return joints_with(motor.effort).tolist()


@pytest.mark.parametrize("value", [0.0, -1.5])
def test_a_constant_torque_of_a_moving_joint_counts_as_not_recorded(value: float) -> None:
    """The other joints keep theirs, and a note names the joint."""
    found, dead = without_dead_torques(constant_at([1], value), ROBOT)
    assert torques(found) == [True, False, True] and not dead
    (note,) = found.notes
    assert "motor torque (effort of the motor side) of joint_2 is constant while" in note


def test_a_constant_torque_of_a_joint_at_rest_is_kept() -> None:
    """It may be true, and is named as unreliable."""
    found, dead = without_dead_torques(constant_at([1], 0.0, rests=True), ROBOT)
    assert torques(found) == [True] * 3 and not dead
    assert found.notes[0].endswith("of joint_2 is constant: results for them are unreliable.")


def test_a_slide_moves_for_certain_over_a_shorter_way() -> None:
    """Over 2 cm the constant torque of a slide counts as not recorded, and over 0.02 rad that of a
    turning joint is kept."""
    short = constant_at([1], 0.0)
    sides = {}
    for name, side in short.measured().items():
        assert side.position is not None
        span = np.ptp(side.position[:, 1])
        sides[name] = replace(side, position=side.position * [1.0, 0.02 / span, 1.0])
    short = replace(short, link=sides["link"], motor=sides["motor"])
    slides = ROBOT.with_joint(ROBOT.joint_names[1], prismatic=True)
    assert torques(without_dead_torques(short, slides)[0]) == [True, False, True]
    assert torques(without_dead_torques(short, ROBOT)[0]) == [True] * 3


def test_torques_that_are_constant_at_all_joints_are_no_channel() -> None:
    """The channel is left out as a whole; a recording with torques is returned as it is."""
    found, dead = without_dead_torques(constant_at([0, 1, 2], 0.0), ROBOT)
    assert found.motor is not None and found.motor.effort is None
    assert dead == ("motor torque (effort of the motor side)",)
    whole = two_sided(np.random.default_rng(0), 600)
    assert without_dead_torques(whole, ROBOT) == (whole, ())


def test_a_joint_without_positions_is_named() -> None:
    """By its name, with what to do."""
    recording = two_sided(np.random.default_rng(0), 600)
    sides = {}
    for name, side in recording.measured().items():
        assert side.position is not None
        position = side.position.copy()
        position[:, 2] = np.nan
        sides[name] = replace(side, position=position)
    bare = replace(recording, link=sides["link"], motor=sides["motor"])
    with pytest.raises(RecordingError, match="no positions of joint_3 were recorded on either"):
        bare.samples()
