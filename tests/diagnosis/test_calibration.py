"""Refitted diagnoses of realistic arms, recorded on an engine that shares nothing with the
diagnosis."""

import json

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)


@pytest.fixture(scope="module")
def ordinary_arm() -> tuple[Diagnosis, list[Fault], Robot]:
    """An imprecise arm with ordinary friction and sensors: its diagnosis, what sensors and joints
    have, and itself."""
    rng = np.random.default_rng(31)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    first, judge = record(true, ordinary, (8.0, 4.0), rng)
    return diagnose([first], Question(ROBOT, refit=True, given=FRICTION), [judge]), ordinary, true


@pytest.mark.slow
def test_an_arm_that_is_only_ordinarily_wrong_has_no_cause(
    ordinary_arm: tuple[Diagnosis, list[Fault], Robot],
) -> None:
    """Wrong masses, stiffness, friction and sensors are found as such, and nothing is blamed."""
    found, ordinary, _ = ordinary_arm
    assert found.verdict == "none" and not found.causes
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["imperfections"]
    known = {(one.what, one.joint): one for one in found.imperfections}
    for fault in ordinary:
        if fault.effect.endswith("_offset"):
            one = known[fault.effect, ROBOT.joint_names[fault.joint or 0]]
            assert abs(one.value - fault.parameters["offset"]) < 4.0 * one.std + 0.02
            assert one.ordinary


@pytest.mark.slow
def test_a_common_scale_of_torques_and_inertias_is_as_uncertain_as_its_priors(
    ordinary_arm: tuple[Diagnosis, list[Fault], Robot],
) -> None:
    """Nothing but the priors of six gains tells the scale of torques, rotors and stiffnesses;
    joints differ by less."""
    found, ordinary, true = ordinary_arm
    known = {(one.what, one.joint): one for one in found.imperfections}
    values = {}
    for joint, described in zip(true.joints, ROBOT.joints, strict=True):
        now, was = joint.transmission, described.transmission
        assert now is not None and was is not None
        values["rotor_inertia", joint.name] = now.rotor.izz / was.rotor.izz
        values["stiffness", joint.name] = now.stiffness / was.stiffness
    for fault in ordinary:
        if fault.effect.endswith("_gain"):
            values[fault.effect, ROBOT.joint_names[fault.joint or 0]] = fault.parameters["gain"]
    gains = [one.prior_std for (what, _), one in known.items() if what.endswith("_gain")]
    common = np.sum(np.array(gains) ** -2.0) ** -0.5
    for key, value in values.items():
        assert abs(known[key].value - value) < 3.0 * known[key].std
        assert 0.9 * common < known[key].std / value < 1.5 * common
    ratios = [
        known["motor_torque_gain", name].value / values["motor_torque_gain", name]
        for name in ROBOT.joint_names
    ]
    assert np.ptp(ratios) < 0.004
