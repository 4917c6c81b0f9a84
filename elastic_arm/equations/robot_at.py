"""The arm with numbers that deviate from its description."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import TENSOR
from elastic_arm.equations.numbers import RATIO, SCALE, Number
from elastic_arm.errors import RobotError
from elastic_arm.robot import Component, Inertia, Joint, Robot

LEAST = 0.05  # of a described number that a deviation leaves; numerical
# of the links' deviations, tried until the bodies are physical
LINK_SHARES = 1.0, 0.75, 0.5, 0.25


def calibrated_robot(
    robot: Robot, parameters: Sequence[Number], values: Array, *, nearest: bool = False
) -> Robot:
    """Return the arm with its numbers at these values.

    values: (k,) deviations from the description, in units of the priors' standard deviations;
    nearest: whether links get the nearest moments of inertia that a body can have.

    Raises a RobotError if no physical body has such inertia.
    """
    deviations: dict[str, dict[str, float]] = {}
    for parameter, value in zip(parameters, values, strict=True):
        if parameter.feature is None:
            deviations.setdefault(parameter.joint, {})[parameter.what] = (
                parameter.value(value) - parameter.neutral
            )
    return robot.with_(
        joints=tuple(_changed(joint, deviations[joint.name], nearest) for joint in robot.joints)
    )


def nearest_robot(robot: Robot, parameters: Sequence[Number], values: Array) -> Robot:
    """Return the arm with its numbers at these values, its links only as far as they are physical
    bodies.

    Masses and centres count first, as they determine the weight: moments of inertia that no body
    has are replaced by the nearest ones.

    values: (k,) deviations from the description, in units of the priors' standard deviations.
    """
    of_links = np.array([parameter.what.startswith("link_") for parameter in parameters])
    for share in LINK_SHARES:
        shared = np.where(of_links, share * values, values)
        for nearest in (False, True):
            try:
                return calibrated_robot(robot, parameters, shared, nearest=nearest)
            except RobotError:
                continue
    return calibrated_robot(robot, parameters, np.where(of_links, 0.0, values))


def _changed(joint: Joint, deviation: dict[str, float], nearest: bool) -> Joint:
    gear = joint.transmission
    if gear is not None:
        rotor = max(LEAST, 1.0 + deviation["rotor_inertia"])
        spline = max(LEAST, 1.0 + deviation["spline_inertia_ratio"])
        gear = replace(
            gear,
            rotor=_scaled(gear.rotor, rotor),
            wave_generator=_scaled(gear.wave_generator, rotor),
            spline=_scaled(gear.spline, spline),
            stiffness=gear.stiffness * max(LEAST, 1.0 + deviation["stiffness"]),
            damping=gear.damping * max(0.01, 1.0 + deviation["damping"]),
        )
    controller = joint.controller
    armature = joint.armature
    if controller is not None:
        scale = 1.0 + deviation.get(SCALE, 0.0)
        ratio = 1.0 + deviation.get(RATIO, 0.0)
        controller = controller.scaled(scale, scale * ratio)
    if armature:
        armature *= max(LEAST, 1.0 + deviation["rotor_inertia"])
    elif armature is not None:
        armature = max(0.0, deviation.get("rotor_inertia", 0.0))
    link = changed_link(joint.link, deviation, nearest=nearest)
    return replace(joint, link=link, transmission=gear, armature=armature, controller=controller)


def changed_link(
    link: Inertia, deviation: Mapping[str, float], *, nearest: bool = False
) -> Inertia:
    """Return a link whose numbers differ by deviations, by the names of the numbers.

    The inertial parameters about the frame's origin are linear in the deviations, as the columns of
    the numbers are. With the mass m, the centre c, the inertia I about it, their deviations r, s
    and E, and S(c) = |c|² 1 - c c',

        m' = (1 + r) m,   m' c' = m ((1 + r) c + s)
        I' + m' S(c') = (1 + r) (I + m S(c)) + trace(I) / 3 E + m (2 c's 1 - c s' - s c')

    nearest: whether the moments of inertia are the nearest ones that a body can have.

    Raises a RobotError if no body of positive density has these numbers.
    """
    ratio = 1.0 + deviation["link_mass"]
    inertia = np.array(link.inertia, dtype=float) * ratio
    size = np.trace(np.asarray(link.inertia)) / 3.0
    for a, b in TENSOR:
        change = size * deviation[f"link_inertia_{'xyz'[a]}{'xyz'[b]}"]
        inertia[a, b] += change
        if a != b:
            inertia[b, a] += change
    shift = np.array([deviation[f"link_com_{axis}"] for axis in "xyz"])
    if shift.any() and ratio > 0.0:
        # What is left of the terms of second order, once both centres are subtracted.
        inertia -= link.mass / ratio * (shift @ shift * np.eye(3) - np.outer(shift, shift))
        shift /= ratio
    if nearest:
        inertia = _nearest_moments(inertia)
    com = np.asarray(link.com, dtype=float) + shift
    return replace(link, mass=link.mass * ratio, com=com, inertia=inertia)


def _nearest_moments(inertia: Array) -> Array:
    """Return the nearest inertia (3, 3) about its centre of mass that a body can have: that of the
    second moments of its mass without their negative part."""
    axes = np.eye(3)
    sizes, turn = np.linalg.eigh(0.5 * np.trace(inertia) * axes - inertia)
    second = turn @ np.diag(np.maximum(sizes, 0.0)) @ turn.T
    found = np.trace(second) * axes - second
    return 0.5 * (found + found.T)


def _scaled(part: Component, ratio: float) -> Component:
    return replace(part, ixx=part.ixx * ratio, izz=part.izz * ratio)
