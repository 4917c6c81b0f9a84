"""Zeros of link encoders that differ from recording to recording.

An encoder that is referenced anew at each start has a zero of its own in each recording. It shows
as a constant between the two angles of a joint that differs by more than any load could wind the
drive.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot

# times the deflection under the largest torque or weight: loads of both signs differ by as much
BEYOND_LOAD = 2.0


def with_common_zeros(recordings: Sequence[Recording], robot: Robot) -> list[Recording]:
    """Take out the zeros of link encoders that are not the same in all recordings; notes state
    them.

    robot: its description: the stiffness of the drives is taken from it.
    """
    both = [r for r in recordings if _has_both_encoders(r)]
    if len(both) < 2 or len(both) < len(recordings) or not robot.elastic:
        return list(recordings)
    stiffness = np.array(
        [joint.transmission.stiffness if joint.transmission else np.inf for joint in robot.joints]
    )
    equations = ArmEquations(robot)
    found = [_zeros(recording, stiffness, equations) for recording in both]
    zeros, largest = (np.array(column) for column in zip(*found, strict=True))
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


def _zeros(recording: Recording, stiffness: Array, equations: ArmEquations) -> tuple[Array, Array]:
    """Return the zeros (n,) rad of the link encoders beside the motors', and the largest torques
    (n,) Nm.

    The lag of one encoder, in proportion to speed, and the deflection under the mean torque are no
    part of it.
    """
    samples = recording.samples()
    assert samples.q is not None and samples.theta is not None
    torque = samples.tau_J if samples.tau_J is not None else samples.tau_m
    load = np.zeros_like(samples.q) if torque is None else torque
    apart = samples.q - samples.theta + load / stiffness
    apart[:, [joint for channel, joint in samples.lacking if channel in ("q", "theta")]] = 0.0
    speed = np.gradient(samples.theta, samples.t, axis=0)
    slope = np.sum((speed - speed.mean(axis=0)) * apart, axis=0) / np.maximum(
        np.sum(speed**2, axis=0), 1e-300
    )
    rest = np.zeros((len(load), 2 * recording.n))  # a torque may be recorded without the weight
    _, pull = equations.moved_and_pulled(
        np.hstack([samples.q, samples.theta]), rest, rest, motors=False
    )
    largest = np.fmax(np.abs(load).max(axis=0), np.abs(pull @ equations.robot.gravity).max(axis=0))
    return np.asarray(np.mean(apart - slope * speed, axis=0)), largest


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
