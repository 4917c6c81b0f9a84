"""Torque channels that are worse than ordinary: each is named by what it is, with its size."""

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel

ROBOT = load_robot(None)
FAULTS = {
    "torque_drift": Fault("torque_drift", 1, {"rate": 0.1}, choices={"channel": "joint_torque"}),
    "torque_lowpass": Fault("torque_lowpass", 1, {"cutoff": 5.0}, channels=("joint_torque",)),
    "time_delay": Fault("time_delay", 1, {"delay": 0.01}, channels=("joint_torque",)),
}


@pytest.mark.slow
@pytest.mark.parametrize("effect", sorted(FAULTS))
def test_what_ails_a_torque_channel_is_named(effect):
    """A drift of the zero, a low pass and a delay of one joint torque, each the only cause, within 5 % of its size."""
    fault, rng = FAULTS[effect], np.random.default_rng(1)
    arm = HiddenArm(ROBOT, [fault])
    runs = [arm.record(random_motion(rng, ROBOT.n, seconds), SensorModel(), rng) for seconds in (20.0, 12.0)]
    found = diagnose(runs[:1], Question(ROBOT), runs[1:])
    assert [(c.effect, c.joint) for c in found.causes] == [(effect, "joint_2")]
    ((name, size),) = fault.parameters.items()
    assert found.causes[0].parameters[name].value == pytest.approx(size, rel=0.05)
    assert found.verdict == "explained" and found.causes[0].confidence > 0.9
