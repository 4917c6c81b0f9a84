"""Zeros of link encoders that differ from recording to recording.

An encoder that is referenced at each start has another zero in each recording. The two angles of a
joint then differ by a constant that changes by more than any load could wind the drive.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot

# deflections under the largest torque or weight: loads of both signs differ by this much
BEYOND_LOAD = 2.0


def with_common_zeros(recordings: Sequence[Recording], robot: Robot) -> list[Recording]:
    """Remove the zeros of link encoders that differ between recordings; notes state them.

    robot: its description provides the stiffness of the drives.
    """
    both = [r for r in recordings if _has_both_encoders(r)]
    if len(both) < 2 or len(both) < len(recordings) or not robot.elastic:
        return list(recordings)
    stiffness = np.array(
        [joint.transmission.stiffness if joint.transmission else np.inf for joint in robot.joints]
    )
    equations = ArmEquations(robot)
    observed = [_observed(recording, equations) for recording in both]
    zeros = np.array([_zeros(observed, j, stiffness[j]) for j in range(robot.n)]).T
    largest = np.array([one.largest for one in observed])
    moved = np.ptp(zeros, axis=0) > BEYOND_LOAD * np.nanmax(largest, axis=0) / stiffness
    if not moved.any():
        return list(recordings)
    notes = tuple(_note(robot.joint_names[j], zeros[:, j]) for j in np.flatnonzero(moved))
    return [
        _shifted(r, np.where(moved, own, 0.0), notes) for r, own in zip(both, zeros, strict=True)
    ]


def _has_both_encoders(recording: Recording) -> bool:
    sides = (recording.link, recording.motor)
    return all(side is not None and side.position is not None for side in sides)


class _Observed(NamedTuple):
    """The quantities from which the zeros of one recording are estimated."""

    apart: Array  # (N, n) rad, angle of the link minus that of the motor
    load: Array  # (N, n) Nm, torque that winds the drive
    speed: Array  # (N, n) rad/s
    largest: Array  # (n,) Nm, the largest torque or weight


def _observed(recording: Recording, equations: ArmEquations) -> _Observed:
    samples = recording.samples()
    assert samples.q is not None and samples.theta is not None
    torque = samples.tau_J if samples.tau_J is not None else samples.tau_m
    load = np.zeros_like(samples.q) if torque is None else torque
    apart = samples.q - samples.theta
    apart[:, [joint for channel, joint in samples.lacking if channel in ("q", "theta")]] = 0.0
    rest = np.zeros((len(load), 2 * recording.n))  # a torque may be recorded without the weight
    _, pull = equations.moved_and_pulled(
        np.hstack([samples.q, samples.theta]), rest, rest, motors=False
    )
    largest = np.fmax(np.abs(load).max(axis=0), np.abs(pull @ equations.robot.gravity).max(axis=0))
    return _Observed(apart, load, np.gradient(samples.theta, samples.t, axis=0), largest)


def _zeros(observed: Sequence[_Observed], joint: int, stiffness: float) -> Array:
    """Return the zeros (recordings,) rad of a link encoder relative to that of its motor.

        q - theta = zero_r + lag_r dtheta - (1 + x) tau / K

    The lag of the encoder may differ between recordings. The deviation x of the compliance is
    common to all. Otherwise, if the mean loads differ, another stiffness than the described one
    would appear as different zeros.
    """
    count = len(observed)
    rows = []
    apart = []
    for r, one in enumerate(observed):
        wound = one.load[:, joint] / stiffness
        own = np.zeros((len(wound), 2 * count + 1))
        own[:, r] = 1.0
        own[:, count + r] = one.speed[:, joint]
        own[:, -1] = -wound
        rows.append(own)
        apart.append(one.apart[:, joint] + wound)
    found = np.linalg.lstsq(np.vstack(rows), np.concatenate(apart), rcond=None)[0]
    return found[:count]


def _shifted(recording: Recording, zeros: Array, notes: tuple[str, ...]) -> Recording:
    link = recording.link
    assert link is not None and link.position is not None
    return replace(
        recording,
        link=replace(link, position=link.position - zeros),
        notes=(*recording.notes, *notes),
    )


def _note(joint: str, zeros: Array) -> str:
    sizes = ", ".join(f"{1e3 * zero:.3g}" for zero in zeros)
    return (
        f"The zero of the link encoder of {joint} differs between the recordings ({sizes} mrad"
        " relative to the motor encoder, in their order): it is removed from each recording."
    )
