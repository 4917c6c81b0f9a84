"""Encoders of links and of motors at the same joints of an arm that is described as rigid."""

from dataclasses import replace

import numpy as np

from elastic_arm.recording import Recording, Side
from elastic_arm.recording.inspection.outliers import without_outliers
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders, disagreeing
from elastic_arm.robot import load_robot
from tests.helpers.random_arms import random_arm

T = np.arange(0.0, 10.0, 0.004)
STAMPS = 10**18 + np.round(T * 1e9).astype(np.int64)
W = np.array([1.0, 1.7, 2.3])
LAG = 0.003  # s
RIGID = random_arm(3, np.random.default_rng(1), elastic=False)


def recorded() -> Recording:
    """Link encoders at two of three joints, 3 ms late, and motors with encoders and torques at
    all."""
    link = np.sin(W * (T[:, None] - LAG)) + np.array([0.01, 0.0, 0.0])
    link[:, 2] = np.nan
    motor = Side(
        STAMPS, np.sin(W * T[:, None]), W * np.cos(W * T[:, None]), np.cos(T)[:, None] * np.ones(3)
    )
    return Recording(RIGID.joint_names, link=Side(STAMPS, link), motor=motor)


def test_of_a_rigid_arm_the_encoders_of_the_motors_are_used_and_the_lag_is_stated() -> None:
    """Their zero is no lag; and nothing is left of a link side that no joint needs."""
    found = by_motor_encoders(recorded(), RIGID)
    assert found.link is None
    assert "joint_1, joint_2: " in found.notes[-1] and "which lag them by 3 ms" in found.notes[-1]


def test_link_encoders_stay_where_they_are_needed() -> None:
    """At a joint whose motor has no torque, beside joint torques, and of an elastic arm."""
    whole = recorded()
    bare = replace(
        whole, motor=replace(whole.motor, effort=whole.motor.effort * [1.0, np.nan, 1.0])
    )
    found = by_motor_encoders(bare, RIGID)
    np.testing.assert_array_equal(np.isnan(found.link.position).all(axis=0), [True, False, True])
    sensed = replace(whole, link=replace(whole.link, effort=whole.motor.effort))
    assert by_motor_encoders(sensed, RIGID) is sensed
    assert by_motor_encoders(whole, load_robot()) is whole


def elastic(zero: float = 0.0, ratio: float = 1.0, stiffness: float = 2e4) -> Recording:
    """Both encoders of drives that wind up under gravity, friction and noise."""
    rng = np.random.default_rng(2)
    q = np.sin(W * T[:, None] + [0.0, 1.0, 2.0])
    load = 60.0 * np.sin(q) + 8.0 * np.sign(np.gradient(q, axis=0)) - 4.0 * W**2 * q
    theta = q + load / stiffness + 2e-5 * rng.standard_normal(q.shape)
    theta[:, 1] = ratio * theta[:, 1] + zero
    effort = load + 0.3 * rng.standard_normal(q.shape)
    return Recording(
        RIGID.joint_names, link=Side(STAMPS, q), motor=Side(STAMPS, theta, effort=effort)
    )


def test_encoders_that_agree_but_for_the_wind_up_are_not_blamed() -> None:
    """Drives of 500 Nm/rad wind up by 0.2 rad; a zero of some milliradians is ordinary."""
    for stiffness in (500.0, 2e4, 1e6):
        whole = elastic(0.005, stiffness=stiffness)
        assert disagreeing(whole) == [] and without_outliers(whole) is whole


def test_a_zero_and_a_ratio_of_encoders_are_named() -> None:
    """An incremental encoder 0.4 rad off, a ratio 0.35 % off: the joint, and by how much."""
    cleared = without_outliers(elastic(0.4))
    assert any("position of joint_2 differ by 0.4 rad" in note for note in cleared.notes)
    np.testing.assert_allclose(cleared.motor.position, elastic().motor.position, rtol=0, atol=2e-4)  # type: ignore[union-attr, arg-type]
    (ratio,) = disagreeing(elastic(ratio=1.0035))
    assert ratio.code == "encoder_ratio" and "of joint_2 are 1 times" not in ratio.message
    assert "1.0035 times those of the link" in ratio.message
