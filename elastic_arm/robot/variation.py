"""Arms that differ from their description, as every real one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.robot.description import Joint, Robot
from elastic_arm.robot.parts import Component, Inertia, Transmission


def varied(robot: Robot, rng: np.random.Generator, spread: float = 0.15) -> Robot:
    """Return an arm whose masses, centres of mass, inertias, stiffnesses and dampings differ from `robot`'s.

    Each number is scaled by a factor drawn uniformly from 1 - spread to 1 + spread. Mass and inertia of a body share
    theirs, so the body stays physical; geometry and ratios, which are known of every arm, stay as they are.

    Parameters
    ----------
    robot
        The description to depart from.
    rng
        Source of the factors.
    spread
        Below 1.
    """
    return replace(
        robot, name=f"{robot.name}_varied", joints=tuple(_joint(joint, rng, spread) for joint in robot.joints)
    )


def _joint(joint: Joint, rng: np.random.Generator, spread: float) -> Joint:
    link = joint.link
    factor = _factor(rng, spread)
    com = link.com * rng.uniform(1.0 - spread, 1.0 + spread, size=3)
    drive = joint.transmission
    return replace(
        joint,
        link=Inertia(link.mass * factor, com, link.inertia * factor),
        transmission=None if drive is None else _transmission(drive, rng, spread),
    )


def _transmission(drive: Transmission, rng: np.random.Generator, spread: float) -> Transmission:
    return replace(
        drive,
        rotor=_component(drive.rotor, rng, spread),
        wave_generator=_component(drive.wave_generator, rng, spread),
        spline=_component(drive.spline, rng, spread),
        stiffness=drive.stiffness * _factor(rng, spread),
        damping=drive.damping * _factor(rng, spread),
    )


def _component(part: Component, rng: np.random.Generator, spread: float) -> Component:
    factor = _factor(rng, spread)
    return replace(part, mass=part.mass * factor, ixx=part.ixx * factor, izz=part.izz * factor)


def _factor(rng: np.random.Generator, spread: float) -> float:
    return float(rng.uniform(1.0 - spread, 1.0 + spread))
