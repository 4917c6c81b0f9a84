"""The arm with its causes: the description that makes the simulator behave like the recording."""

from collections.abc import Collection
from typing import Any

import numpy as np

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.result import Cause, Diagnosis
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.effect import ControllerEffect, Plant, SensorEffect
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.identification.batch.mounting import mounted
from elastic_arm.robot import Robot, with_joints_of
from elastic_arm.sensors import Sensors


def repaired_robot(robot: Robot, diagnosis: Diagnosis, taken_back: Collection[str] = ()) -> Robot:
    """Return the arm with the numbers and causes that were found, and the known effects at the
    sizes that were found.

    Effects of a model variant are left out: use that variant. Ordinary drifts are also left out,
    because they belong to the recording and would grow without bound in a simulation.

    taken_back: joints, and effects of the whole arm, that stay as described.
    """
    context = diagnosis.context
    written = [
        cause for cause in diagnosis.causes if (cause.joint or cause.effect) not in taken_back
    ]
    causes = [cause.instance.to_dict() for cause in written if cause.held_as == "effect"]
    own = {(one["effect"], one["joint"]) for one in causes}
    known = robot.effects if context is None else _known(context)
    kept = [one for one in known if (one["effect"], one["joint"]) not in own]
    arm = (robot if context is None else context.model.robot).with_(effects=(*kept, *causes))
    arm = with_joints_of(arm, robot, taken_back)
    for cause in written:
        if cause.held_as == "controller" and not _is_number(cause, arm):
            arm = cause.instance.effect.added_to(Plant(arm, Sensors.exact()), cause.instance).robot
        if cause.effect == TILT and cause.held_as == "number":
            # The cause is the whole rotation from the described base; the model has a rounded one.
            x, y = (float(cause.parameters[axis].value) for axis in "xy")
            arm = mounted(arm.with_(base_placement=robot.base_placement), x, y)
    return _with_firmware_of(robot, arm)


def _is_number(cause: Cause, arm: Robot) -> bool:
    """Whether a cause at a controller is a number of the arm, which the arm has already."""
    effect = cause.instance.effect
    if cause.joint is None or not isinstance(effect, ControllerEffect):
        return bool(effect.number)
    return bool(effect.number_at(arm.joints[arm.joint_names.index(cause.joint)]))


def _with_firmware_of(robot: Robot, arm: Robot) -> Robot:
    """Return an arm with the described firmware where only the electrics made torques, of a
    recorded duty."""
    for stated, own in zip(robot.joints, arm.joints, strict=True):
        if own.follows_duty and own.controller is not None and stated.controller is not None:
            whole = stated.controller.with_electrics_of(own.controller)
            arm = arm.with_joint(own.name, controller=whole)
    return arm


def units_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the parts of a correction that can be taken back: joints, and causes of the whole
    arm."""
    whole = [cause.effect for cause in diagnosis.causes if cause.joint is None]
    return (*diagnosis.joints, *whole)


def _known(context: DiagnosisContext) -> list[dict[str, Any]]:
    known = (*context.known, *context.unseen)
    return [instance.to_dict() for instance in known if not _drifts(instance)]


def _drifts(instance: EffectInstance) -> bool:
    """Whether a sensor's error grows with time."""
    return isinstance(instance.effect, SensorEffect) and instance.effect.in_time


def deviations(diagnosis: Diagnosis) -> dict[tuple[str, str | None, str], float]:
    """Return the standard deviations of the causes' scalar parameters, by effect, joint and
    parameter."""
    return {
        (cause.effect, cause.joint, name): float(estimate.std)
        for cause in diagnosis.causes
        for name, estimate in cause.parameters.items()
        if np.ndim(estimate.std) == 0 and estimate.std
    }
