"""Numbers that no sensors of a moving arm measure are found; sensors with ordinary noise are not
blamed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy

from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag, misread
from elastic_arm.recording.inspection.plausibility import implausible, smoothed_torques
from elastic_arm.recording.inspection.report import WrongMotion
from elastic_arm.recording.inspection.torque_spectrum import torque_spectra, torque_spectrum
from tests.helpers.bags import JOINTS
from tests.helpers.random_arms import random_arm

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
RATE = 500.0
COUNT = 6000


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles, rates and torques of three joints at the times given: sums of sinusoids below 2
    Hz."""
    w = 2 * np.pi * np.array([[0.31, 0.43, 0.57], [0.91, 1.13, 1.37]])
    phase = np.array([[0.0, 1.0, 2.0], [0.5, 0.1, 0.9]])
    angle = w[:, None] * t[:, None] + phase[:, None]
    q = np.sum(0.4 * np.sin(angle), axis=0)
    dq = np.sum(0.4 * w[:, None] * np.cos(angle), axis=0)
    return (
        q,
        dq,
        30 * np.cos(q) + 2 * np.tanh(dq) - 3 * np.sum(w[:, None] ** 2 * np.sin(angle), axis=0),
    )


def arm(
    stamped: np.ndarray | None = None, taken: np.ndarray | None = None, seed: int = 0
) -> Recording:
    """Both sides of an arm with ordinary sensors: 18-bit encoders, noisy rates and torques."""
    rng = np.random.default_rng(seed)
    even = np.arange(COUNT) / RATE
    q, dq, tau = motion(even if taken is None else taken)
    step = 2 * np.pi / 2**18
    stamp_ns = 10**18 + np.rint((even if stamped is None else stamped) * 1e9).astype(np.int64)

    def side(angle: np.ndarray) -> Side:
        noisy = dq + 1e-3 * rng.normal(size=q.shape), tau + 0.26 * rng.normal(size=q.shape)
        return Side(stamp_ns, np.rint(angle / step) * step, *noisy)

    return Recording(JOINTS, link=side(q), motor=side(q + 3e-3 * np.cos(q)))


def changed(recording: Recording, side: str, **channels: np.ndarray) -> Recording:
    """The recording with some channels of one side replaced."""
    return replace(recording, **{side: replace(getattr(recording, side), **channels)})


def backward(recording: Recording) -> list[str]:
    """What is said of torques that take energy out of the motion."""
    return [
        finding.message for finding in implausible(recording) if finding.code == "backward_torque"
    ]


def codes(recording: Recording) -> set[str]:
    """The codes of all findings."""
    return {finding.code for finding in implausible(recording)}


@pytest.mark.parametrize("seed", range(5))
def test_ordinary_sensors_are_not_blamed(seed: int) -> None:
    """Quantised encoders, white noise and stamps that jitter with the samples give no finding."""
    even = np.arange(COUNT) / RATE
    late = even + np.random.default_rng(seed).normal(scale=2e-4, size=COUNT)
    assert codes(arm(seed=seed)) == set()
    assert codes(arm(late, late, seed)) == set()


@pytest.mark.parametrize("channel", ["position", "velocity"])
def test_degrees_beside_radians_are_told_from_another_factor(channel: str) -> None:
    """Degrees in one channel of a joint: that channel is named; of a factor that is no unit, the
    factor. Angles in degrees are no motion of the arm to compare torques with."""
    recording = arm()
    given = getattr(recording.link, channel)
    degrees = changed(recording, "link", **{channel: given * [1.0, 180 / np.pi, 1.0]})
    (finding,) = implausible(degrees)
    assert (finding.severity, finding.code) == ("warning", "other_unit")
    assert f"link {channel} of joint_2 is probably in degrees" in finding.message
    assert isinstance(finding, WrongMotion) == (channel == "position")
    (finding,) = implausible(changed(recording, "link", **{channel: given * [1.0, 50.0, 1.0]}))
    assert (finding.severity, finding.code) == ("warning", "velocity")
    assert f"of joint_2 is {50.0 if channel == 'velocity' else 0.02:g} times" in finding.message


@pytest.mark.parametrize("channel", ["position", "velocity"])
def test_no_cause_is_sought_where_one_channel_is_in_degrees(channel: str) -> None:
    """All angles, or all rates, in degrees are misread; as they were recorded, they are not."""
    recording = replace(arm(), motor=None)
    robot = random_arm(3, np.random.default_rng(0), elastic=False).with_(gravity=(0.0, 0.0, 0.0))
    degrees = np.rad2deg(getattr(recording.link, channel))
    assert misread([recording], robot, explained=True) is None
    words = misread([changed(recording, "link", **{channel: degrees})], robot, explained=True)
    assert words is not None and f"{channel} of all joints is probably in degrees" in words


