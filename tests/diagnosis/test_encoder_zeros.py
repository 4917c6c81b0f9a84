"""Zeros of link encoders that differ from recording to recording."""

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.encoder_zeros import with_common_zeros
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)
STIFFNESS = np.array([joint.transmission.stiffness for joint in ROBOT.joints if joint.transmission])


def recording(
    zero: float, late: float = 0.0, compliance: float = 1.0, weight: float = 200.0
) -> Recording:
    """Two swings under load, the link encoder of joint 2 with a zero, all link encoders late.

    compliance: of the drives, in that of the description; weight: mean load, Nm.
    """
    stamps = np.arange(4000) * 1_000_000
    t = stamps[:, None] * 1e-9
    angle, torque = (
        0.5 * np.sin(np.pi * t + [0.0, 1.0, 2.0]),
        weight + 100.0 * np.sin(np.pi * t + [2.0, 0.0, 1.0]),
    )
    speed = 0.5 * np.pi * np.cos(np.pi * t + [0.0, 1.0, 2.0])
    link = angle - compliance * torque / STIFFNESS - late * speed + [0.0, zero, 0.0]
    return Recording(ROBOT.joint_names, Side(stamps, link), Side(stamps, angle, None, torque))


def test_a_zero_beyond_what_loads_can_wind_is_taken_out_of_each_recording() -> None:
    """Zeros of 0.02 and -0.02 rad leave, the lag of both stays, and a note names the joint."""
    found = with_common_zeros([recording(0.02, 1e-3), recording(-0.02, 1e-3)], ROBOT)
    true = recording(0.0, 1e-3)
    for one in found:
        assert one.link is not None and true.link is not None
        assert one.link.position is not None and true.link.position is not None
        np.testing.assert_allclose(one.link.position, true.link.position, atol=2e-5)
        assert "link encoder of joint_2 differs between" in one.notes[0] and len(one.notes) == 1


def test_a_common_zero_and_one_that_a_load_could_explain_stay() -> None:
    """One zero for all recordings is for the diagnosis to find; a small difference may be the
    drive's."""
    for zeros in ((0.02, 0.02), (0.0, 1e-3)):
        given = [recording(zero) for zero in zeros]
        assert with_common_zeros(given, ROBOT) == given


def test_what_a_weight_winds_that_the_torques_lack_stays() -> None:
    """Of torques without gravity, 10 Nm, the deflections that it makes in two poses are no zeros of
    encoders."""
    given = []
    for pose in (0.2, 0.8):
        angle = pose + 0.1 * np.sin(np.pi * 1e-3 * np.arange(4000)[:, None] + [0.0, 1.0, 2.0])
        states = np.hstack([angle, angle])
        weight = build_model(ROBOT).inverse_dynamics(states, 0.0 * states, 0.0 * states)[:, :3]
        stamps = np.arange(4000) * 1_000_000
        link = Side(stamps, angle - weight / STIFFNESS, None, np.full_like(angle, 10.0))
        given.append(Recording(ROBOT.joint_names, link, Side(stamps, angle)))
    wound = [one.motor.position - one.link.position for one in given if one.motor and one.link]
    assert np.abs(np.mean(wound[0] - wound[1], axis=0)).max() > 2.0 * 10.0 / STIFFNESS.min()
    assert with_common_zeros(given, ROBOT) == given


def test_what_a_softer_drive_deflects_stays() -> None:
    """A drive four times as soft as described deflects by other means under other loads."""
    given = [recording(0.0, compliance=4.0, weight=weight) for weight in (300.0, -200.0)]
    assert with_common_zeros(given, ROBOT) == given


def test_recordings_with_one_encoder_stay() -> None:
    """Without motor encoders there is nothing to compare with."""
    given = [replace(recording(zero), motor=None) for zero in (0.02, -0.02)]
    assert with_common_zeros(given, ROBOT) == given
