"""What scales a torque: sensors far off their gain, and friction that changes as a joint warms
up."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)


def refitted(seed: int, fault: Fault) -> Diagnosis:
    """Diagnose an imprecise arm with ordinary friction and sensors, one of them or one joint's
    friction at fault, with that effect to choose from."""
    rng = np.random.default_rng(seed)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    others = [one for one in ordinary if (one.effect, one.joint) != (fault.effect, fault.joint)]
    # The engine lets sensors' errors act in this order: a zero is in what is read.
    first, judge = record(true, [fault, *others], (8.0, 4.0), rng)
    question = Question(ROBOT, refit=True, given=FRICTION, effects=[fault.effect])
    return diagnose([first], question, [judge])


@pytest.mark.slow
def test_an_offset_is_in_what_a_sensor_reads_whatever_its_gain() -> None:
    """The zero of a sensor that reads 80 % is that of its readings, not of the torques that they
    are divided into."""
    found = refitted(45, Fault("joint_torque_gain", 1, {"gain": 0.8}))
    rng = np.random.default_rng(45)
    imprecise(ROBOT, rng)
    true = {(one.effect, one.joint): one for one in ordinary_faults(ROBOT.n, rng)}[
        "joint_torque_offset", 1
    ]
    offset = {(one.what, one.joint): one for one in found.imperfections}[
        "joint_torque_offset", "joint_2"
    ]
    assert abs(offset.value - true.parameters["offset"]) < 3.0 * offset.std


@pytest.mark.slow
def test_friction_that_changes_by_a_tenth_is_ordinary_and_known() -> None:
    """A tenth in a run is an imperfection with its size, and no cause."""
    found = refitted(46, replace(Fault("thermal_friction", 1, {"change": -0.1}), side="motor"))
    assert found.verdict == "none" and not found.causes
    changes = {
        one.joint: one for one in found.imperfections if one.what == "thermal_friction_motor"
    }
    assert set(changes) == set(ROBOT.joint_names) and all(one.ordinary for one in changes.values())
    for joint, change in {"joint_1": 0.0, "joint_2": -0.1, "joint_3": 0.0}.items():
        assert abs(changes[joint].value - change) < 3.0 * changes[joint].std
        assert changes[joint].std < 0.02
