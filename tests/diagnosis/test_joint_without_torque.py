"""An arm of which one joint has no torque: the others are used, and the joint is named."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.identification import identify
from elastic_arm.mujoco.recorder import record
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from tests.helpers.motions import trajectory
from tests.helpers.servo_arms import servo_arm

pytestmark = [pytest.mark.usefixtures("compiled_here"), pytest.mark.slow(10)]
ROUGH = {
    'name="lift" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.05"': (
        'name="lift" axis="0 1 0" armature="0.028" damping="0.05" frictionloss="0.25"'
    )
}


@pytest.fixture(scope="module")
def described() -> Robot:
    return servo_arm().robot


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    """Recordings of an arm with a rough lift whose elbow has a torque of zero throughout."""
    found = []
    rng = np.random.default_rng(0)
    for seed in (0, 1):
        motion = trajectory(seed, period=6.0, ramp=1.0)
        one = record(servo_arm(ROUGH), motion, rate=250.0, torque_noise=0.02, rng=rng)
        assert one.motor is not None and one.motor.effort is not None
        effort = one.motor.effort.copy()
        effort[:, 2] = 0.0
        motor = replace(one.motor, effort=effort)
        found.append(replace(one, motor=motor, reference=None, source=f"run_{seed}"))
    return found


def without(runs: list[Recording]) -> list[Recording]:
    """Return them with NaN in the place of the zeros."""
    found = []
    for one in runs:
        assert one.motor is not None and one.motor.effort is not None
        effort = one.motor.effort.copy()
        effort[:, 2] = np.nan
        found.append(replace(one, motor=replace(one.motor, effort=effort)))
    return found


def test_zeros_are_identified_as_no_torque(runs: list[Recording], described: Robot) -> None:
    """Estimates are those without the channel; both notes name the joint."""
    found = identify(runs[:1], described)
    bare = identify(without(runs)[:1], described)
    assert [one.value for one in found.estimates] == [one.value for one in bare.estimates]
    assert any("of elbow is constant while the joint moves" in note for note in found.notes)
    assert any(note.startswith("elbow: no torque was recorded") for note in found.notes)


def test_a_diagnosis_finds_the_cause_at_another_joint(
    runs: list[Recording], described: Robot
) -> None:
    """No gain of the elbow's torque is a cause, and its equation is not there."""
    effects = ["coulomb_friction", "viscous_friction", "motor_torque_gain", "payload"]
    found = diagnose(runs[:1], Question(described, effects=effects, refit=True), runs[1:])
    assert [(one.effect, one.joint) for one in found.causes] == [("coulomb_friction", "lift")]
    assert ("elbow", "motor") not in found.before.rmse
    assert any("of elbow is constant while the joint moves" in note for note in found.notes)
    assert any(note.startswith("elbow: no torque was recorded") for note in found.notes)
