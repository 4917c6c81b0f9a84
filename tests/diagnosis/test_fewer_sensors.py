"""Arms of which one side alone is recorded, slowly: the diagnosis answers, and accuses nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.recording import Recording
from elastic_arm.recording.sides import Side
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import (
    as_urdf,
    imprecise,
    industrial_arm,
    joint_sizes,
    ordinary_faults,
)
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    LINK,
    MOTOR,
    RealisticSensors,
    measure_realistically,
)
from tests.helpers.gap_recordings import ROBOT, motions, record

KNOWN = ("coulomb_friction", "viscous_friction")


def _recorded(n: int, sides: str, rate: float, seed: int) -> tuple[Robot, list[Recording]]:
    """Return a description and two recordings of an arm that is ordinarily imprecise."""
    rng = np.random.default_rng(seed)
    description = load_robot(None) if n == 3 else as_urdf(industrial_arm(n, rng))
    faults = ordinary_faults(joint_sizes(description).tolist(), rng)
    arm = HiddenArm(imprecise(description, rng), faults, geometry=description)
    sensors = RealisticSensors((0.26,) * n, rate=rate, sides=sides)
    ratios = np.array([joint.transmission.r_tot for joint in description.joints if joint.transmission])
    names = description.joint_names
    courses = [arm.run(random_motion(rng, n, seconds)) for seconds in (12.0, 8.0)]
    return description, [measure_realistically(c, names, arm.faults, sensors, ratios, rng) for c in courses]


@pytest.mark.slow(15)
@pytest.mark.parametrize(("n", "sides", "rate"), [(3, MOTOR, 100.0), (3, LINK, 250.0), (6, LINK, 250.0)])
def test_one_side_alone_is_diagnosed_and_nothing_is_accused(n: int, sides: str, rate: float) -> None:
    """Motors alone, or joint torques alone: some verdict, and no cause at a confidence of 0.9 that the arm lacks.

    Of six joints one always stands somewhere: what it leaves out is its own motor's equation, not the whole recording.
    """
    robot, (identify, validate) = _recorded(n, sides, rate, seed=7)
    found = diagnose([identify], Question(robot, refit=True, given=known_effects(KNOWN, robot)), [validate])
    assert found.verdict in ("none", "explained", "unknown")
    assert not [cause for cause in found.causes if cause.confidence >= 0.9]


def test_motor_torques_without_motor_angles_show_friction_of_the_motors() -> None:
    """Beside joint torque sensors a current alone gives the motor's equation: its friction has its place and size."""

    def without_motor_angles(recording: Recording) -> Recording:
        assert recording.motor is not None
        return replace(recording, motor=Side(recording.motor.stamp_ns, effort=recording.motor.effort))

    identify, validate = (
        without_motor_angles(record(motion, "coulomb_friction:joint_2:torque=15", seed=k))
        for k, motion in enumerate(motions())
    )
    found = diagnose([identify], Question(ROBOT), [validate])
    assert [(cause.effect, cause.joint, cause.sides) for cause in found.causes] == [
        ("coulomb_friction", "joint_2", ("motor",))
    ]
    assert found.causes[0].parameters["torque"].value == pytest.approx(15.0, rel=0.03)
