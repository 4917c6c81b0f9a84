"""Derivatives of a commanded arm's motion by its numbers are those of its simulations."""

import numpy as np
import pytest

from elastic_arm.mujoco.closed_loop import play
from elastic_arm.mujoco.refinable import Refinable, robot_at
from elastic_arm.mujoco.sensitivity import derivatives
from tests.helpers.servo_arms import recorded, servo_arm
from tests.mujoco.test_judgement import model_of

NUMBERS = (
    Refinable("scale", "lift", 0.05),
    Refinable("kd", "pan", 0.05),
    Refinable("armature", "elbow", 0.05),
    Refinable("mass", "elbow", 0.05),
    Refinable("com_z", "elbow", 0.003),
    Refinable("viscous_friction", "elbow", 0.01),
    Refinable("coulomb_friction", "lift", 0.01),
)


@pytest.mark.parametrize("number", NUMBERS, ids=lambda one: one.what)
def test_a_derivative_is_the_difference_of_two_simulations(number: Refinable) -> None:
    """To a seventh of its size: dry friction turns over between the samples."""
    arm = servo_arm()
    recording = recorded(arm, 100.0, 17, seconds=6.0)
    there = play(arm, recording)
    by = 0.2 * number.std
    other = robot_at(arm.robot, [number], np.array([by]))
    moved = play(model_of(other), recording)
    assert there is not None and moved is not None
    expected = (moved.errors - there.errors) / by
    (found,) = derivatives(arm.robot, [(other, by)], there.motion, there.t)
    assert np.linalg.norm(found - expected) < np.linalg.norm(expected) / 7.0


def test_a_zero_changes_the_angles_of_the_weight() -> None:
    """The derivative by a joint's zero is the difference of two simulations, to a tenth."""
    arm = servo_arm()
    zero = {"effect": "joint_zero", "joint": "lift", "parameters": {"offset": 0.0}}
    begun = arm.robot.with_(effects=(*arm.robot.effects, zero))
    recording = recorded(arm, 100.0, 17, seconds=6.0)
    there = play(arm, recording)
    by = 4e-3
    other = robot_at(begun, [Refinable("joint_zero", "lift", 0.02)], np.array([by]))
    moved = play(model_of(other), recording)
    assert there is not None and moved is not None
    expected = (moved.errors - there.errors) / by
    (found,) = derivatives(begun, [(other, by)], there.motion, there.t)
    assert np.linalg.norm(found - expected) < np.linalg.norm(expected) / 10.0


def test_a_scale_of_everything_changes_no_motion() -> None:
    """All torques, masses and frictions by one ratio: derivatives cancel."""
    arm = servo_arm()
    there = play(arm, recorded(arm, 100.0, 17, seconds=4.0))
    assert there is not None
    names = arm.robot.joint_names
    numbers = [Refinable(w, j, 1.0) for j in names for w in ("scale", "armature", "mass")]
    x = np.full(len(numbers), 1e-3)
    other = robot_at(arm.robot, numbers, x)
    effects = tuple(
        {**one, "parameters": {k: v * np.exp(1e-3) for k, v in one["parameters"].items()}}
        for one in other.effects
    )
    (all_of_it,) = derivatives(
        arm.robot, [(other.with_(effects=effects), 1e-3)], there.motion, there.t
    )
    one = robot_at(arm.robot, numbers[:1], x[:1])
    (alone,) = derivatives(arm.robot, [(one, 1e-3)], there.motion, there.t)
    assert np.abs(all_of_it).max() < 1e-3 * np.abs(alone).max()
