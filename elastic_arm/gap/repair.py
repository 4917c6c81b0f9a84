"""The arm with its causes in it: what the simulator needs to behave like the recording."""

from __future__ import annotations

from elastic_arm.gap.result import Diagnosis
from elastic_arm.robot import Robot


def repaired_robot(robot: Robot, diagnosis: Diagnosis) -> Robot:
    """Return the nominal arm with the effects that the diagnosis found, besides those it had."""
    model_has_them = ("spline_inertia", "inertia_coupling")
    found = [c.active.to_dict() for c in diagnosis.causes if c.effect not in model_has_them]
    return robot.with_(effects=(*robot.effects, *found))
