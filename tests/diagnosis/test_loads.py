"""A pull on a link, which both torque channels read, is no zero of two sensors; the zero of one sensor is one."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

pytestmark = pytest.mark.slow(40)

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)
PULL = 6.0  # Nm


def diagnosed(*further: Fault) -> Diagnosis:
    """Return the diagnosis of an arm on which everything is a little wrong, and this besides."""
    rng, own = np.random.default_rng(51), {(fault.effect, fault.joint) for fault in further}
    robot = imprecise(ROBOT, rng)
    faults = [fault for fault in ordinary_faults(ROBOT.n, rng) if (fault.effect, fault.joint) not in own]
    fitted, judged = record(robot, [*faults, *further], (12.0, 6.0), rng)
    return diagnose([fitted], Question(ROBOT, given=FRICTION, refit=True), [judged])


def test_the_zero_of_one_torque_sensor_is_its_cause() -> None:
    found = diagnosed(Fault("joint_torque_offset", 2, {"offset": PULL}))
    assert [(cause.effect, cause.joint) for cause in found.causes] == [("joint_torque_offset", "joint_3")]
    assert found.causes[0].parameters["offset"].value == pytest.approx(PULL, abs=0.1)
