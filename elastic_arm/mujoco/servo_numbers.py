"""The numbers of every servo arm, fitted in closed loop if no cause improves its motion.

    kp and kd, kd, armature, dry friction, friction that grows with the load, sag of the supply,
    zero of the angle

The priors are those of the evidence: ordinary deviations of a description, and ordinary sizes of
friction and sag. Masses stay as described, because the torque of the servo is far less certain.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from elastic_arm.effects import EFFECTS
from elastic_arm.evidence.priors import STATED, Priors
from elastic_arm.mujoco.refinable import FRICTION, ZERO, Refinable
from elastic_arm.robot import Joint, Robot

DRY = "coulomb_friction"
LOADED = "load_dependent_friction"
SAG = "supply_sag"
START = 0.05  # share of an effect's largest size at which it begins where none is stated
MOUNTED = 0.02  # rad, to which a horn is put on its splines, and a zero is set by eye
SCALED = 0.3  # of its prior, in which a number's steps are measured


def servo_numbers(robot: Robot, priors: Priors) -> tuple[Robot, tuple[Refinable, ...]]:
    """Return an arm with the friction that every geared servo has, and its numbers to be fitted."""
    stated = {(one["effect"], one["joint"]) for one in robot.effects}
    driven = [joint for joint in robot.joints if joint.controller is not None]
    begun = [one for joint in driven for one in _beginning(joint)]
    added = [one for one in begun if (one["effect"], one["joint"]) not in stated]
    arm = robot.with_(effects=(*robot.effects, *added))
    for joint in driven:
        controller = joint.controller
        if controller is not None and controller.stall is not None and not controller.sag:
            sagging = replace(controller, sag=START * _largest(SAG))
            arm = arm.with_joint(joint.name, controller=sagging)
    return arm, tuple(_numbers(robot, arm, priors))


def _numbers(robot: Robot, arm: Robot, priors: Priors) -> Iterator[Refinable]:
    of_friction = {(one["effect"], one["joint"]): one["parameters"] for one in robot.effects}
    for joint, begun in zip(robot.joints, arm.joints, strict=True):
        if joint.controller is None or begun.controller is None:
            continue
        yield within_prior("scale", joint.name, priors.controller)
        if joint.controller.kd:
            yield within_prior("kd", joint.name, priors.gain_ratio)
        if joint.armature:
            yield within_prior("armature", joint.name, priors.rotor)
        for law in (DRY, LOADED):
            own = of_friction.get((law, joint.name))
            at = START * _largest(law) if own is None else float(own[FRICTION[law]])
            prior = _largest(law) if own is None else STATED * at
            stated = -at if own is None else 0.0
            yield within_prior(law, joint.name, prior, least=-at, stated=stated)
        if not joint.prismatic:
            yield within_prior(ZERO, joint.name, MOUNTED)
        if begun.controller.stall is not None:
            own_sag = joint.controller.sag
            at = begun.controller.sag
            yield within_prior("sag", joint.name, _largest(SAG), least=-at, stated=own_sag - at)


def within_prior(what: str, joint: str, prior: float, **more: Any) -> Refinable:
    """Return a number of a joint that is ordinarily as far off as its prior."""
    return Refinable(what, joint, SCALED * prior, prior=prior, **more)


def _largest(effect: str) -> float:
    """Return the largest size that an effect plausibly has."""
    return EFFECTS[effect].parameters[0].high


def _beginning(joint: Joint) -> Iterator[dict[str, Any]]:
    """Yield the effects with which a joint begins where none are stated."""
    sizes = {law: (FRICTION[law], START * _largest(law)) for law in (DRY, LOADED)}
    if not joint.prismatic:
        sizes[ZERO] = "offset", 0.0
    for effect, (parameter, size) in sizes.items():
        yield {"effect": effect, "joint": joint.name, "parameters": {parameter: size}}
