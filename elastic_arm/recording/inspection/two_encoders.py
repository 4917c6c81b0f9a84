"""Encoders of links and of motors of an arm that is described as rigid: both measure one angle.

The torque of a motor goes with the motion of its own encoder. What a link's encoder has besides is its lag, its zero
and the compliance of a drive, of which a rigid arm has none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.recording.inspection.plausibility import listed, span_of
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples, joints_with
from elastic_arm.robot import Robot


def by_motor_encoders(recording: Recording, robot: Robot) -> Recording:
    """Return a recording of a rigid arm without link encoders where motors have an encoder and a torque, with a note.

    That of any other arm, and one with joint torques, which go with the links, is returned as it is.

    Parameters
    ----------
    recording
        Of the arm.
    robot
        Its description.
    """
    link, motor = recording.link, recording.motor
    if robot.elastic or link is None or motor is None or link.effort is not None:
        return recording
    if link.position is None or motor.position is None or motor.effort is None:
        return recording
    both = joints_with(link.position) & joints_with(motor.position) & joints_with(motor.effort)
    if not both.any():
        return recording
    channels: dict[str, Any] = {name: np.where(both, np.nan, values) for name, values in link.channels().items()}
    rest = None if np.isnan(channels["position"]).all() else replace(link, **channels)
    lags = _lags(recording.samples())[both]
    where = "behind" if np.median(lags) > 0.0 else "ahead of"
    note = (
        f"{listed(recording.joints, both)}: the arm is described as rigid, so the encoders of the motors are used, not "
        f"those of the links, which are {span_of(1e3 * np.abs(lags))} ms {where} them (an arm file with transmissions "
        "tells a lag of the encoders from damping)"
    )
    return replace(recording, link=rest, notes=(*recording.notes, f"{recording.source}: {note}."))


def _lags(samples: Samples) -> Array:
    """Return by how much the link of each joint (n,) is behind its motor, s; NaN where one of the two is missing."""
    q, theta = samples.q, samples.theta
    assert q is not None and theta is not None
    rate = np.gradient(theta, samples.t, axis=0) if samples.dtheta is None else samples.dtheta
    behind, moved = theta - q, rate - rate.mean(axis=0)
    squares = np.sum(moved**2, axis=0)
    return np.asarray(np.sum(moved * behind, axis=0) / np.where(squares > 0.0, squares, np.nan))
