"""What only code that knows the true arm may do: draw it, and score an identification."""

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.identification import Identification
from elastic_arm.robot import Robot
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


def true_values(identification: Identification, arm: Robot) -> Array:
    """Return the base parameters (B,) of the arm that was simulated, with the bodies of the
    identified one."""
    parameters = build_model(arm, identification.model).parameters
    value = {p.name: p.nominal for p in parameters}
    return identification.T @ np.array(
        [value.get(name, 0.0) for name in identification.parameter_names]
    )


def chi_square(identification: Identification, true: Array) -> float:
    """Return the chi-squared of all errors, with their correlations.

    It has B degrees of freedom.

    true: (B,) values of the base parameters.
    """
    std = identification.std
    error = (identification.Psi_base - true) / std
    return float(error @ np.linalg.solve(identification.covariance / np.outer(std, std), error))
