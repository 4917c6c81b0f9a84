"""Columns that identification adds to those of the model: the linear parameters of effects."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects import Catalogue, EffectInstance, Role, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Effect, SensorEffect
from elastic_arm.effects.effect_set import law_joints
from elastic_arm.effects.library.friction import SIDE
from elastic_arm.effects.parameters import Parameter
from elastic_arm.estimation.motion import CompletedMotion, Motion
from elastic_arm.estimation.regressors import CompiledColumns, Signals, Term
from elastic_arm.identification.base_regression import Column
from elastic_arm.robot import Robot

# Dry friction turns over gradually below some speed, rad/s: presliding. A batch chooses one for
# each joint, the middle of what real arms show where the recordings do not tell; the stream has one
# for all.
SIGN_SPEEDS = (1e-4, 1e-3, 5e-3, 2e-2, 5e-2)
USUAL_SIGN_SPEED = 5e-3
DEFAULT_SIGN_SPEED = 1e-3


def law_columns(
    instances: Sequence[EffectInstance],
    robot: Robot,
    model: str = "mod3",
    sign_speed: float | Sequence[float] = DEFAULT_SIGN_SPEED,
) -> list[Column]:
    """Return one column for each linear parameter of each effect."""
    if not instances:
        return []
    evaluate = _LawColumns(tuple(instances), robot, model, sign_speed)
    # A law that is asked for holds no value of its own: where the description states one, that is
    # the nominal.
    described = {
        _place(entry["effect"], entry.get("joint"), robot): entry["parameters"]
        for entry in robot.effects
    }
    found: list[Column] = []
    for instance in instances:
        place = place_of(instance, robot)
        kind = {"dry": is_dry(instance)}
        kind["sensor"] = isinstance(instance.effect, SensorEffect)
        for p in _linear(instance.effect):
            stated = described.get(place, {}).get(p.name)
            nominal = (
                np.zeros(p.size) if stated is None else np.atleast_1d(stated) - (p.neutral or 0.0)
            )
            unit = p.unit_at(instance.joint, robot.units)
            least = p.least - (p.neutral or 0.0)
            for name, value in zip(p.component_names, nominal.tolist(), strict=True):
                values = partial(evaluate.column, len(found))
                found.append(Column(f"{place}.{name}", unit, values, value, least, **kind))
    return found


def place_of(instance: EffectInstance, robot: Robot) -> str:
    """Return the beginning of the names of an effect's parameters, such as
    "coulomb_friction:joint_2"."""
    return _place(instance.effect.id, instance.joint, robot)


def _place(effect: str, joint: str | None, robot: Robot) -> str:
    return f"{effect}:{joint or robot.name}"


def with_stated(
    effects: Sequence[EffectInstance],
    robot: Robot,
    *,
    motored: bool,
    catalogue: Catalogue | None = None,
) -> tuple[EffectInstance, ...]:
    """Return the laws of the description, such as friction, followed by those of the user."""
    own = {(instance.effect.id, instance.joint) for instance in effects}
    stated = [
        instance
        for instance in robot_effects(robot, catalogue)
        if _linear(instance.effect)
        and not instance.effect.scales_friction
        and (instance.effect.id, instance.joint) not in own
        and (motored or set(instance.sides) != {"motor"})
    ]
    return (*stated, *effects)


def on_recorded_side(
    effects: Sequence[EffectInstance], robot: Robot, *, motored: bool
) -> tuple[tuple[EffectInstance, ...], list[str]]:
    """Return laws on the side whose torques were recorded.

    Joint torque sensors of a rigid arm measure the friction of motors whose torques were not
    recorded: a rigid arm has one side, because its description does not state whether friction acts
    before or behind the sensor.

    Returns the laws, and the ids of those that were moved.
    """
    if robot.elastic or motored:
        return tuple(effects), []
    found = list[EffectInstance]()
    moved = list[str]()
    for instance in effects:
        if SIDE not in instance.effect.choices or set(instance.sides) != {"motor"}:
            found.append(instance)
            continue
        moved.append(instance.effect.id)
        felt = instance.with_parameters(**{SIDE.name: "link"})
        if felt not in effects:
            found.append(felt)
    return tuple(found), list(dict.fromkeys(moved))


def is_dry(instance: EffectInstance) -> bool:
    """Return whether the effect's law depends on the sign of a velocity."""
    return instance.effect.regime == "velocity_reversal"


def _linear(effect: Effect) -> list[Parameter]:
    return [p for p in effect.parameters if p.role is Role.LINEAR]


class _LawColumns:
    """All laws compiled together; the columns of the last motion are cached, because they are
    evaluated one by one."""

    def __init__(
        self,
        instances: tuple[EffectInstance, ...],
        robot: Robot,
        model: str,
        sign_speed: float | Sequence[float],
    ) -> None:
        self.robot = robot
        terms = []
        for instance in instances:
            effect = instance.effect
            choices = {choice.name: instance.parameters[choice.name] for choice in effect.choices}
            values = {one.name: instance.parameters[one.name] for one in effect.parameters}
            joints = law_joints(instance, robot)
            terms.append(Term(effect, joints, choices, _linear(effect), [values]))
        self.columns = CompiledColumns(terms, ArmEquations(robot, model), engine=None)
        self.standstill = np.broadcast_to(np.asarray(sign_speed, dtype=float), (robot.n,)).copy()
        self.last: tuple[Motion, Array] | None = None

    def column(self, k: int, motion: Motion) -> Array:
        """Return column k, (N, 3 n)."""
        if self.last is None or self.last[0] is not motion:
            self.last = motion, self.columns(self._signals(motion))
        return self.last[1][:, :, k]

    def _signals(self, motion: Motion) -> Signals:
        """Return the signals of a motion with both sides; no usable row contains a missing
        torque."""
        none = np.zeros((len(motion), self.robot.n))
        samples: dict[str, Any] = {"tau_J": none, "tau_m": none, **motion.channels()}
        return Signals.of_samples(
            CompletedMotion(**samples),
            (self.standstill, self.standstill),
            elastic=self.robot.elastic,
        )


def joint_of_law(name: str) -> str | None:
    """Return the joint of a law's parameter; None for other names.

    Such a name is "coulomb_friction:joint_2.torque".
    """
    law, _, rest = name.partition(":")
    return rest.rpartition(".")[0] if rest and law != "link_encoder" else None
