"""Columns of the catalogue's laws: effects whose parameters are identified beside the model's own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen import kernels
from elastic_arm.effects import EffectInstance, Role, Scope, SymbolicMotion, parse
from elastic_arm.effects.catalogue import find
from elastic_arm.effects.effect_set import law_joints
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.base_regression import Column
from elastic_arm.estimation.equations import SIDES
from elastic_arm.estimation.motion import Motion
from elastic_arm.robot import Robot

Array = NDArray[np.float64]
# Dry friction turns over gradually below some speed, rad/s: presliding. A batch tries these and takes the likeliest.
SIGN_SPEEDS = (1e-4, 1e-3, 5e-3, 2e-2)
DEFAULT_SIGN_SPEED = 1e-3


def parse_laws(texts: Sequence[str], robot: Robot) -> list[EffectInstance]:
    """Read effects as `EFFECT[:JOINT][:NAME=VALUE,…]`; without a joint they sit on every joint.

    Linear parameters need no value: they are what is identified.

    Raises
    ------
    EffectError, IdentificationError
        If there is no such effect, or none of its parameters is linear.
    """
    instances = []
    for text in texts:
        name, *rest = text.split(":")
        effect = find(name)
        joints = [part for part in rest if part and "=" not in part]
        values = [part for part in rest if "=" in part]
        if len(joints) > 1 or len(values) > 1:
            raise IdentificationError(f"cannot read the law {text!r}", "Write EFFECT[:JOINT][:NAME=VALUE,NAME=VALUE].")
        named = {part.partition("=")[0].strip() for part in ",".join(values).split(",")}
        linear = [p for p in effect.parameters if p.role is Role.LINEAR]
        if not linear or effect.states:
            raise IdentificationError(
                f"{name} is not linear in its parameters", "Leave it to `elastic-arm diagnose`, which searches them."
            )
        neutral = [f"{p.name}={'/'.join([str(p.neutral or 0.0)] * p.size)}" for p in linear if p.name not in named]
        wanted = ",".join([*values, *neutral])
        places = joints or (list(robot.joint_names) if effect.scope is Scope.EACH else [""])
        instances += [parse(":".join(part for part in (name, place, wanted) if part), robot) for place in places]
    return instances


def law_columns(
    instances: Sequence[EffectInstance], robot: Robot, model: str = "mod3", sign_speed: float = DEFAULT_SIGN_SPEED
) -> list[Column]:
    """Return one column for each linear parameter of each effect; sign(w) is tanh(w / sign_speed)."""
    if not instances:
        return []
    evaluate = _Evaluator(tuple(instances), robot, model, sign_speed)
    entries = [
        (f"{active.effect.id}:{active.joint or robot.name}.{name}", unit)
        for active in instances
        for name, unit, _ in _linear_entries(active)
    ]
    return [Column(name, unit, partial(evaluate.column, k)) for k, (name, unit) in enumerate(entries)]


def is_dry(active: EffectInstance) -> bool:
    """Say whether the effect's law depends on the sign of a velocity."""
    return active.effect.regime == "velocity_reversal"


def _linear_entries(active: EffectInstance) -> list[tuple[str, str, int]]:
    """Return name, unit and index among all numbers of the effect for each linear parameter."""
    entries, index = [], 0
    for p in active.effect.parameters:
        for i in range(p.size):
            if p.role is Role.LINEAR:
                entries.append((p.name if p.size == 1 else f"{p.name}_{'xyz'[i]}", p.unit, index))
            index += 1
    return entries


class _Evaluator:
    """All laws in one kernel; the columns of the last motion are kept, as they are asked for one by one."""

    def __init__(self, instances: tuple[EffectInstance, ...], robot: Robot, model: str, sign_speed: float) -> None:
        self.robot = robot
        self.kernel, self.nominal = _kernel(instances, robot, model)
        self.sign_speed = np.array([sign_speed])
        self.last: tuple[Motion, Array] | None = None

    def column(self, k: int, motion: Motion) -> dict[str, Array]:
        """Return column k by residual."""
        if self.last is None or self.last[0] is not motion:
            self.last = motion, self.columns(motion)
        return dict(zip(SIDES, np.split(self.last[1][:, :, k], 3, axis=1), strict=True))

    def columns(self, motion: Motion) -> Array:
        """Return all columns (N, 3 n, k)."""
        robot = self.robot
        none = np.zeros((len(motion), robot.n))
        pairs = [(getattr(motion, rate + "q"), getattr(motion, rate + "theta")) for rate in ("", "d", "dd")]
        states = [np.hstack(pair) if robot.elastic else pair[0] for pair in pairs]
        torques = [none if tau is None else tau for tau in (motion.tau_J, motion.tau_m)]
        values = np.asarray(self.kernel(*states, *torques, self.nominal, self.sign_speed))
        return values.reshape(len(motion), 3 * robot.n, -1)


def _kernel(instances: tuple[EffectInstance, ...], robot: Robot, model: str) -> tuple[kernels.Kernel, Array]:
    """Compile (x, dx, ddx, tau_J, tau_m, Psi, speed) -> contributions (3 n, k) per unit of the parameters."""
    equations = ArmEquations(robot, model)
    n = robot.n
    x, dx, ddx = (ca.SX.sym(name, equations.dof) for name in ("x", "dx", "ddx"))
    tau_J, tau_m, speed = ca.SX.sym("tau_J", n), ca.SX.sym("tau_m", n), ca.SX.sym("speed")
    velocity = {"link": dx[:n], "motor": dx[n : 2 * n] if robot.elastic else dx[:n]}

    def sign(side: str, i: int) -> ca.SX:
        return ca.tanh(velocity[side][i] / speed)

    motion = SymbolicMotion(equations, x, dx, ddx, tau_J, tau_m, ca.SX(n, 1), ca.SX(n, 1), sign)
    columns = ca.horzcat(*(_linear_columns(active, motion) for active in instances))
    inputs = {"x": x, "dx": dx, "ddx": ddx, "tau_J": tau_J, "tau_m": tau_m, "Psi": equations.Psi, "speed": speed}
    function = ca.Function("laws", list(inputs.values()), [ca.sparsify(columns)], list(inputs), ["columns"])
    return kernels.compile(function, shared=("Psi", "speed")), equations.nominal


def _linear_columns(active: EffectInstance, motion: SymbolicMotion) -> ca.SX:
    """Return the derivative of link, drive and motor contributions (3 n, k) by the linear parameters."""
    symbols = {p.name: ca.SX.sym(p.name, p.size) for p in active.effect.parameters}
    numbers = np.concatenate([np.atleast_1d(np.asarray(active.parameters[name], dtype=float)) for name in symbols])
    p = ca.vertcat(*symbols.values())
    total = motion.nothing()
    for i in law_joints(active, motion.robot):
        total += active.effect.law(motion, i, {**active.parameters, **symbols})
    wanted = [index for _, _, index in _linear_entries(active)]
    stacked = ca.vertcat(total.link, total.drive, total.motor)
    return ca.substitute(ca.jacobian(stacked, p)[:, wanted], p, ca.DM(numbers))
