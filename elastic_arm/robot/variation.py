"""Arms that differ from their description, as all real ones do."""

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.robot.description import Robot
from elastic_arm.robot.parts import Component, Inertia


def varied(robot: Robot, rng: np.random.Generator, spread: float = 0.15) -> Robot:
    """Return an arm that differs from `robot` as descriptions do.

    In masses, centres of mass, inertias, stiffnesses and dampings.

    Each number is scaled by a factor drawn uniformly from 1 - spread to 1 + spread. Mass and
    inertia of a body share theirs, so the body stays physical; geometry and ratios, which are known
    of every arm, stay as they are.
    """

    def factor() -> float:
        return float(rng.uniform(1.0 - spread, 1.0 + spread))

    def body(part: Component) -> Component:
        scale = factor()
        return replace(part, mass=part.mass * scale, ixx=part.ixx * scale, izz=part.izz * scale)

    joints = []
    for joint in robot.joints:
        link = joint.link
        drive = joint.transmission
        scale = factor()
        com = link.com * rng.uniform(1.0 - spread, 1.0 + spread, size=3)
        if drive is not None:
            bodies: dict[str, Any] = {
                name: body(part) for name, (part, _) in drive.components.items()
            }
            K = drive.stiffness * factor()
            D = drive.damping * factor()
            drive = replace(drive, stiffness=K, damping=D, **bodies)
        joints.append(
            replace(
                joint,
                link=Inertia(link.mass * scale, com, link.inertia * scale),
                transmission=drive,
            )
        )
    return robot.with_(name=f"{robot.name}_varied", joints=tuple(joints))
