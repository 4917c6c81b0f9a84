"""Columns of the catalogue's laws: effects whose parameters are identified beside the model's own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import kernels
from elastic_arm.effects import Active, Role, Scope, parse
from elastic_arm.effects import Motion as SymbolicMotion
from elastic_arm.effects.acting import law_joints
from elastic_arm.effects.catalogue import find
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.errors import IdentificationError
from elastic_arm.identification.derivatives import Motion
from elastic_arm.identification.equations import Column
from elastic_arm.robot import Robot

Array = NDArray[np.float64]
SIDES = ("link", "drive", "motor")
# Below this speed, rad/s, dry friction turns over gradually: presliding, and the velocity's own error.
SIGN_SPEED = 0.01


def parse_laws(texts: Sequence[str], robot: Robot) -> list[Active]:
    """Read effects as `EFFECT[:JOINT][:NAME=VALUE,…]`; without a joint they sit on every joint.

    Linear parameters need no value: they are what is identified.

    Raises
    ------
    EffectError, IdentificationError
        If there is no such effect, or none of its parameters is linear.
    """
    actives = []
    for text in texts:
        name, *rest = text.split(":")
        effect = find(name)
        joint = next((part for part in rest if part and "=" not in part), None)
        given = next((part for part in rest if "=" in part), "")
        linear = [p for p in effect.parameters if p.role is Role.LINEAR]
        if not linear or effect.states:
            raise IdentificationError(
                f"{name} is not linear in its parameters", "Leave it to `elastic-arm diagnose`, which searches them."
            )
        neutral = [f"{p.name}={'/'.join([str(p.neutral or 0.0)] * p.size)}" for p in linear if p.name not in given]
        values = ",".join(part for part in (given, *neutral) if part)
        joints = [joint] if joint or effect.scope is not Scope.EACH else list(robot.joint_names)
        actives += [parse(":".join(part for part in (name, j, values) if part), robot) for j in joints]
    return actives


def law_columns(actives: Sequence[Active], robot: Robot, model: str = "mod3") -> list[Column]:
    """Return one column for each linear parameter of each effect."""
    columns = []
    for active in actives:
        names = _linear_entries(active)
        kernel, nominal = _kernel(active, robot, model, [index for _, _, index in names])
        evaluate = partial(_evaluate, kernel, nominal, robot)
        place = active.joint or robot.name
        for k, (name, unit, _) in enumerate(names):
            columns.append(Column(f"{active.effect.id}:{place}.{name}", unit, partial(_column, evaluate, k)))
    return columns


def _linear_entries(active: Active) -> list[tuple[str, str, int]]:
    """Return name, unit and index among all numbers of the effect for each linear parameter."""
    entries, index = [], 0
    for p in active.effect.parameters:
        for i in range(p.size):
            if p.role is Role.LINEAR:
                entries.append((p.name if p.size == 1 else f"{p.name}_{'xyz'[i]}", p.unit, index))
            index += 1
    return entries


def _kernel(active: Active, robot: Robot, model: str, wanted: list[int]) -> tuple[kernels.Kernel, Array]:
    """Compile (x, dx, ddx, tau_J, tau_m, Psi) -> contributions (3 n, parameters) per unit of the parameters."""
    equations = ArmEquations(robot, model)
    n = robot.n
    x, dx, ddx = (ca.SX.sym(name, equations.dof) for name in ("x", "dx", "ddx"))
    tau_J, tau_m = ca.SX.sym("tau_J", n), ca.SX.sym("tau_m", n)
    velocity = {"link": dx[:n], "motor": dx[n : 2 * n] if robot.elastic else dx[:n]}
    motion = SymbolicMotion(
        equations,
        x,
        dx,
        ddx,
        tau_J,
        tau_m,
        ca.SX(n, 1),
        ca.SX(n, 1),
        lambda side, i: ca.tanh(velocity[side][i] / SIGN_SPEED),
    )
    symbols = {p.name: ca.SX.sym(p.name, p.size) for p in active.effect.parameters}
    numbers = np.concatenate([np.atleast_1d(np.asarray(active.parameters[name], dtype=float)) for name in symbols])
    p = ca.vertcat(*symbols.values())
    total = motion.nothing()
    for i in law_joints(active, robot):
        total += active.effect.law(motion, i, {**active.parameters, **symbols})
    stacked = ca.vertcat(total.link, total.drive, total.motor)
    at = ca.substitute(ca.jacobian(stacked, p)[:, wanted], p, ca.DM(numbers))
    inputs = {"x": x, "dx": dx, "ddx": ddx, "tau_J": tau_J, "tau_m": tau_m, "Psi": equations.Psi}
    function = ca.Function("law", list(inputs.values()), [ca.sparsify(at)], list(inputs), ["columns"])
    return kernels.compile(function, shared=("Psi",)), equations.nominal


def _evaluate(kernel: kernels.Kernel, nominal: Array, robot: Robot, motion: Motion) -> Array:
    """Return the columns (N, 3 n, parameters)."""
    none = np.zeros((len(motion), robot.n))
    q, dq, ddq = (getattr(motion, r + "q") for r in ("", "d", "dd"))
    theta, dtheta, ddtheta = (getattr(motion, r + "theta") for r in ("", "d", "dd"))
    pairs = ((q, theta), (dq, dtheta), (ddq, ddtheta))
    states = [np.hstack(pair) if robot.elastic else pair[0] for pair in pairs]
    torques = [none if tau is None else tau for tau in (motion.tau_J, motion.tau_m)]
    columns = np.asarray(kernel(*states, *torques, nominal))
    return columns.reshape(len(motion), 3 * robot.n, -1)


def _column(evaluate: partial[Array], k: int, motion: Motion) -> dict[str, Array]:
    values = evaluate(motion)[:, :, k]
    return dict(zip(SIDES, np.split(values, 3, axis=1), strict=True))
