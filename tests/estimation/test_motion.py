"""The smoothed motion of a recording: parts, joining, and what stands in for missing channels."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from elastic_arm.dynamics import build_model
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.motion import (
    CompletedMotion,
    Motion,
    completed,
    drive_constants,
    moved_in_time,
    with_filtered_deflection,
)
from elastic_arm.estimation.residuals import raw_residuals
from elastic_arm.robot import load_robot
from tests.helpers.smooth_motion import smooth_motion

MODEL = build_model(load_robot(None), "mod3")


def test_parts_joined_are_the_whole() -> None:
    """Cutting a motion and joining the parts changes nothing."""
    whole = smooth_motion(MODEL, samples=50)
    again = Motion.joined([whole[:20], whole[20:]])
    for name, values in whole.channels().items():
        np.testing.assert_array_equal(getattr(again, name), values)
    assert len(whole[10:15]) == 5
    assert replace(whole, theta=None).recorded == {"q", "tau_J", "tau_m"}


def test_a_motor_without_an_encoder_is_wound_by_its_load_whatever_made_its_torque() -> None:
    """A motor torque that was made of a duty leaves the angle of the motor as a measured one."""
    measured = replace(smooth_motion(MODEL, samples=50), theta=None, dtheta=None, ddtheta=None)
    of_duty = replace(measured, r=np.zeros((50, MODEL.n)))
    first, second = (completed(one, MODEL).theta for one in (measured, of_duty))
    assert np.any(first != measured.q)
    np.testing.assert_array_equal(second, first)


@pytest.mark.parametrize("missing", ["tau_J", "tau_m"])
def test_what_stands_in_for_a_torque_cancels_from_the_usable_rows(missing: str) -> None:
    """The usable residuals of a completed motion are those that the missing torque has no part
    in."""
    whole = smooth_motion(MODEL, samples=50)
    part = replace(whole, **{missing: None})
    equations = EquationSet.direct(part.recorded, MODEL.n)
    full, standing_in = (
        raw_residuals(MODEL, completed(m, MODEL)) @ equations.transform.T for m in (whole, part)
    )
    np.testing.assert_allclose(standing_in, full, atol=1e-9 * np.abs(full).max())


def test_a_missing_link_encoder_is_made_up_from_the_load_at_low_frequency() -> None:
    """Behind a slow motor the link follows by the static deflection, load over stiffness."""
    t, w, one = np.arange(4000) * 1e-3, 2 * np.pi * 0.25, np.ones(MODEL.n)
    theta, dtheta = np.outer(0.3 * np.sin(w * t), one), np.outer(0.3 * w * np.cos(w * t), one)
    ddtheta = -(w**2) * theta
    found = completed(Motion(t, theta=theta, dtheta=dtheta, ddtheta=ddtheta, tau_m=theta), MODEL)
    assert isinstance(found, CompletedMotion)
    load = MODEL.inverse_dynamics(*(np.hstack([v, v]) for v in (theta, dtheta, ddtheta)))[
        :, : MODEL.n
    ]
    middle = slice(1000, 3000)
    expected = load[middle] / drive_constants(MODEL)[0]
    np.testing.assert_allclose(
        (found.theta - found.q)[middle], expected, atol=0.05 * np.abs(expected).max()
    )


def test_a_missing_motor_encoder_is_made_up_beside_joint_torques() -> None:
    """Ahead of a slow link the motor is by the static deflection, load over stiffness."""
    t, w, one = np.arange(4000) * 1e-3, 2 * np.pi * 0.25, np.ones(MODEL.n)
    q, dq = np.outer(0.3 * np.sin(w * t), one), np.outer(0.3 * w * np.cos(w * t), one)
    motion = Motion(t, q=q, dq=dq, ddq=-(w**2) * q, tau_J=100.0 * q, tau_m=q)
    found, middle = completed(motion, MODEL), slice(1000, 3000)
    expected = 100.0 * q[middle] / drive_constants(MODEL)[0]
    np.testing.assert_allclose(
        (found.theta - found.q)[middle], expected, atol=0.01 * np.abs(expected).max()
    )


def test_without_positions_nothing_is_completed() -> None:
    """The error says what to record."""
    with pytest.raises(DiagnosisError, match="positions"):
        completed(Motion(np.arange(3.0), tau_m=np.zeros((3, 3))), MODEL)


def test_a_deflection_is_filtered_of_both_encoders_noise() -> None:
    """Of a deflection of 50 microrad the noise falls to two fifths; the angle of the finer encoder
    stays as it is."""
    rate, rng = 1000.0, np.random.default_rng(0)
    t = np.arange(8000) / rate
    wave, size = 2 * np.pi * 0.5, 5e-5

    def noisy(values: list[np.ndarray], std: float) -> list[np.ndarray]:
        """Angle and two derivatives, with noise that is white up to 40 Hz."""
        noise = sosfiltfilt(
            butter(4, 40.0, fs=rate, output="sos"), std * rng.standard_normal(len(t))
        )
        first = np.gradient(noise, 1 / rate)
        return [
            (v + n)[:, None]
            for v, n in zip(values, (noise, first, np.gradient(first, 1 / rate)), strict=True)
        ]

    q = [np.sin(t), np.cos(t), -np.sin(t)]
    wound = [
        size * (1 + np.sin(wave * t)),
        size * wave * np.cos(wave * t),
        -size * wave**2 * np.sin(wave * t),
    ]
    link, motor = noisy(q, 2e-5), noisy([a + d for a, d in zip(q, wound, strict=True)], 5e-6)
    motion = Motion(t, *link, *motor)
    f = np.linspace(0.0, 40.0, 100)
    noise = (2e-5**2 + 5e-6**2) * np.ones((len(f), 1))
    found = with_filtered_deflection(motion, rate, f, noise, np.array([True]))
    np.testing.assert_array_equal(found.theta, motor[0])
    inside = slice(1000, -1000)
    for name, other, true in (("theta", "q", wound[0]), ("dtheta", "dq", wound[1])):
        before, after = (
            np.std((getattr(one, name) - getattr(one, other))[inside, 0] - true[inside])
            for one in (motion, found)
        )
        assert after < 0.4 * before


@pytest.mark.parametrize("later", [0.0, 4e-4, -4e-4, 2.34e-2, -2.37e-2, 0.5, -3.0])
@pytest.mark.parametrize("jitter", [0.0, 5e-5])
def test_samples_moved_in_time_are_those_of_the_spline(later: float, jitter: float) -> None:
    """A channel is at other times what its spline is there, and at the ends stays as it is."""
    rng = np.random.default_rng(0)
    t = 3.0 + 1e-3 * np.arange(2000) + jitter * rng.uniform(-1.0, 1.0, 2000)
    spline = CubicSpline(t, np.sin(5.0 * t) + 0.1 * rng.standard_normal(2000))
    expected = spline(np.clip(t + later, t[0], t[-1]))
    np.testing.assert_allclose(moved_in_time(spline, later), expected, atol=1e-12)
