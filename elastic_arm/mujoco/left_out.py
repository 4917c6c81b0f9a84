"""The parts of an arm that a written file lacks: size, reason, and the missing torque.

The torque is a root mean square while every joint oscillates by half a radian, or within its range,
at 2 rad/s.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, rms
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, EffectInstance, SensorEffect, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.errors import EffectError
from elastic_arm.robot import JointController, Robot
from elastic_arm.simulation.assembly import law_rows
from elastic_arm.simulation.simulator import SIGN_SPEED

# Rates and accelerations as those of an excitation.
SWING = 0.5  # rad or m
SPEED = 2.0  # rad/s
SAMPLES = 200
Motion = tuple[Array, Array, Array]  # angles, rates and accelerations (N, n), rad and s


@dataclass(frozen=True)
class Left:
    """A number or an effect of an arm that a file does not hold."""

    # what, joint: its name, and the joint that it sits on; None for the whole arm
    what: str
    joint: str | None
    numbers: Mapping[str, Any]  # name of each of its numbers -> value, with unit in `units`
    reason: str  # why it is not there
    units: Mapping[str, str] = field(default_factory=dict)
    # by joint, root mean square of the torque that is missing, Nm; empty where it is none or not
    # known
    cost: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        plain = {k: list(v) if isinstance(v, tuple) else v for k, v in self.numbers.items()}
        named = {
            "effect": self.what,
            "joint": self.joint,
            "parameters": plain,
            "units": dict(self.units),
        }
        return named | {"reason": self.reason, "cost_nm": dict(self.cost)}


def left_effects(
    robot: Robot, left: Iterable[tuple[EffectInstance, str]], catalogue: Catalogue | None = None
) -> Iterator[Left]:
    """Yield effects that a file of an arm does not hold, each with its reason."""
    state = Swing(robot)
    for instance, reason in left:
        units = {p.name: p.unit_at(instance.joint, robot.units) for p in instance.effect.parameters}
        stated = robot_effects(robot, catalogue) if instance.effect.scales_friction else ()
        scaled = [one for one in stated if one.effect.friction]
        missing = state.of_effects([*scaled, instance]) - state.of_effects(scaled)
        # What sensors make of the truth is no torque that the arm lacks.
        costs = {} if isinstance(instance.effect, SensorEffect) else state.cost(missing)
        yield Left(
            instance.effect.id, instance.joint, dict(instance.parameters), reason, units, costs
        )


def left_numbers(
    robot: Robot, reason: str, *, armatures: Sequence[float] = (), elasticity: bool = False
) -> Iterator[Left]:
    """Yield numbers that a file does not hold."""
    state = Swing(robot)
    for i, joint in enumerate(robot.joints):
        gear = joint.transmission
        unit = joint.unit
        if len(armatures) and armatures[i]:
            missing = state.only(i, float(armatures[i]) * state.ddq[:, i])
            inertia = {"armature": "kg" if joint.prismatic else "kg m²"}
            yield Left(
                "armature",
                joint.name,
                {"armature": float(armatures[i])},
                reason,
                inertia,
                state.cost(missing),
            )
        if gear is not None and elasticity:
            numbers = {"stiffness": gear.stiffness, "damping": gear.damping}
            units = {"stiffness": unit("Nm/rad"), "damping": unit("Nm s/rad")}
            yield Left("drive", joint.name, numbers, reason, units)
        if gear is not None and gear.bearing is not None:
            numbers = {"stiffness": gear.bearing.stiffness, "damping": gear.bearing.damping}
            yield Left(
                "bearing",
                joint.name,
                numbers,
                reason,
                {"stiffness": "Nm/rad", "damping": "Nm s/rad"},
            )
        if joint.controller is not None:
            names = ("mode", "kp", "kd", "ki", "delay", "torque", "dead_band", "stall", "sag")
            gains = {name: getattr(joint.controller, name) for name in names}
            ordinary = JointController()
            told = {
                k: v
                for k, v in gains.items()
                if k in ("mode", "kp", "kd") or v != getattr(ordinary, k)
            }
            yield Left("controller", joint.name, told, reason)


def left_coupling(robot: Robot, reason: str) -> Iterator[Left]:
    """Yield the coupling of links and spinning rotors, which mod3 has of an elastic arm and mod2
    has not."""
    state = Swing(robot)
    three = build_model(robot, "mod3", engine="numpy").inverse_dynamics(*state.motion)
    two = build_model(robot, "mod2", engine="numpy").inverse_dynamics(*state.motion)
    yield Left("inertia_coupling", None, {}, reason, {}, state.cost(three - two))


class Swing:
    """An arm that moves, and the torques that it takes: by a motion that is given, else each joint
    swings."""

    def __init__(self, robot: Robot, motion: Motion | None = None) -> None:
        self.robot = robot
        q, dq, self.ddq = _swinging(robot) if motion is None else motion
        self.samples = len(q)
        sides = 2 if robot.elastic else 1
        self.motion = tuple(np.tile(values, sides) for values in (q, dq, self.ddq))
        rows = build_model(robot, engine="numpy").inverse_dynamics(*self.motion)
        self.tau_m = rows.reshape(self.samples, sides, robot.n).sum(axis=1)
        if robot.elastic:
            # The drives are wound by what the links need.
            K = np.array(
                [joint.transmission.stiffness for joint in robot.joints if joint.transmission]
            )
            self.motion[0][:, robot.n :] += rows[:, : robot.n] / K

    def only(self, i: int, torque: Array) -> Array:
        """Return torques (N, n) that are zero but for one joint's (N,)."""
        found = np.zeros((self.samples, self.robot.n))
        found[:, i] = torque
        return found

    def of_effects(self, instances: Sequence[EffectInstance]) -> Array:
        """Return what effects add to the left side of (1), (N, dof); nothing where they do not act
        by laws."""
        none = np.zeros_like(self.motion[0])
        if not instances:
            return none
        try:
            equations = ArmEquations(self.robot)
            effects = EffectSet(instances, self.robot, duration=1.0)
            law = law_rows(equations, effects)
        except EffectError:
            return none
        z = np.zeros(int(effects.z.numel()))
        speed = np.full(2 * self.robot.n, SIGN_SPEED)
        given = (equations.nominal, effects.numbers(), speed)
        samples = zip(*self.motion, self.tau_m, strict=True)
        return np.array(
            [np.array(law(x, dx, ddx, z, tau, *given)[0]).ravel() for x, dx, ddx, tau in samples]
        )

    def cost(self, rows: Array) -> dict[str, float]:
        """Return root mean squares by joint, both sides of a joint together, of those that feel
        any."""
        torque = rows.reshape(self.samples, -1, self.robot.n).sum(axis=1)
        sizes = rms(torque)
        named = zip(self.robot.joint_names, sizes.tolist(), strict=True)
        return {
            name: float(f"{size:.4g}")
            for name, size in named
            if size > 1e-9 * max(1.0, sizes.max())
        }


def _swinging(robot: Robot) -> Motion:
    """Return a swing of every joint by half a radian, or what its range allows."""
    phases = SPEED * np.linspace(0.0, 2 * np.pi / SPEED, SAMPLES)[:, None] + np.arange(robot.n)
    limits = [joint.limits for joint in robot.joints]
    low = [one.position_min for one in limits]
    high = [one.position_max for one in limits]
    spans = [None if a is None or b is None else (a, b) for a, b in zip(low, high, strict=True)]
    size = np.array(
        [SWING if span is None else min(SWING, 0.5 * (span[1] - span[0])) for span in spans]
    )
    middle = np.array([0.0 if span is None else 0.5 * (span[0] + span[1]) for span in spans])
    q = middle + size * np.sin(phases)
    dq = size * SPEED * np.cos(phases)
    return q, dq, -size * SPEED**2 * np.sin(phases)
