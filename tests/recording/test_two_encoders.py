"""Encoders of links and of motors at the same joints of an arm that is described as rigid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.recording import Recording, Side
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders
from elastic_arm.robot import load_robot
from elastic_arm.robot.synthetic import random_arm

T = np.arange(0.0, 10.0, 0.004)
STAMPS = 10**18 + np.round(T * 1e9).astype(np.int64)
W = np.array([1.0, 1.7, 2.3])
LAG = 0.003  # s
RIGID = random_arm(3, np.random.default_rng(1), elastic=False)


def recorded() -> Recording:
    """Link encoders at two of three joints, 3 ms late, and motors with encoders and torques at all."""
    link = np.sin(W * (T[:, None] - LAG)) + np.array([0.01, 0.0, 0.0])
    link[:, 2] = np.nan
    motor = Side(STAMPS, np.sin(W * T[:, None]), W * np.cos(W * T[:, None]), np.cos(T)[:, None] * np.ones(3))
    return Recording(RIGID.joint_names, link=Side(STAMPS, link), motor=motor)


def test_of_a_rigid_arm_the_encoders_of_the_motors_are_used_and_the_lag_is_stated() -> None:
    """Their zero is no lag; and nothing is left of a link side that no joint needs."""
    found = by_motor_encoders(recorded(), RIGID)
    assert found.link is None
    assert "joint_1, joint_2: " in found.notes[-1] and "which are 3 ms behind them" in found.notes[-1]


def test_link_encoders_stay_where_they_are_needed() -> None:
    """At a joint whose motor has no torque, beside joint torques, and of an elastic arm."""
    whole = recorded()
    assert whole.link is not None and whole.motor is not None and whole.motor.effort is not None
    bare = replace(whole, motor=replace(whole.motor, effort=whole.motor.effort * [1.0, np.nan, 1.0]))
    found = by_motor_encoders(bare, RIGID)
    assert found.link is not None and found.link.position is not None
    np.testing.assert_array_equal(np.isnan(found.link.position).all(axis=0), [True, False, True])
    sensed = replace(whole, link=replace(whole.link, effort=whole.motor.effort))
    assert by_motor_encoders(sensed, RIGID) is sensed
    assert by_motor_encoders(whole, load_robot()) is whole
