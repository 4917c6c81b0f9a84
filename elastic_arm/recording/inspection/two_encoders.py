"""Compare the encoders of link and motor of a joint.

For an arm that is described as rigid, both measure the same angle: the torque of a motor belongs to
the motion of its own encoder, and the link encoder only adds its lag and its zero. For any arm, the
two may differ by more than the deflection of the drive: theta - q = a + b q + tau / K + T dq, where
the zero a and the ratio b should vanish.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import fftconvolve

from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.report import FEWEST, Finding, about
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples, joints_with, listed, span_of
from elastic_arm.robot import Robot

_LOOKED_AT = 5000  # samples; bounds the time
_TOGETHER = 0.01  # of the squares of the motor's angle, that the link's does not explain


def with_one_zero(recording: Recording, found: list[Finding]) -> Recording:
    """Remove a constant difference between motor and link encoders that exceeds the deflection of
    the drive.

    It is a zero that was not set.
    """
    zero, ratio, _ = _apart(recording)
    # 0.05 rad; encoders are set to zero more closely than that, and no drive is assembled so
    off = (np.abs(zero) > 0.05) & (np.abs(ratio) < _TOGETHER)
    motor = recording.motor
    if motor is None or motor.position is None or not off.any():
        return recording
    words = f"differ by {span_of(zero[off])} rad throughout"
    remedy = (
        "more than the deflection of a drive: an encoder without reference? The"
        " motor's angle is corrected by this difference"
    )
    found += about(recording.joints, off, "encoder_zeros", "motor and link position", words, remedy)
    return replace(
        recording, motor=replace(motor, position=motor.position - np.where(off, zero, 0.0))
    )


def disagreeing(recording: Recording) -> list[Finding]:
    """Return at which joints the two encoders differ by a ratio or a lag."""
    _, ratio, lag = _apart(recording)
    off = np.abs(ratio) > 5e-4  # a ratio that is given with four digits is off by less
    times = ", ".join(f"{1.0 + each:.4f}" for each in ratio[off])
    words = f"are {times} times those of the link, apart from the deflection"
    remedy = "check the gear ratios and signs of the map, and the encoders' resolutions"
    found = about(recording.joints, off, "encoder_ratio", "motor positions", words, remedy)
    # 0.02 s; filters of encoders and a drive's wind-up lag by less
    late = np.abs(lag) > 0.02
    # One clock is late for all joints alike; the wind-up of drives, which goes with the speed
    # through friction, is not.
    if late.any() and not (np.abs(lag - np.median(lag)) < 0.2 * np.abs(np.median(lag))).all():
        late = np.zeros_like(late)
    where = "lead" if lag[late].sum() > 0.0 else "lag"
    apart = f"{where} those of the link by {span_of(1e3 * np.abs(lag[late]))} ms"
    clocks = (
        "two clocks, or arrival times on one side? Record both with one clock, or"
        " shift the stamps of one"
    )
    return found + about(recording.joints, late, "sides_apart", "motor positions", apart, clocks)


def _apart(recording: Recording) -> tuple[Array, Array, Array]:
    """Return by how much motors lead links: (n,) rad, as a share of the angle, and s; zero if
    uncertain."""
    zero, part, lag = np.zeros((3, recording.n))
    link = recording.link
    motor = recording.motor
    if link is None or motor is None or link.position is None or motor.position is None:
        return zero, part, lag
    try:
        samples = recording.samples()
    except RecordingError:
        # Sides that have no time in common are for others to refuse.
        return zero, part, lag
    q = samples.q
    theta = samples.theta
    if q is None or theta is None or len(samples) < FEWEST:
        return zero, part, lag
    if samples.tau_J is None and samples.tau_m is None:
        return zero, part, lag
    speeds = np.gradient(theta, samples.t, axis=0)
    every = slice(None, None, max(1, len(samples) // _LOOKED_AT))
    loads = [x for x in (samples.tau_J, samples.tau_m, samples.dtheta) if x is not None]
    for j in range(recording.n):
        if {("q", j), ("theta", j)} & samples.lacking or not np.ptp(q[:, j]):
            continue
        own = [each[every, j] for each in (q, speeds, *loads)]
        columns = np.column_stack([np.ones(len(own[0])), *own])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        behind = (theta[:, j] - q[:, j])[every]
        fit, *_ = np.linalg.lstsq(columns / scale, behind, rcond=None)
        rest = behind - columns @ (fit / scale)
        alike = fftconvolve(rest, rest[::-1])[len(rest) :] / max(float(rest @ rest), 1e-300)
        inverse = np.linalg.pinv((columns / scale).T @ (columns / scale), hermitian=True)
        slow = 1.0 + 2.0 * float(alike @ alike)
        doubt = np.sqrt(np.diag(inverse) * float(rest @ rest) / len(rest) * slow)
        # Angles that have nothing to do with each other are not two of one joint.
        together = float(rest @ rest) < _TOGETHER * len(rest) * float(np.var(theta[:, j]))
        sure = together & (np.abs(fit[:3]) > 5.0 * doubt[:3])  # standard deviations
        zero[j], part[j], lag[j] = np.where(sure, fit[:3] / scale[:3], 0.0)
    return zero, part, lag


def by_motor_encoders(recording: Recording, robot: Robot) -> Recording:
    """Return the recording of a rigid arm with motor encoders as link encoders, and a note.

    This applies if motors have an encoder and a torque, and links have no encoder. Recordings of
    other arms, and those with joint torques, which belong to the links, are returned unchanged.
    """
    link = recording.link
    motor = recording.motor
    if robot.elastic or link is None or motor is None or link.effort is not None:
        return recording
    if link.position is None or motor.position is None or motor.effort is None:
        return recording
    both = joints_with(link.position) & joints_with(motor.position) & joints_with(motor.effort)
    if not both.any():
        return recording
    channels: dict[str, Any] = {
        name: np.where(both, np.nan, values) for name, values in link.channels().items()
    }
    rest = None if np.isnan(channels["position"]).all() else replace(link, **channels)
    lags = _lags(recording.samples())[both]
    where = "lag" if np.median(lags) > 0.0 else "lead"
    note = (
        f"{listed(recording.joints, both)}: the arm is described as rigid, so the"
        f" motor encoders are used instead of the link encoders, which {where} them by"
        f" {span_of(1e3 * np.abs(lags))} ms (only with transmissions in the arm file"
        " can an encoder lag be separated from damping)"
    )
    return replace(recording, link=rest, notes=(*recording.notes, f"{recording.source}: {note}."))


def _lags(samples: Samples) -> Array:
    """Return by how much the link of each joint (n,) lags behind its motor, s; NaN if one of the
    two is missing."""
    q = samples.q
    theta = samples.theta
    assert q is not None and theta is not None
    rate = np.gradient(theta, samples.t, axis=0) if samples.dtheta is None else samples.dtheta
    behind = theta - q
    moved = rate - rate.mean(axis=0)
    squares = np.sum(moved**2, axis=0)
    return np.asarray(np.sum(moved * behind, axis=0) / np.where(squares > 0.0, squares, np.nan))
