"""Arms whose sensors are noisy in other ways than white: nothing is blamed on them, and effects
keep their names."""

from functools import cache

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from tests.helpers.nightly import nightly
from tests.helpers.noise_kinds import recording

ROBOT = load_robot(None)
FAULTS = {"none": (), "friction": (Fault("coulomb_friction", 1, {"torque": 3.0}),)}
CHANNELS = ("q", "dq", "theta", "dtheta", "tau_J", "tau_m")
ALL = [effect.id for effect in Question(ROBOT).candidates]
# What coloured noise resembles most; the choice among all takes three times as long.
LIKE_NOISE = [
    "coulomb_friction",
    "stribeck_friction",
    "viscous_friction",
    "hysteresis",
    "torque_drift",
    "torque_lowpass",
]
CANDIDATES = [LIKE_NOISE, *nightly([ALL])]


@cache
def truth(fault):
    """What exact sensors read of two motions, 1000 times a second."""
    rng, exact = np.random.default_rng(1), SensorModel(torque_noise=0.0, velocity_noise=0.0)
    arm = HiddenArm(ROBOT, FAULTS[fault])
    return [arm.record(random_motion(rng, ROBOT.n, 6.0), exact, rng).samples() for _ in range(2)]


def found(kind, candidates, fault="none"):
    """Diagnose an arm with a kind of noise, with some effects as candidates."""
    rng = np.random.default_rng(5)
    runs = [
        recording(
            kind, run.t[::2], {name: getattr(run, name)[::2] for name in CHANNELS}, rng, f"run_{k}"
        )
        for k, run in enumerate(truth(fault))
    ]
    return diagnose(runs[:1], Question(ROBOT, effects=candidates), runs[1:])


@pytest.mark.parametrize("candidates", CANDIDATES, ids=["few", "all"])
def test_noise_is_no_gap(candidates):
    """With coloured noise, an arm as described has the verdict `none` and no cause.

    `benchmarks/noise_kinds.py` has all kinds of noise.
    """
    answer = found("first_order_10ms", candidates)
    assert answer.verdict == "none" and not answer.causes


@pytest.mark.parametrize("candidates", CANDIDATES, ids=["few", "all"])
def test_friction_is_named_in_coloured_noise(candidates):
    """Friction of 3 Nm is the only cause, within 10 % of its size, in pink noise."""
    (cause,) = found("pink", candidates, "friction").causes
    assert (cause.effect, cause.joint) == ("coulomb_friction", "joint_2")
    assert cause.parameters["torque"].value == pytest.approx(3.0, rel=0.1)


@pytest.mark.nightly
def test_an_effect_that_no_candidate_resembles_is_not_taken_for_noise():
    """Friction that the catalogue lacks is left as `unknown`, not explained by noise of its
    colour."""
    friction = {
        "coulomb_friction",
        "stribeck_friction",
        "load_dependent_friction",
        "viscous_friction",
        "hysteresis",
        "degressive_friction",
    }
    others = [effect for effect in ALL if effect not in friction]
    assert found("white", others, "friction").verdict == "unknown"
