"""Angles that are given against the joint before, as drives over a parallelogram report them."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.recording import Recording, read_recording
from elastic_arm.recording.inspection.arrangements import COUPLED
from elastic_arm.recording.inspection.described_gravity import contradicted
from elastic_arm.recording.inspection.side_motion import side_motions
from elastic_arm.recording.sides import Side
from elastic_arm.robot import Robot, load_robot
from tests.helpers.clean_recordings import clean_arm, sines
from tests.helpers.nightly import nightly
from tests.helpers.shared_data import DATA, needs_data

REPORTS = DATA / "public_reports_2" / "coupled_j2_j3"


def named(recording: Recording, robot: Robot) -> list[str]:
    """Return what is said of coupled angles."""
    found = contradicted([*side_motions(recording, robot)], robot)
    assert all(one.code == COUPLED for one in found)
    return [one.message for one in found]


@needs_data
@pytest.mark.parametrize("run", ["s_coup_1", "s_coup_2"])
def test_an_angle_against_the_horizontal_is_named(run: str) -> None:
    """The line of the map is in the message, and torques are those of the joints."""
    (words,) = named(read_recording(REPORTS / run), load_robot(REPORTS / "b.urdf"))
    assert "coupling: {axis_3: {axis_3: 1.0, axis_2: -1}}" in words and "torque under link" in words


@pytest.mark.parametrize(("joint", "sign"), [(2, 1.0), *nightly([(3, -1.0)])])
def test_sums_and_differences_of_other_joints_are_named(joint: int, sign: float) -> None:
    """With torques of the motors, which bear what the coupling brings."""
    arm = clean_arm(1)
    rng = np.random.default_rng(4)
    t = np.arange(2500) / 125.0
    motion = sines(rng, t)
    effort = arm.torques(motion, 0.01) + 0.02 * rng.normal(size=motion[0].shape)
    stamps = np.round(1e9 * t).astype(np.int64)
    plain = Recording(arm.robot.joint_names, Side(stamps, motion[0]), Side(stamps, effort=effort))
    assert not named(plain, arm.robot)
    given = motion[0].copy()
    given[:, joint] += sign * given[:, joint - 1]
    effort[:, joint - 1] -= sign * effort[:, joint]
    coupled = replace(plain, link=Side(stamps, given), motor=Side(stamps, effort=effort))
    (words,) = named(coupled, arm.robot)
    name = arm.robot.joint_names[joint]
    before = arm.robot.joint_names[joint - 1]
    assert f"coupling: {{{name}: {{{name}: 1.0, {before}: {-sign:g}}}}}" in words
    assert "angle and torque under motor" in words
