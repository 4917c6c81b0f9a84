"""From a recording to smoothed motion: its noise, its length, and recordings that hold no
motion."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy

from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.observation import Observation, observe, widest_band
from elastic_arm.estimation.resampling import Grid
from elastic_arm.estimation.torque_noise import torque_noise
from elastic_arm.recording import Recording
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.robot.mjcf import MjcfArm
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import motions, record
from tests.helpers.servo_arms import recorded, servo_arm


@cache
def recording() -> Recording:
    return record(motions()[0], sensors=Sensors.real(), rate=1000.0)


@cache
def observation() -> Observation:
    return observe(recording())


def test_the_noise_of_a_torque_is_found_beside_motion_and_a_line() -> None:
    """White noise of known size is found to 5 % under a slow motion and a narrow line a hundred
    times as large."""
    t = np.arange(8000) / 1000.0
    std = np.array([0.02, 0.5])
    noise = std * np.random.default_rng(4).standard_normal((len(t), 2))
    signal = np.sin(2 * np.pi * 3.0 * t) + 0.5 * np.sin(2 * np.pi * 300.0 * t)
    grid = Grid(t, 1000.0, tau_J=100.0 * std * signal[:, None] + noise)
    found = torque_noise([grid], "tau_J")
    assert found is not None and torque_noise([grid], "tau_m") is None
    np.testing.assert_allclose(found, std, rtol=0.05)


def test_the_noise_of_every_channel_is_what_the_sensors_have() -> None:
    """Standard deviations that the simulated sensors state come back from the recording alone."""
    sensors, noise, n = Sensors.real(), observation().noise, recording().n
    pairs = (
        (noise.tau_J, sensors.joint_torque.row("noise", n)),
        (noise.tau_m, sensors.motor_torque.row("noise", n)),
    )
    for found, stated in pairs:
        assert found is not None
        np.testing.assert_allclose(found, stated, rtol=0.15)


def test_columns_are_made_of_motion_smoothed_at_least_as_far_as_residuals() -> None:
    """The motion of the columns has no more power in its accelerations than that of the
    residuals."""
    seen = observation()
    wide, quiet = (
        np.std(np.asarray(pieces[0].ddtheta), axis=0) for pieces in (seen.pieces, seen.quiet)
    )
    assert (quiet <= wide).all()


def test_position_noise_without_a_velocity_channel_is_the_encoders() -> None:
    """Its density is white of the encoder's standard deviation, times the squared response of the
    smoother."""
    seen = observation()
    alone = replace(seen, noise=replace(seen.noise, dtheta=None))
    f = np.linspace(0.0, 40.0, 9)
    expected = seen.gain(f)[:, None] ** 2 * np.asarray(seen.noise.theta) ** 2
    np.testing.assert_allclose(alone.position_spectrum("motor", f), expected)


def test_a_velocity_channel_takes_noise_from_the_position() -> None:
    """With it the density is nowhere above the encoder's alone."""
    seen, f = observation(), np.linspace(0.1, 40.0, 60)
    alone = replace(seen, noise=replace(seen.noise, dtheta=None))
    assert (
        seen.position_spectrum("motor", f) <= alone.position_spectrum("motor", f) * (1 + 1e-9)
    ).all()


def test_the_widest_band_follows_the_rate_up_to_the_drives_resonances() -> None:
    """A fifth of the sample rate, at most 40 Hz."""
    assert widest_band(100.0) == pytest.approx(20.0) and widest_band(1000.0) == pytest.approx(40.0)


def test_recordings_that_no_residual_can_be_made_of_are_refused() -> None:
    """Without a torque, shorter than two seconds, or at rest: one line each, with the remedy."""
    whole = recording()
    assert whole.link is not None and whole.motor is not None
    silent = replace(
        whole, link=replace(whole.link, effort=None), motor=replace(whole.motor, effort=None)
    )
    with pytest.raises(DiagnosisError, match="contains no torque"):
        observe(silent)
    with pytest.raises(DiagnosisError, match="too short"):
        observe(whole.between(0.0, 1.5))
    still = replace(
        whole,
        **{
            side: replace(
                part, position=np.tile(part.position[:1], (len(part.position), 1)), velocity=None
            )
            for side, part in (("link", whole.link), ("motor", whole.motor))
        },
    )
    with pytest.raises(DiagnosisError, match="no motion"):
        observe(still)


def test_a_torque_that_was_low_passed_limits_the_band_and_has_the_noise_of_an_ordinary_sensor() -> (
    None
):
    """Below a low pass of 5 Hz a torque is compared up to there, with noise of 0.5 % of its rms in
    that band."""
    whole = recording()
    assert whole.motor is not None and whole.motor.effort is not None
    sections = scipy.signal.butter(
        4, 5.0, fs=1e9 / np.median(np.diff(whole.motor.stamp_ns)), output="sos"
    )
    smooth = scipy.signal.sosfiltfilt(sections, whole.motor.effort, axis=0)
    seen = observe(replace(whole, motor=replace(whole.motor, effort=smooth)))
    assert observation().torque_band == np.inf
    assert 3.0 < seen.torque_band < 6.0
    assert seen.noise.tau_m is not None
    in_band = seen.noise.tau_m * np.sqrt(2.0 * seen.torque_band / 0.9 / seen.rate)
    np.testing.assert_allclose(in_band, 0.005 * np.sqrt(np.mean(smooth**2, axis=0)), rtol=0.25)


def unlimited() -> MjcfArm:
    """Return the servo arm without limits of its torques."""
    limits = (f'joint="{name}" forcerange="-4 4"' for name in ("pan", "lift", "elbow"))
    return servo_arm({limit: limit.split(" forcerange")[0] for limit in limits})


def test_a_made_torque_follows_the_gains_of_its_controller() -> None:
    """With other gains of kp and kd it is the torque that these controllers make of the same
    recording."""
    true = unlimited()
    other = arm = true.robot
    for joint in arm.joints:
        assert joint.controller is not None
        other = other.with_joint(joint.name, controller=joint.controller.scaled(1.3, 0.6))
    raw = recorded(true, 250.0, 17)
    seen, wanted = (observe(with_made_torque(raw, robot)) for robot in (arm, other))
    found = seen.corrected({}, {}, other)
    margin = round(seen.margin * seen.rate)
    for own, right in zip(found.quiet, wanted.quiet, strict=True):
        assert own.tau_m is not None and right.tau_m is not None
        np.testing.assert_allclose(
            own.tau_m[margin:-margin], right.tau_m[margin:-margin], rtol=0, atol=1e-4
        )
    np.testing.assert_allclose(found.scale(3), 1.3)
    (same,) = seen.corrected({}, {}, arm).quiet
    np.testing.assert_array_equal(same.tau_m, seen.quiet[0].tau_m)


def test_what_kd_deviates_acts_as_friction_does() -> None:
    """Another kd changes the made torque by what viscous friction of that size is in columns: of
    the quiet motion, whatever the noise of the speed."""
    arm = unlimited()
    seen = observe(with_made_torque(recorded(arm, 250.0, 12), arm.robot))
    controller = arm.robot.joints[2].controller
    assert controller is not None
    other = arm.robot.with_joint(arm.robot.joint_names[2], controller=controller.scaled(kd=2.0))
    found = seen.corrected({}, {}, other)
    for before, after, quiet in zip(seen.pieces, found.pieces, seen.quiet, strict=True):
        assert before.tau_m is not None and after.tau_m is not None and quiet.dq is not None
        more = after.tau_m[:, 2] - before.tau_m[:, 2]
        np.testing.assert_allclose(more, -controller.kd * quiet.dq[:, 2], atol=1e-12)
