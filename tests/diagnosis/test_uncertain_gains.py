"""Motor currents alone, with torque constants that are off by a quarter: gains, masses and friction scale alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Priors, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import imprecise, joint_sizes, ordinary_faults
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    MOTOR,
    RealisticSensors,
    measure_realistically,
)

ROBOT = load_robot()
GAINS = (0.8, 1.25, 0.85)  # recorded / true, of each motor's torque
CHANGE = 0.3  # of the second joint's friction in a recording
MASS, PLACE = 8.0, {"position_x": 0.1, "position_y": -0.08, "position_z": 0.1}


@pytest.mark.slow(20)
def test_a_payload_and_warming_friction_beside_gains_that_are_off() -> None:
    """Both causes are named, and each number has its true value within three standard deviations.

    A calibration that stops before its steps are small leaves the friction in another scale than the gain, and noise
    whose colour does not go with the gain makes a larger gain likelier than a smaller one.
    """
    rng = np.random.default_rng(11)
    own = [f for f in ordinary_faults(joint_sizes(ROBOT).tolist(), rng) if f.effect != "motor_torque_gain"]
    faults = [
        *own,
        *(Fault("motor_torque_gain", j, {"gain": gain}) for j, gain in enumerate(GAINS)),
        replace(Fault("thermal_friction", 1, {"change": CHANGE}), side="motor"),
        Fault("payload", None, {"mass": MASS, **PLACE}),
    ]
    arm = HiddenArm(imprecise(ROBOT, rng), faults, geometry=ROBOT)
    ratios = np.array([joint.transmission.r_tot for joint in ROBOT.joints if joint.transmission])
    sensors = RealisticSensors((0.26,) * 3, corner=8.0, rate=250.0, sides=MOTOR)
    identify, validate = (
        measure_realistically(
            arm.run(random_motion(rng, 3, seconds)), ROBOT.joint_names, arm.faults, sensors, ratios, rng
        )
        for seconds in (20.0, 10.0)
    )
    priors = Priors(sensors={"motor_torque_gain": 0.15})
    known = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)
    found = diagnose([identify], Question(ROBOT, refit=True, given=known, priors=priors), [validate])
    causes = {(cause.effect, cause.joint): cause.parameters for cause in found.causes}
    assert set(causes) == {("payload", "joint_3"), ("thermal_friction", "joint_2")}
    mass, change = causes["payload", "joint_3"]["mass"], causes["thermal_friction", "joint_2"]["change"]
    assert abs(mass.value - MASS) < 3.0 * mass.std and mass.std < 0.15 * MASS
    assert abs(change.value - CHANGE) < 3.0 * change.std and change.std < 0.1 * CHANGE
    gains = {one.joint: one for one in found.imperfections if one.what == "motor_torque_gain"}
    for joint, gain in zip(ROBOT.joint_names, GAINS, strict=True):
        assert abs(gains[joint].value - gain) < 3.0 * gains[joint].std < 0.3
