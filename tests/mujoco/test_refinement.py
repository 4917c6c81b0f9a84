"""Steps of a refinement are straight lines where the dynamics are linear."""

import numpy as np
import pytest

from elastic_arm.dynamics.bodies import inertial_parameters
from elastic_arm.mujoco.refinable import Refinable, robot_at
from elastic_arm.mujoco.refinement import after_step
from elastic_arm.robot import Robot
from tests.helpers.servo_arms import servo_arm

NUMBERS = (
    Refinable("mass", "elbow", 0.05),
    Refinable("com_x", "elbow", 0.005),
    Refinable("com_z", "elbow", 0.005),
    Refinable("scale", "elbow", 0.1),
    Refinable("kd", "elbow", 0.1),
    Refinable("payload.mass", "elbow", 0.1, least=-0.3),
    Refinable("payload.position_y", "elbow", 0.01),
)
HERE = np.array([0.1, 0.004, -0.01, -0.2, 0.15, 0.05, 0.02])
STEP = np.array([-0.3, 0.01, 0.02, 0.5, -0.4, 0.4, -0.03])


def _sums(share: float) -> np.ndarray:
    """Return what the dynamics are linear in after a share of the step."""
    payload = {"mass": 0.3, "position": [0.0, 0.05, 0.1]}
    effect = {"effect": "payload", "joint": "elbow", "parameters": payload}
    robot: Robot = servo_arm().robot.with_(effects=(effect,))
    robot = robot_at(robot, NUMBERS, after_step(NUMBERS, HERE, share * STEP))
    joint = robot.joints[robot.joint_names.index("elbow")]
    assert joint.controller is not None
    held = robot.effects[0]["parameters"]
    moment = held["mass"] * np.array(held["position"])
    mass_and_moment = inertial_parameters(joint.link)[:4]
    gains = joint.controller.kp, joint.controller.kd
    return np.array([*mass_and_moment, *gains, held["mass"], *moment])


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_gains_masses_and_first_moments_go_straight(share: float) -> None:
    begin = _sums(0.0)
    end = _sums(1.0)
    assert np.abs(end - begin).max() > 0.05
    assert _sums(share) == pytest.approx(begin + share * (end - begin), rel=1e-12)


def test_a_step_begins_in_its_direction() -> None:
    """Derivatives by the numbers are derivatives by the step."""
    little = 1e-6 * STEP
    moved = after_step(NUMBERS, HERE, little) - HERE
    assert moved == pytest.approx(little, rel=1e-5)
