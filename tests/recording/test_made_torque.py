"""Torques that described controllers make of commands and positions."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.robot import JointController, Robot, load_robot

# Hz, rad/s, s by which the arm of these tests is behind its command
RATE = 50.0
W = 2 * np.pi * 0.8
LAG = 0.06
STEP = 1.0 / RATE


@pytest.fixture(scope="module")
def arm() -> Robot:
    """A rigid arm."""
    robot = load_robot(None)
    return robot.with_(joints=tuple(replace(joint, transmission=None) for joint in robot.joints))


def controlled(arm: Robot, **numbers: object) -> Robot:
    return arm.with_joint("joint_2", controller=JointController(**numbers))  # type: ignore[arg-type]


def recording(shift: float = 0.0) -> Recording:
    """Commands sin(W t) and positions sin(W (t - LAG)) of all joints, positions stamped later by a
    shift."""
    t = np.arange(300) * STEP
    stamps = np.round(1e9 * t).astype(np.int64)
    at = t + shift
    q, r = (np.sin(W * (x - late))[:, None].repeat(3, axis=1) for x, late in ((at, LAG), (t, 0.0)))
    rate = W * np.cos(W * t)[:, None].repeat(3, axis=1)
    names = ("joint_1", "joint_2", "joint_3")
    later = stamps + round(1e9 * shift)
    return Recording(
        names, link=Side(later, position=q), reference=Side(stamps, position=r, velocity=rate)
    )


def made(arm: Robot, **numbers: object) -> tuple[np.ndarray, np.ndarray]:
    found = with_made_torque(recording(0.007), controlled(arm, **numbers))
    assert list(found.made_by) == ["joint_2"]
    assert np.isnan(found.motor.effort[:, [0, 2]]).all()
    inner = slice(5, -5)  # splines need some samples
    return found.motor.stamp_ns[inner] * 1e-9, found.motor.effort[inner, 1]


def mean(t: np.ndarray, phase: float = 0.0) -> np.ndarray:
    """The mean of sin(W t + phase) over the sample interval centred at t."""
    return np.sin(W * t + phase) * np.sinc(W * STEP / (2 * np.pi))


def test_a_position_controller_acts_on_the_error_and_damps_the_motor(arm: Robot) -> None:
    """kp (r - q) - kd dq, r interpolated, late by the delay; each sample is the mean over its
    interval."""
    t, torque = made(arm, kp=20.0, kd=0.5, delay=0.03, between="interpolated")
    wanted = 20.0 * (mean(t - 0.03) - mean(t - LAG)) - 0.5 * W * mean(t - LAG, np.pi / 2)
    np.testing.assert_allclose(torque, wanted, rtol=0, atol=2e-3)


def test_a_held_command_is_the_mean_over_the_last_interval(arm: Robot) -> None:
    """Holding delays by half an interval and takes sinc of the amplitude."""
    t, torque = made(arm, kp=20.0)
    held = np.sinc(W * STEP / (2 * np.pi)) * mean(t - STEP / 2)
    np.testing.assert_allclose(torque, 20.0 * (held - mean(t - LAG)), rtol=0, atol=2e-3)


def test_the_rate_of_commands_counts_where_it_is_followed(arm: Robot) -> None:
    """Mode both: kd (dr - dq); mode velocity: its ki acts on the angle, from no error at the
    start."""
    t, torque = made(arm, mode="both", kp=20.0, kd=0.5, between="interpolated")
    error = mean(t) - mean(t - LAG)
    rate_error = W * (mean(t, np.pi / 2) - mean(t - LAG, np.pi / 2))
    np.testing.assert_allclose(torque, 20.0 * error + 0.5 * rate_error, rtol=0, atol=3e-3)
    t, torque = made(arm, mode="velocity", kd=0.5, ki=20.0, between="interpolated")
    left = torque - 20.0 * error - 0.5 * rate_error
    assert np.ptp(left) < 5e-3


def test_the_integral_and_the_limit(arm: Robot) -> None:
    """ki integrates the error from the first sample; no torque is beyond the controller's."""
    t, torque = made(arm, kp=20.0, ki=30.0, between="interpolated")
    own = torque - 20.0 * (mean(t) - mean(t - LAG))
    wanted = 30.0 * (mean(t - LAG, np.pi / 2) - mean(t, np.pi / 2)) / W
    assert np.ptp(own - wanted) < 5e-3
    _, torque = made(arm, kp=20.0, torque=1.5)
    assert np.abs(torque).max() == pytest.approx(1.5)


def test_gravity_is_fed_forward_of_the_command(arm: Robot) -> None:
    """A controller with gravity makes that of the described arm at its commands, where no gain adds
    any."""
    both = arm
    for name in arm.joint_names:
        both = both.with_joint(
            name, controller=JointController(feedforward="gravity", between="interpolated")
        )
    found = with_made_torque(recording(), both)
    r = found.reference.position
    weight = build_model(arm).inverse_dynamics(r, 0.0 * r, 0.0 * r)
    np.testing.assert_allclose(found.motor.effort, weight, rtol=0, atol=1e-9 * np.abs(weight).max())


def test_what_is_known_otherwise_is_left_as_it_is(arm: Robot) -> None:
    """A recorded torque is never replaced; without commands, or without a controller, nothing is
    made."""
    plain = recording()
    robot = controlled(arm, kp=20.0)
    torqued = replace(plain, link=replace(plain.link, effort=np.ones((300, 3))))
    assert with_made_torque(torqued, robot) is torqued
    assert with_made_torque(plain, arm) is plain
    uncommanded = replace(plain, reference=None)
    assert with_made_torque(uncommanded, robot) is uncommanded


def test_the_command_is_known_at_the_samples_that_are_left(arm: Robot) -> None:
    """Samples before the first command has arrived are left out; `r` of the samples is the command
    as it is taken."""
    found = with_made_torque(
        recording(), controlled(arm, kp=20.0, delay=0.1, between="interpolated")
    )
    samples = found.samples()
    assert samples.r is not None and found.start_ns >= 100_000_000
    t = samples.stamp_ns * 1e-9
    np.testing.assert_allclose(samples.r[:, 1], np.sin(W * (t - 0.1)), rtol=0, atol=1e-5)
