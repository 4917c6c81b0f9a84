"""The arm that has the parameters found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.composition import ARMATURE, inertia_from
from elastic_arm.effects import EffectInstance
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistency.chart import folded
from elastic_arm.robot import Robot

# A link's mass over the described one, beyond which something else is at work. Of eight real arms of right signs, some
# of their masses guessed, links came out at 0.12 to 4.1 times; of three with torques of the wrong sign at 0.02 and 39.
ODD = (0.1, 5.0)
# Of the mass of all links: lighter ones hardly load a joint, whatever their description has; convention.
LIGHT = 0.02


def odd_masses(described: Robot, identified: Robot) -> list[str]:
    """Return in words which links of the identified arm have masses far from the described ones."""
    links = [
        (old.link_name, old.link.mass, new.link.mass)
        for old, new in zip(described.joints, identified.joints, strict=True)
    ]
    least = LIGHT * sum(old for _, old, _ in links)
    odd = [
        f"{name} has {new:.3g} kg ({old:.3g} kg described)"
        for name, old, new in links
        if old > 0.0 and max(old, new) > least and not ODD[0] < new / old < ODD[1]
    ]
    if not odd:
        return []
    wrong = "no such link has these masses: they make up for something that the model lacks"
    check = "check signs and units of the torques, how the arm is mounted (base) and what it carries"
    return [f"robot.yaml: {', '.join(odd)}: {wrong}; {check}"]


def identified_robot(
    robot: Robot, equations: BaseRegression, Psi: Array, effects: Sequence[EffectInstance] = ()
) -> Robot:
    """Return the arm with these parameters, laws beyond the model among its effects."""
    value = dict(zip(equations.names, Psi.tolist(), strict=True))
    for joint in robot.joints:
        changes: dict[str, object] = {"link": inertia_from(_link_alone(robot, equations, joint.name, value))}
        t = joint.transmission
        if joint.armature is not None:
            changes["armature"] = max(0.0, value[f"{joint.name}.{ARMATURE}"])  # of zero to the solver's tolerance
        if t is not None:
            solids = {
                what: replace(
                    component,
                    mass=value[f"{joint.name}.{what}.m"],
                    ixx=value[f"{joint.name}.{what}.Ixx"],
                    izz=value[f"{joint.name}.{what}.Izz"],
                )
                for what, (component, _) in t.components.items()
                if f"{joint.name}.{what}.m" in value
            }
            springs = {"stiffness": value[f"{joint.name}.K"], "damping": value[f"{joint.name}.D"]}
            changes["transmission"] = replace(t, **solids, **springs)  # type: ignore[arg-type]
        robot = robot.with_joint(joint.name, **changes)
    replaced = {(instance.effect.id, instance.joint) for instance in effects}
    kept = (entry for entry in robot.effects if (entry["effect"], entry.get("joint")) not in replaced)
    return robot.with_(effects=(*kept, *(_with_values(instance, robot, value) for instance in effects)))


def _with_values(instance: EffectInstance, robot: Robot, value: dict[str, float]) -> dict[str, object]:
    place = f"{instance.effect.id}:{instance.joint or robot.name}"
    found = {}
    for p in instance.effect.parameters:
        names = [f"{place}.{name}" for name in p.component_names]
        if names[0] in value:
            numbers = tuple(p.value_of(value[name]) for name in names)
            found[p.name] = numbers[0] if p.size == 1 else numbers
    return instance.with_parameters(**found).to_dict()


def _link_alone(robot: Robot, equations: BaseRegression, joint: str, value: dict[str, float]) -> Array:
    """Return the ten parameters of a joint's link, without the spline where the model folds that into it."""
    link_name = robot.joints[robot.joint_names.index(joint)].link_name
    body = next(b for b in equations.model.bodies.bodies if b.name == link_name)
    total = np.array([value[equations.names[k]] for k in body.parameters])
    return total - folded(robot, equations, body)