def test_a_velocity_of_another_joint_is_found() -> None:
    """Exchanged columns are no derivative of the position."""
    recording = arm()
    (finding,) = implausible(
        changed(recording, "motor", velocity=recording.motor.velocity[:, [1, 0, 2]])
    )
    assert finding.code == "velocity"
    assert "joint_1, joint_2 is not the derivative" in finding.message


def test_a_late_velocity_is_found_with_its_lag() -> None:
    """A velocity that was filtered, 8 ms behind the position, is a note."""
    recording = arm()
    late = np.roll(recording.link.velocity, 4, axis=0)
    late[:4] = late[4]
    (finding,) = implausible(changed(recording, "link", velocity=late))
    assert (finding.severity, finding.code) == ("note", "velocity_lag")
    assert "all joints is" in finding.message and "ms behind" in finding.message


def test_a_motor_torque_of_the_wrong_sign_is_found() -> None:
    """Dry friction of a joint gives energy where its torque has the other sign; a sensor behind the
    drive may."""
    recording = arm()
    rates = recording.motor.velocity
    torque = recording.motor.effort + 30.0 * np.sign(rates)
    assert not backward(changed(recording, "motor", effort=torque))
    torque[:, 1] *= -1.0
    (words,) = backward(changed(recording, "motor", effort=torque))
    assert "effort of joint_2 removes energy" in words
    assert not backward(changed(recording, "link", effort=torque))


def test_a_motor_torque_of_the_wrong_sign_is_found_beside_the_encoders_of_the_links() -> None:
    """An arm with one encoder a joint has its angles on the link's side, with stamps of their
    own."""
    recording = arm()
    torque = recording.motor.effort + 30.0 * np.sign(recording.motor.velocity)
    alone = Side(recording.motor.stamp_ns[:-7] + 300_000, effort=torque[:-7])
    assert not backward(replace(recording, motor=alone))
    (words,) = backward(
        replace(recording, motor=replace(alone, effort=alone.effort * [1.0, 1.0, -1.0]))
    )
    assert "effort of joint_3 removes energy" in words
    assert not backward(replace(recording, link=None, motor=replace(alone, effort=-alone.effort)))


def test_an_axis_that_brakes_the_others_is_not_of_the_wrong_sign() -> None:
    """A coupled axis that moves with the one before it feels more of that one's friction than it
    has of its own."""
    motor = arm().motor
    position, rates = (
        one + 0.9 * one[:, [1]] * [0.0, 0.0, 1.0] for one in (motor.position, motor.velocity)
    )
    torque = motor.effort + 30.0 * np.sign(rates)
    torque[:, 2] -= 90.0 * np.sign(rates[:, 1]) + 60.0 * rates[:, 1]
    assert not backward(changed(arm(), "motor", position=position, velocity=rates, effort=torque))


def test_regular_stamps_on_samples_taken_irregularly_are_made_up() -> None:
    """Samples taken 0.2 ms (std) beside their perfectly regular stamps: all joints tell of the same
    times."""
    even = np.arange(COUNT) / RATE
    assert codes(arm(even, even + np.random.default_rng(3).normal(scale=2e-4, size=COUNT))) == {
        "made_up_stamps"
    }


def test_stamps_of_arrival_are_found() -> None:
    """Stamps that jitter while the samples were taken regularly do not belong to the motion."""
    even = np.arange(COUNT) / RATE
    assert codes(arm(even + np.random.default_rng(3).normal(scale=2e-4, size=COUNT), even)) == {
        "arrival_stamps"
    }


def test_a_smoothed_torque_is_found_with_its_band() -> None:
    """A torque that passed a zero-phase low-pass at 5 Hz holds nothing above some 20 Hz."""
    recording = arm()
    sections = scipy.signal.butter(4, 5.0, fs=RATE, output="sos")
    smooth = scipy.signal.sosfiltfilt(sections, recording.motor.effort, axis=0)
    filtered = changed(recording, "motor", effort=smooth)
    (finding,) = implausible(filtered)
    assert finding.code == "smooth_torque"
    assert smoothed_torques(filtered) == [finding.message] and smoothed_torques(recording) == []
    assert 5.0 < float(finding.message.split("above ")[1].split()[0]) < 30.0


