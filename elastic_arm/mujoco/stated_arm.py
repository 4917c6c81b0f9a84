"""The division of an arm with effects into numbers of an MJCF or a URDF, and laws.

Each effect is divided by the meanings of its parameters in its file. Effects without a rule here
remain for :func:`elastic_arm.mujoco.attach`, or, if they are effects of sensors, belong to a
recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics.composition import exchanged
from elastic_arm.effects import (
    Catalogue,
    EffectInstance,
    SensorEffect,
    StructuralEffect,
    robot_effects,
)
from elastic_arm.effects.effect import ControllerEffect, Effect
from elastic_arm.identification.batch.mounting import turned
from elastic_arm.robot import Inertia, Joint, Robot
from elastic_arm.robot.kinematics import lumped

MOTOR_TORQUE = "motor_torque"
Lacking = tuple[EffectInstance, str]  # what a file does not state, and why


@dataclass(frozen=True)
class StatedJoint:
    """Numbers of a joint: kg m², Nm s/rad, Nm, its spring's Nm/rad and rad, its zero, rad, its
    torque's delay, s."""

    armature: float = 0.0
    damping: float = 0.0
    friction_loss: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    zero: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True)
class StatedArm:
    """A rigid arm in the numbers that simulators' files hold."""

    links: tuple[Inertia, ...]  # inertia of each link, in its frame
    joints: tuple[StatedJoint, ...]  # numbers of each joint
    gravity: Array  # (3,) m/s^2
    left: tuple[Lacking, ...] = ()  # effects that no number states, each with the reason
    delays: tuple[EffectInstance, ...] = ()  # the effects that the joints' delays come from

    def with_joint(self, i: int, **numbers: float) -> StatedArm:
        """Return it with these numbers added to those of a joint."""
        changed = {name: getattr(self.joints[i], name) + value for name, value in numbers.items()}
        return replace(self, joints=_put(self.joints, i, replace(self.joints[i], **changed)))

    def with_link(self, i: int, link: Inertia) -> StatedArm:
        """Return it with another link."""
        return replace(self, links=_put(self.links, i, link))

    def without(self, instance: EffectInstance, reason: str | None = None) -> StatedArm:
        """Return it with an effect that it cannot state."""
        if any(instance is one for one, _ in self.left):
            return self  # of another joint that it acts on
        return replace(self, left=(*self.left, (instance, reason or reason_left(instance))))


def stated_arm(
    robot: Robot, catalogue: Catalogue | None = None, *, base: Array | None = None
) -> StatedArm:
    """Return the numbers of a robot with those of its effects in them."""
    arm = StatedArm(
        tuple(joint.link for joint in robot.joints),
        tuple(StatedJoint(armature=motor_inertia(joint)) for joint in robot.joints),
        np.array(robot.gravity),
    )
    for instance in robot_effects(robot, catalogue):
        rule = RULES.get(instance.effect.id)
        if rule is not None:
            for i in instance.joint_indices(robot):
                arm = rule(arm, robot, i, instance)
        else:
            arm = arm.without(instance)
    if base is None or np.array_equal(base, robot.base_placement):
        return arm
    return replace(arm, gravity=base[:3, :3] @ robot.base_placement[:3, :3].T @ arm.gravity)


def motor_inertia(joint: Joint) -> float:
    """Return the nominal inertia on the motor side of a joint, kg m²: B of mod2, or its
    armature."""
    if joint.transmission is None:
        return joint.armature or 0.0
    return sum(
        ratio**2 * component.izz for component, ratio in joint.transmission.components.values()
    )


def acts_by_law(effect: Effect) -> bool:
    """Return whether a callback can add an effect to a model: a whole arm's, not one of its sensors
    or controllers."""
    return (
        not isinstance(effect, SensorEffect | StructuralEffect | ControllerEffect)
        and "mod3" in effect.lacked_by
    )


def reason_left(instance: EffectInstance) -> str:
    """Return why no number of a file states an effect."""
    if isinstance(instance.effect, ControllerEffect):
        return "it belongs to the controller: state its numbers in the arm file"
    if isinstance(instance.effect, SensorEffect):
        return "it belongs to the sensors of the recording, not to the arm"
    if not acts_by_law(instance.effect):
        return "it changes the structure of the arm and is neither a number nor a law in MuJoCo"
    return "it has no number: elastic_arm.mujoco.attach adds its law"


def _put(values: Sequence[Any], i: int, value: Any) -> tuple[Any, ...]:
    return (*values[:i], value, *values[i + 1 :])


def _on_elastic_link(robot: Robot, instance: EffectInstance) -> bool:
    """Return whether an effect acts on the link of an elastic joint, which is no joint of a
    file."""
    return robot.elastic and instance.parameters.get("side", "link") == "link"


def _friction(field: str, parameter: str) -> Rule:
    def rule(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
        if _on_elastic_link(robot, instance):
            return arm.without(instance)
        return arm.with_joint(i, **{field: number(instance, parameter)})

    return rule


def _spring(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    if _on_elastic_link(robot, instance):
        return arm.without(instance)
    added = number(instance, "stiffness")
    own = arm.joints[i]
    whole = own.stiffness + added
    rest = (own.stiffness * own.rest + added * number(instance, "rest")) / whole if whole else 0.0
    return arm.with_joint(i, stiffness=added, rest=rest - own.rest)


def _zero(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    return arm.with_joint(i, zero=number(instance, "offset"))


def _rotor(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    return arm.with_joint(
        i, armature=(number(instance, "inertia") - 1.0) * motor_inertia(robot.joints[i])
    )


def _payload(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    mass = number(instance, "mass")
    if mass < 0.0:
        return arm.without(instance, f"its mass is {mass:g} kg, which is physically impossible")
    point = Inertia(mass, np.array(instance.parameters["position"]))
    return arm.with_link(i, lumped([arm.links[i], point]))


def _link(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    """The effect's law refers to the nominal link; what else was joined to it stays."""
    nominal = robot.joints[i].link
    whole = arm.links[i]
    mass = number(instance, "mass")
    com = nominal.com + np.array(instance.parameters["com"])
    shape = number(instance, "inertia")
    link = Inertia(mass * nominal.mass, com, mass * shape * nominal.inertia)
    return arm.with_link(i, link if whole is nominal else exchanged(whole, nominal, link))


def _tilt(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    if i != instance.joint_indices(robot)[0]:
        return arm
    x, y = (number(instance, axis) for axis in "xy")
    return replace(arm, gravity=turned(x, y).T @ arm.gravity)


def _delay(arm: StatedArm, robot: Robot, i: int, instance: EffectInstance) -> StatedArm:
    if instance.parameters["channels"] == (MOTOR_TORQUE,):
        delays = arm.delays if instance in arm.delays else (*arm.delays, instance)
        return replace(arm.with_joint(i, delay=number(instance, "delay")), delays=delays)
    return arm.without(instance)


def number(instance: EffectInstance, name: str) -> float:
    """Return a parameter of an effect."""
    return float(instance.parameters[name])  # type: ignore[arg-type]


Rule = Callable[[StatedArm, Robot, int, EffectInstance], StatedArm]
RULES: Mapping[str, Rule] = {
    "viscous_friction": _friction("damping", "coefficient"),
    "coulomb_friction": _friction("friction_loss", "torque"),
    "joint_spring": _spring,
    "joint_zero": _zero,
    "rotor_inertia_mismatch": _rotor,
    "payload": _payload,
    "load": _payload,
    "link_inertia_mismatch": _link,
    "base_tilt": _tilt,
    "time_delay": _delay,
}
