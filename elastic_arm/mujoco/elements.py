"""Laws that elements of an MJCF state in addition to the numbers of its joints.

Drives: the spring of the joint by which a drive winds has a polynomial. Sums of joints, such as the
link angle q = theta + (q - theta), are lengths of fixed tendons with their own spring, damping,
friction and inertia; a dead band of the spring is play. Motors: a `dcmotor` without winding and
command has LuGre friction and cogging.

Hysteresis cannot be stated: springs that yield (`springyield`) follow Masing's rule, but Bouc-Wen's
law does not. With six of them instead, the error of the motion is a third of the influence of the
hysteresis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.library.wrist_coupling import TURNS
from elastic_arm.mujoco.changed_numbers import text_of
from elastic_arm.mujoco.stated_arm import StatedArm, number
from elastic_arm.robot import JointController, Robot
from elastic_arm.robot.mjcf import engine
from elastic_arm.robot.mjcf.drives import MotorConstants

DEFLECTION = "_deflection"  # joint that a drive winds by, after the name of its motor joint
_PASSIVE = {"input": "none", "motorconst": 0.0, "resistance": 1.0}


@dataclass(frozen=True)
class Element:
    """A tendon or an actuator of an MJCF."""

    tag: str  # fixed or dcmotor
    attributes: Mapping[str, str | float]
    joints: Mapping[str, float]  # of a tendon, joint -> coefficient
    of: EffectInstance  # what it states


def sharp(timestep: float) -> str:
    """Return the `solreffriction` with which friction loss turns over with the velocity; by default
    it does earlier.

    Its force follows a + b v with b = 2 / time constant, which changes sign before v does.
    """
    return f"{text_of(2.0 * timestep)} 1"


def delayed(delay: float, timestep: float) -> dict[str, str]:
    """Return the attributes of a sensor that is late, with room for its samples."""
    return {"delay": text_of(delay), "nsample": str(int(np.ceil(delay / timestep)) + 2)}


def servo(controller: JointController | None) -> JointController | None:
    """Return what an actuator is of a controller, kp (r - theta) - kd dtheta, late and limited.

    It is a <position>, or a <dcmotor> where the duty has a limit. None where it does not follow
    angles. A dead band, an integral, a sag of the supply and feed-forward are left out.
    """
    if controller is None or controller.mode != "position" or not controller.kp:
        return None
    names = ("kp", "kd", "delay", "torque", "stall", "supply", "firmware_gain")
    numbers = {name: getattr(controller, name) for name in names}
    if not controller.kd:  # a motor without back-EMF is no <dcmotor>
        numbers |= {"stall": None, "supply": None}
    return JointController(between=controller.between, **numbers)


def motor_attributes(drive: JointController, gear: float) -> dict[str, str]:
    """Return the attributes of the <dcmotor> that a servo with a limit of its duty is."""
    motor = MotorConstants.of(drive, gear)
    kp = drive.kp / gear**2
    kd = drive.kd / gear**2
    return {
        "motorconst": text_of(motor.constant, motor.constant),
        "resistance": text_of(motor.resistance),
        "controller": text_of(kp, 0.0, kd, 0.0, 0.0, motor.supply),
    }


class Elements:
    """Drives and elements that state the laws of an arm's effects; `left` are those that they do
    not."""

    def __init__(self, robot: Robot, arm: StatedArm, timestep: float) -> None:
        self.robot = robot
        self.timestep = timestep
        gears = [joint.transmission for joint in robot.joints]
        # (n, 3) a, b, c
        self.springs = np.array([(gear.stiffness if gear else 0.0, 0.0, 0.0) for gear in gears])
        self.dampings = np.array([gear.damping if gear else 0.0 for gear in gears])  # (n,)
        self.found: list[Element] = []
        self.left: list[tuple[EffectInstance, str]] = []
        for instance, reason in arm.left:
            rule = (RULES if robot.elastic else RIGID).get(instance.effect.id)
            if rule is None:
                self.left.append((instance, reason))
                continue
            self._now = instance
            for i in instance.joint_indices(robot):
                rule(self, i, instance)

    def left_by(self, model: Any) -> list[EffectInstance]:
        """Return the effects that a compiled model does not state: a user's own file has none of
        the elements."""
        mj = engine()
        kinds = {"fixed": mj.mjtObj.mjOBJ_TENDON, "dcmotor": mj.mjtObj.mjOBJ_ACTUATOR}
        absent = [
            e.of
            for e in self.found
            if mj.mj_name2id(model, kinds[e.tag], str(e.attributes["name"])) < 0
        ]
        # One effect may have an element at each of several joints.
        return [
            *(instance for instance, _ in self.left),
            *(e for k, e in enumerate(absent) if e not in absent[:k]),
        ]

    def link(self, i: int) -> dict[str, float]:
        """Return the joints whose sum is the link's angle."""
        name = self.robot.joint_names[i]
        return {name: 1.0, f"{name}{DEFLECTION}": 1.0}

    def twist(self, i: int) -> dict[str, float]:
        """Return the joint that drive i winds by."""
        return {f"{self.robot.joint_names[i]}{DEFLECTION}": 1.0}

    def add(
        self, i: int, what: str, attributes: dict[str, Any], joints: Mapping[str, float] = {}
    ) -> str:
        """Add a tendon over joints, or a motor where there are none, and return its name."""
        name = f"{self.robot.joint_names[i]}_{what}_{len(self.found)}"
        if attributes.get("frictionloss"):
            attributes["solreffriction"] = sharp(self.timestep)
        self.found.append(
            Element(
                "fixed" if joints else "dcmotor", {"name": name, **attributes}, joints, self._now
            )
        )
        return name

    def free_inertia(self, i: int, side: str) -> float:
        """Return the inertia that a torque at a joint moves while all other joints are free, kg
        m²."""
        rest = np.zeros((1, self.robot.n * (2 if self.robot.elastic else 1)))
        terms = build_model(self.robot, engine="numpy").terms(rest, rest)
        matrix: Array = terms["B" if self.robot.elastic and side == "motor" else "M"][0]
        return float(1.0 / np.linalg.inv(matrix)[i, i])


