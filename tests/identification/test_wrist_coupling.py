"""A wrist whose last motor turns with the joint before it, too: torques of another engine and of
the motors alone."""

from functools import cache

import numpy as np
import pytest

from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.errors import EffectError
from elastic_arm.identification import Identification, IdentificationSettings, identify, parse_laws
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.foreign.channels import coupled
from tests.helpers.effect_samples import contribution, random_motion
from tests.helpers.full_tree import FullTree
from tests.helpers.motions import trajectory
from tests.helpers.random_arms import random_arm

FRICTION = ("viscous_friction", "coulomb_friction")
RATE = 500.0
INERTIA, VISCOUS, DRY = 0.3, 2.0, 3.0  # of the last motor
# Joint 4 turns with its own motor, and against that of joint 3: motor 4 turns by the sum of both
# joints' angles.
C = np.eye(4) - np.eye(4, k=-1) * np.array([0.0, 0.0, 0.0, 1.0])[:, None]


ROBOT = random_arm(4, np.random.default_rng(2), elastic=False)


@cache
def recorded(seed: int) -> Recording:
    """Record what the motors do, and bring it to the joints: torques by Pinocchio, the last motor
    by its own speed."""
    motion = trajectory(seed, ROBOT.n)
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 14.0, 1.0 / RATE)
    q, dq, ddq = (np.asarray(values) for values in motion.evaluate(t))
    tree = FullTree(ROBOT, bearings=False)
    to_motors = np.linalg.inv(C).T
    joints = np.array([tree.inverse_dynamics(*state) for state in zip(q, dq, ddq, strict=True)])
    speed, acceleration = (values @ to_motors for values in (dq, ddq))
    motors = joints @ C
    motors[:, 3] += (
        INERTIA * acceleration[:, 3] + VISCOUS * speed[:, 3] + DRY * np.sign(speed[:, 3])
    )
    motors += rng.normal(0.0, 0.1, motors.shape)
    side = Side(np.round(t * 1e9).astype(np.int64), position=q @ to_motors, effort=motors)
    return Recording(ROBOT.joint_names, motor=coupled(side, C))


@cache
def identified(*more: str) -> Identification:
    settings = IdentificationSettings(effects=parse_laws([*FRICTION, *more], ROBOT))
    return identify([recorded(3)], ROBOT, settings, validate=[recorded(4)])


def missed(found: Identification, *joints: str) -> np.ndarray:
    """Return the held-out rms of some joints, Nm."""
    assert found.validation is not None
    (judged,) = found.validation.values()
    return np.array([judged["identified"]["whole"][joint] for joint in joints])


def test_inertia_and_friction_of_a_shared_motor_are_identified() -> None:
    """They come out within three deviations and a tenth; the last joint has no friction of its own
    beside."""
    found = {e.name.partition(":")[2]: e for e in identified("wrist_coupling:joint_4").estimates}
    for name, true in (("inertia", INERTIA), ("viscous", VISCOUS), ("dry", DRY)):
        estimate = found[f"joint_4.{name}"]
        assert abs(estimate.value - true) < min(3 * estimate.std, 0.1 * true), (name, estimate)
    assert (
        abs(found["joint_4.coefficient"].value) < 0.1 and abs(found["joint_4.torque"].value) < 0.3
    )


@pytest.mark.nightly
def test_without_it_both_joints_are_missed() -> None:
    """Friction of each joint by itself leaves several times as much of the other motion at the two
    joints."""
    plain, right = (
        missed(identified(*more), "joint_3", "joint_4")
        for more in ((), ("wrist_coupling:joint_4",))
    )
    assert (plain > 3 * right).all() and right.max() < 0.3


@pytest.mark.parametrize("turns", ["with", "against"])
def test_its_power_is_that_of_the_motor(turns: str) -> None:
    """What the torques of both joints take is what resists the motor, times the motor's speed."""
    arm = random_arm(4, np.random.default_rng(5))
    p = {"inertia": 0.2, "viscous": 1.5, "dry": 2.0, "turns": turns}
    motion = random_motion(arm, np.random.default_rng(1))
    found = contribution(arm, [EffectInstance(EFFECTS["wrist_coupling"], "joint_3", p)], motion)
    speeds, accelerations = (motion[name][arm.n :] for name in ("dx", "ddx"))
    sign = 1.0 if turns == "with" else -1.0
    w, dw = (values[2] + sign * values[1] for values in (speeds, accelerations))
    torque = 0.2 * dw + 1.5 * w + 2.0 * np.tanh(w / 0.02)
    assert found["motor"] @ speeds == pytest.approx(torque * w)
    assert not found["motor"][[0, 3]].any() and not found["link"].any() and not found["drive"].any()


def test_the_first_joint_shares_no_motor_with_one_before_it() -> None:
    """The error names the joint and what to do."""
    with pytest.raises(EffectError, match="no joint before it"):
        identified("wrist_coupling:joint_1")
