"""Torques with one constant value: they were not recorded, whatever their messages contain.

Of a single joint beside others, that is certain only while it moves: at rest a torque may well be
constant.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Mask
from elastic_arm.recording.inspection.stuck_channels import least_travel
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import joints_with, listed
from elastic_arm.robot import Robot

TORQUES = {
    "link": "joint torque (effort of the link side)",
    "motor": "motor torque (effort of the motor side)",
}


def without_dead_torques(recording: Recording, robot: Robot) -> tuple[Recording, tuple[str, ...]]:
    """Return a recording without torques that are constant, and the torques that are so at all
    joints; its notes name them."""
    where = recording.source or "the recording"
    moving = _moving(recording, robot)
    kept: dict[str, Any] = {}
    notes = []
    dead = []
    for name, side in recording.measured().items():
        if side.effort is None or not len(side):
            continue
        there = joints_with(side.effort)
        constant = there & (np.ptp(side.effort, axis=0) == 0.0)
        if not constant.any():
            continue
        if constant[there].all():
            dead.append(TORQUES[name])
            kept[name] = replace(side, effort=None)
            notes.append(f"{where}: {TORQUES[name]} is constant and treated as not recorded.")
            continue
        lost = constant & moving
        kept[name] = replace(side, effort=np.where(lost, np.nan, side.effort))
        for which, words in (
            (lost, "is constant while the joint moves, and treated as not recorded"),
            (constant & ~moving, "is constant: results for them are unreliable"),
        ):
            if which.any():
                joints = listed(recording.joints, which)
                notes.append(f"{where}: {TORQUES[name]} of {joints} {words}.")
    if not kept:
        return recording, ()
    return replace(recording, **kept, notes=(*recording.notes, *notes)), tuple(dead)


def _moving(recording: Recording, robot: Robot) -> Mask:
    """Return which joints (n,) move for certain, on either side."""
    found = np.zeros(recording.n, np.bool_)
    least = least_travel(recording, robot)
    for side in recording.measured().values():
        if side.position is not None and len(side):
            found |= np.ptp(side.position, axis=0) > least
    return found
