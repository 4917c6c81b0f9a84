"""Several effects together: parameters and states as vectors, and the sum of contributions."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.effects.effect import Effect, EffectInstance, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.errors import EffectError
from elastic_arm.robot import Robot


class EffectSet:
    """Laws of several effects on one arm, over symbols."""

    def __init__(
        self, instances: Sequence[EffectInstance], robot: Robot, duration: float | None = None
    ) -> None:
        self.instances = tuple(instances)
        self._placed: list[tuple[EffectInstance, int, dict[str, Any]]] = []
        self.state_names: list[str] = []
        parameters: list[ca.SX] = []
        states: list[ca.SX] = []
        for instance in self.instances:
            if not robot.elastic and "drive" in instance.sides:
                raise EffectError(
                    f"{instance.effect.id} acts in a transmission, but robot {robot.name} has none",
                    "Use an effect of the motor or link side, or an arm file with transmissions.",
                )
            values: dict[str, Any] = dict(instance.parameters)
            for entry in instance.effect.parameters:
                values[entry.name] = ca.SX.sym(f"{instance.effect.id}.{entry.name}", entry.size)
                parameters.append(values[entry.name])
            for i in law_joints(instance, robot):
                own = {name: ca.SX.sym(name) for name in instance.effect.states}
                states += own.values()
                self.state_names += [
                    f"{instance.effect.id}:{robot.joint_names[i]}:{name}" for name in own
                ]
                self._placed.append((instance, i, {**values, **own}))
        self._duration = self._required(duration)
        self._clock = (ca.SX.sym("time"), ca.SX.sym("duration"))
        if self.in_time:
            states.append(self._clock[0])
            parameters.append(self._clock[1])
            self.state_names.append("time")
        self.p: ca.SX = ca.vertcat(ca.SX(0, 1), *parameters)
        self.z: ca.SX = ca.vertcat(ca.SX(0, 1), *states)

    @property
    def in_time(self) -> bool:
        """Whether an effect changes over the run."""
        return any(instance.effect.in_time for instance in self.instances)

    def _required(self, duration: float | None) -> float:
        changing = [instance.effect.id for instance in self.instances if instance.effect.in_time]
        if changing and not duration:
            raise EffectError(
                f"{changing[0]} changes over the length of a run, but this run has no end",
                "Simulate a trajectory with `elastic-arm simulate`, or omit the effect.",
            )
        return duration or 0.0

    def numbers(self, instances: Sequence[EffectInstance] | None = None) -> np.ndarray:
        """Return the values of `p` (P,), of the effects as made or with other parameters."""
        rows = [
            np.atleast_1d(np.asarray(instance.parameters[entry.name], dtype=float))
            for instance in (self.instances if instances is None else instances)
            for entry in instance.effect.parameters
        ]
        return np.concatenate([np.zeros(0), *rows, [self._duration] if self.in_time else []])

    def contribution(self, motion: SymbolicMotion) -> tuple[Contribution, ca.SX]:
        """Return the sum of all laws, and the rates of `z`.

        Transmission errors come first: the other laws of the joint find them in the deflection.
        Friction comes before what scales it.
        """
        twist = ca.SX(motion.n, 1)
        twist_rate = ca.SX(motion.n, 1)
        for instance, i, values in self._placed:
            if instance.effect.twist is not None:
                error, rate = instance.effect.twist(motion, i, values)
                twist[i] += error
                twist_rate[i] += rate
        motion = replace(motion, twist=twist, twist_rate=twist_rate)
        if self.in_time and motion.progress is None:
            motion = replace(
                motion, elapsed=self._clock[0], progress=self._clock[0] / self._clock[1] - 0.5
            )
        total = motion.nothing()
        rates = []
        friction = motion.nothing()
        for instance, i, values in self._placed:
            if instance.effect.friction:
                friction += _checked(instance.effect, instance.effect.law(motion, i, values))
        motion = replace(motion, friction_link=friction.link, friction_motor=friction.motor)
        for instance, i, values in self._placed:
            part = _checked(instance.effect, instance.effect.law(motion, i, values))
            total += part
            rates += [part.rates[name] for name in instance.effect.states]
        return total, ca.vertcat(ca.SX(0, 1), *rates, *([ca.SX(1.0)] if self.in_time else []))


def _checked(effect: Effect, part: object) -> Contribution:
    """Return what a law gave, if a user's law gave what it should."""
    if not isinstance(part, Contribution):
        raise EffectError(
            f"the law of {effect.id} does not return a Contribution",
            "Return motion.at(i, …) with link, drive or motor.",
        )
    if missing := [name for name in effect.states if name not in part.rates]:
        raise EffectError(
            f"the law of {effect.id} gives no rate for its state {missing[0]}",
            "Return motion.at(i, …, rates={…}).",
        )
    return part


def law_joints(instance: EffectInstance, robot: Robot) -> tuple[int, ...]:
    """Return the joints for which a law is evaluated.

    Once for the whole arm where it acts on all joints at once.
    """
    joints = instance.joint_indices(robot)
    return joints[:1] if instance.effect.scope is Scope.ARM else joints