def test_a_model_in_the_place_of_a_sensor_is_found() -> None:
    """A torque computed from filtered encoders has less noise than any converter."""
    recording = arm()
    computed = motion(np.arange(COUNT) / RATE)[2] + 1e-4 * np.random.default_rng(1).normal(
        size=(COUNT, 3)
    )
    (finding,) = implausible(changed(recording, "link", effort=computed))
    assert (finding.severity, finding.code) == ("warning", "computed_torque")


def test_one_encoder_given_twice_is_found() -> None:
    """The same numbers on both sides, whatever their zero, are one encoder."""
    recording = arm()
    shifted = recording.motor.position + np.array([0.0, 0.3, 0.0])
    (finding,) = implausible(changed(recording, "link", position=shifted))
    assert finding.code == "same_position"
    assert "all joints" in finding.message


def test_the_check_of_a_bag_lists_them(tmp_path: Path) -> None:
    """`bag check` ends with a warning and the joint's name."""
    recording = arm()
    folder = write_recording(
        tmp_path / "bag", changed(recording, "link", velocity=-recording.link.velocity)
    )
    report = check_bag(folder)
    assert report.usable and not report.ok
    assert any(
        finding.code == "velocity" and "-1 times" in finding.message for finding in report.findings
    )


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recordings of real robots")
def test_low_passed_torques_of_real_robots_are_found() -> None:
    """The UR10's currents and the LWR 4+'s joint torques hold nothing above 6 Hz, as is known of
    them."""
    ur10 = read_recording(SHARED / "ur10" / "ur10_exciting_trajectory.db3")
    mapping = ROOT / "examples" / "kuka_lwr4" / "import.yaml"
    lwr4 = import_arrays(SHARED / "kuka_lwr4" / "measurements_1.npz", mapping)
    assert codes(ur10) == codes(lwr4) == {"smooth_torque"}


def test_velocities_beside_stamps_of_a_wrong_unit_are_compared() -> None:
    """Milliseconds taken for seconds make the motion a thousand times slower than its velocities:
    no standstill."""
    recording = arm()
    slow = replace(recording.link, stamp_ns=1000 * (recording.link.stamp_ns - 10**18))
    (finding,) = implausible(Recording(JOINTS, link=slow))
    assert (
        finding.code == "velocity"
        and "1000 times the derivative of the position" in finding.message
    )
    assert "the unit of the times: the sample rate is 0.5 Hz" in finding.message


SLOW_RATE = 200.0


def torque(seconds: float = 30.0) -> np.ndarray:
    """Return torques (N, 2) of slow motion with dry friction and white noise, Nm."""
    t = np.arange(round(seconds * SLOW_RATE)) / SLOW_RATE
    rng = np.random.default_rng(7)
    slow = np.stack([20.0 * np.sin(1.3 * t), 5.0 * np.cos(2.1 * t)], axis=1)
    friction = 3.0 * np.sign(np.stack([np.cos(1.3 * t), -np.sin(2.1 * t)], axis=1))
    return slow + friction + rng.normal(0.0, 0.2, slow.shape)


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("corner", [2.0, 5.0])
def test_the_knee_is_where_the_filter_begins(order: int, corner: float) -> None:
    """A zero-phase Butterworth filter of 2 or 5 Hz is found to a third of its corner, and nothing
    is left far above."""
    sections = scipy.signal.butter(order, corner, fs=SLOW_RATE, output="sos")
    found = torque_spectrum(scipy.signal.sosfiltfilt(sections, torque(), axis=0), SLOW_RATE)
    assert found.low_passed.all() and not found.computed.any()
    np.testing.assert_allclose(found.knee, corner, rtol=0.35)
    assert np.all(found.end > found.knee)


def test_a_torque_with_noise_has_no_knee() -> None:
    """White noise of a sensor, however small, is no low pass."""
    found = torque_spectrum(torque(), SLOW_RATE)
    assert not found.low_passed.any() and np.isinf(found.knee).all() and np.isinf(found.end).all()


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recordings of real robots")
def test_the_low_pass_of_a_real_robot_is_found() -> None:
    """The UR10's currents were low-passed at 2 Hz, as its recording's source states."""
    (found,) = torque_spectra(
        read_recording(SHARED / "ur10" / "ur10_exciting_trajectory.db3")
    ).values()
    assert np.median(found.knee) == pytest.approx(2.0, rel=0.15)
    assert 1.0 < found.band < np.median(found.knee)