def _friction(law: str, parameter: str) -> Rule:
    """Return the rule of friction of the link of an elastic joint; that of a motor is a number of
    its joint."""

    def rule(elements: Elements, i: int, instance: EffectInstance) -> None:
        elements.add(i, law, {law: number(instance, parameter)}, elements.link(i))

    return rule


def _stribeck(elements: Elements, i: int, instance: EffectInstance) -> None:
    """Bristles as stiff as the time step can follow: LuGre's friction is then that of its speed."""
    side = str(instance.parameters["side"])
    stiffness = elements.free_inertia(i, side) / elements.timestep**2
    lugre = (
        f"{stiffness:.10g} 0 0 {number(instance, 'torque'):.10g} {number(instance, 'speed'):.10g}"
    )
    at = {"joint": elements.robot.joint_names[i]}
    if elements.robot.elastic and side == "link":
        at = {"tendon": elements.add(i, "link", {}, elements.link(i))}
    elements.add(i, "stribeck", {**at, **_PASSIVE, "lugre": lugre})


def _ripple(elements: Elements, i: int, instance: EffectInstance) -> None:
    gear = elements.robot.joints[i].transmission
    assert gear is not None
    amplitude = number(instance, "amplitude")
    order = number(instance, "order")
    phase = number(instance, "phase")
    cogging = f"{amplitude / gear.r_tot:.10g} {order:.10g} {phase:.10g}"
    at = {"joint": elements.robot.joint_names[i], "gear": gear.r_tot}
    elements.add(i, "ripple", {**at, **_PASSIVE, "cogging": cogging})


def _wrist(elements: Elements, i: int, instance: EffectInstance) -> None:
    names = elements.robot.joint_names
    turns = TURNS[str(instance.parameters["turns"])]
    own = {"armature": "inertia", "damping": "viscous", "frictionloss": "dry"}
    numbers = {attribute: number(instance, name) for attribute, name in own.items()}
    elements.add(i, "wrist", numbers, {names[i - 1]: turns, names[i]: 1.0})


def _spring(elements: Elements, i: int, instance: EffectInstance) -> None:
    stiffness = number(instance, "stiffness")
    rest = number(instance, "rest")
    elements.add(i, "spring", {"stiffness": stiffness, "springlength": rest}, elements.link(i))


def _stiffness(elements: Elements, i: int, instance: EffectInstance) -> None:
    gear = elements.robot.joints[i].transmission
    assert gear is not None
    elements.springs[i, 0] += (number(instance, "stiffness") - 1.0) * gear.stiffness


def _damping(elements: Elements, i: int, instance: EffectInstance) -> None:
    gear = elements.robot.joints[i].transmission
    assert gear is not None
    elements.dampings[i] += (number(instance, "damping") - 1.0) * gear.damping


def _cubic(elements: Elements, i: int, instance: EffectInstance) -> None:
    elements.springs[i, 2] += number(instance, "cubic")


def _play(elements: Elements, i: int, instance: EffectInstance) -> None:
    """The spring moves to a tendon, whose dead band is the play; damping acts throughout."""
    gear = elements.robot.joints[i].transmission
    half = number(instance, "half_gap")
    assert gear is not None
    elements.springs[i, 0] -= gear.stiffness
    band = f"{-half:.10g} {half:.10g}"
    elements.add(i, "play", {"stiffness": gear.stiffness, "springlength": band}, elements.twist(i))


Rule = Callable[[Elements, int, EffectInstance], None]
# of arms without drives, too
RIGID: Mapping[str, Rule] = {"stribeck_friction": _stribeck, "wrist_coupling": _wrist}
RULES: Mapping[str, Rule] = {
    **RIGID,
    "viscous_friction": _friction("damping", "coefficient"),
    "coulomb_friction": _friction("frictionloss", "torque"),
    "torque_ripple": _ripple,
    "joint_spring": _spring,
    "stiffness_mismatch": _stiffness,
    "damping_mismatch": _damping,
    "nonlinear_stiffness": _cubic,
    "backlash": _play,
}
