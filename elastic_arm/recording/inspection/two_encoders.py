"""Compare the encoders of link and motor of a joint.

For an arm that is described as rigid, both measure the same angle: the torque of a motor belongs to
the motion of its own encoder, and the link encoder only adds its lag and its zero. For any arm, the
two may differ by more than the deflection of the drive: theta - q = a + b q + tau / K + T dq, where
the zero a and the ratio b should vanish.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.report import FEWEST, Finding, about
from elastic_arm.recording.inspection.side_motion import independent
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples, joints_with, listed, span_of
from elastic_arm.robot import Robot

_LOOKED_AT = 5000  # samples; bounds the time
_TOGETHER = 0.01  # share of the motor angle's variance that the link angle may leave


def with_one_zero(recording: Recording, found: list[Finding]) -> Recording:
    """Remove a constant difference between motor and link encoders that exceeds the deflection of
    the drive: a zero that was not set."""
    zero, ratio, _ = _apart(recording)
    # 0.05 rad: zeros of encoders are set more accurately, and drives are assembled so
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
    """Return findings on joints whose two encoders differ by a ratio or a lag."""
    _, ratio, lag = _apart(recording)
    off = np.abs(ratio) > 5e-4  # a ratio with four digits is off by less
    times = ", ".join(f"{1.0 + each:.4f}" for each in ratio[off])
    words = f"are {times} times those of the link, apart from the deflection"
    remedy = "check the gear ratios and signs of the map, and the encoders' resolutions"
    found = about(recording.joints, off, "encoder_ratio", "motor positions", words, remedy)
    # 0.02 s: encoder filters and wind-up of a drive lag by less
    late = np.abs(lag) > 0.02
    # A late clock is the same for all joints, but the wind-up of drives, which follows the speed
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
    """Return the zero (n,) rad, ratio and lag, s, by which motors lead links; zero if uncertain."""
    found = np.zeros((3, recording.n))
    samples = _of_both_sides(recording)
    if samples is None:
        return found[0], found[1], found[2]
    q = samples.q
    theta = samples.theta
    assert q is not None and theta is not None
    every = slice(None, None, max(1, len(samples) // _LOOKED_AT))
    speeds = np.gradient(theta, samples.t, axis=0)
    loads = [x for x in (samples.tau_J, samples.tau_m, samples.dtheta) if x is not None]
    for j in range(recording.n):
        is_lacking = ("q", j) in samples.lacking or ("theta", j) in samples.lacking
        if not is_lacking and np.ptp(q[:, j]):
            columns = [each[every, j] for each in (q, speeds, *loads)]
            spread = float(np.var(theta[:, j]))
            found[:, j] = _differences((theta[:, j] - q[:, j])[every], columns, spread)
    return found[0], found[1], found[2]


def _of_both_sides(recording: Recording) -> Samples | None:
    """Return the samples of a recording with both encoders and a torque; None for any other."""
    link = recording.link
    motor = recording.motor
    if link is None or motor is None or link.position is None or motor.position is None:
        return None
    try:
        samples = recording.samples()
    except RecordingError:
        # Other checks report sides without a common time.
        return None
    has_angles = samples.q is not None and samples.theta is not None
    has_torque = samples.tau_J is not None or samples.tau_m is not None
    return samples if has_angles and has_torque and len(samples) >= FEWEST else None


def _differences(behind: Array, others: list[Array], spread: float) -> Array:
    """Return zero, ratio and lag (3,) of one joint; zero if uncertain.

        behind = theta - q = a + b q + T dtheta + ...

    behind: (N,) rad; others: columns (N,) of the ratio, the lag, and the loads; spread: variance of
    theta. The standard deviations account for the correlation of the remainder.
    """
    columns = np.column_stack([np.ones(len(behind)), *others])
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    unit = columns / scale
    fit, *_ = np.linalg.lstsq(unit, behind, rcond=None)
    rest = behind - columns @ (fit / scale)
    square = float(rest @ rest)
    variance = np.diag(np.linalg.pinv(unit.T @ unit, hermitian=True))
    std = np.sqrt(variance * square / independent(rest, rest))
    # Angles that do not go together are not those of one joint.
    together = square < _TOGETHER * len(rest) * spread
    sure = together & (np.abs(fit[:3]) > 5.0 * std[:3])
    return np.where(sure, fit[:3] / scale[:3], 0.0)


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
    """Return the lag of each link behind its motor (n,), s; NaN if one of the two is missing."""
    q = samples.q
    theta = samples.theta
    assert q is not None and theta is not None
    rate = np.gradient(theta, samples.t, axis=0) if samples.dtheta is None else samples.dtheta
    behind = theta - q
    moved = rate - rate.mean(axis=0)
    squares = np.sum(moved**2, axis=0)
    return np.sum(moved * behind, axis=0) / np.where(squares > 0.0, squares, np.nan)
