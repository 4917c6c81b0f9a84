"""Bearings that tilt."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from elastic_arm.effects.base import Effect, Parameter, Role, Scope, Stage, StructuralEffect
from elastic_arm.effects.motion import Contribution, Motion
from elastic_arm.errors import EffectError


def law(motion: Motion, i: int, p: Mapping[str, Any]) -> Contribution:
    """Nothing of its own: the tilts are coordinates of the arm's equations."""
    return motion.nothing()


def change(stage: Stage, p: Mapping[str, Any]) -> Stage:
    """Free the tilts q_x, q_y, with the arm file's bearings times the scale."""
    joints = []
    for joint in stage.robot.joints:
        gear = joint.transmission
        if gear is None or gear.bearing is None:
            raise EffectError(
                f"{joint.name} of robot {stage.robot.name} has no bearing",
                "Give its stiffness and damping in the arm file.",
            )
        bearing = replace(gear.bearing, stiffness=gear.bearing.stiffness * p["stiffness_scale"])
        joints.append(replace(joint, transmission=replace(gear, bearing=bearing)))
    return replace(stage, robot=stage.robot.with_(joints=tuple(joints)), bearings=True)


EFFECT: Effect = StructuralEffect(
    id="bearing_compliance",
    formula="tilts q_ix, q_iy of every joint, bearing stiffness times the scale",
    description="The joints' bearings give way about x and y; the model holds them rigid.",
    signature="Link residuals of all joints that grow with the tilting moments and ring at the bearings' resonances.",
    law=law,
    parameters=(
        Parameter(
            "stiffness_scale", "1", 0.01, 10.0, role=Role.SEARCHED, default=1.0, above=0.0, meaning="true / arm file"
        ),
    ),
    scope=Scope.ARM,
    sides=("link",),
    regime="frequency",
    change=change,
)
