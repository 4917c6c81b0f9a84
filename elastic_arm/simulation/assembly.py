"""The equations that the simulator integrates: those of the arm plus the laws of the effects."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.derivations import cached_functions
from elastic_arm.dynamics.derivation import bias, mass_matrix, solve
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import EffectInstance
from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.motion import Contribution, SymbolicMotion

SX = ca.SX
# Folders of what shapes the functions that are kept on disk.
SOURCES = tuple(
    Path(__file__).parents[1] / name for name in ("codegen", "dynamics", "effects", "simulation")
)


@dataclass(frozen=True)
class System:
    """An arm with effects, ready to be integrated."""

    # equations, effect_set: the arm and the laws that act on it
    equations: ArmEquations
    effect_set: EffectSet
    # (Psi, p, speed) -> all that depends on parameters alone, evaluated once
    constants: ca.Function
    accelerations: ca.Function  # (x, dx, z, tau_m, constants) -> (ddx, dz, tau_J)
    # (x, dx, z, Psi, p, speed) -> left side of (1) with the effects at no acceleration and no motor
    # torque
    balance: ca.Function
    stiffness_of_balance: ca.Function  # its derivative by x
    # (x, dx, z, tau_m, Psi, p, speed) -> derivative of the left side by the signs of the velocities
    # (dof, 2n), and the mass matrix
    friction: ca.Function
    integrators: dict[str, Any]  # made of it so far, by name; shared by all systems of its shape

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.equations.robot.n

    @property
    def dof(self) -> int:
        """Number of generalized coordinates."""
        return self.equations.dof

    @property
    def states(self) -> int:
        """Number of internal states of effects."""
        return int(self.effect_set.z.numel())

    def evaluate_constants(self, speed: Array) -> Array:
        """Return the constants for the arm's parameters and speeds (2n,).

        Within these speeds friction is regularised.
        """
        return np.array(
            self.constants(self.equations.nominal, self.effect_set.numbers(), speed)
        ).ravel()


# Systems put together in this process: a campaign makes thousands of arms of few shapes.
_known: OrderedDict[str, System] = OrderedDict()
_MOST_KNOWN = 64
_DERIVED = ("constants", "accelerations", "balance", "stiffness_of_balance", "friction")


def assemble(
    equations: ArmEquations, instances: Sequence[EffectInstance], duration: float | None = None
) -> System:
    """Put an arm and effects together, or find a system of the same shape."""
    shape = _shape(equations, instances)
    effect_set = EffectSet(instances, equations.robot, duration)
    if shape not in _known:
        # On disk an arm of its own is worth keeping; every arm with effects and numbers of its own
        # would fill it.
        if instances:
            functions = _derive(equations, effect_set)
        else:
            functions = cached_functions(shape, lambda: _derive(equations, effect_set), SOURCES)
        named: dict[str, Any] = dict(zip(_DERIVED, functions, strict=True))
        _known[shape] = System(equations, effect_set, integrators={}, **named)
        if len(_known) > _MOST_KNOWN:
            _known.popitem(last=False)
    return replace(_known[shape], equations=equations, effect_set=effect_set)


def _shape(equations: ArmEquations, instances: Sequence[EffectInstance]) -> str:
    """What the straight-line code depends on; laws may read any number of the nominal arm, an arm
    alone does not."""
    laws = [
        (
            instance.effect.id,
            instance.joint,
            [str(instance.parameters[c.name]) for c in instance.effect.choices],
        )
        for instance in instances
    ]
    numbers = [equations.nominal.tolist(), equations.robot.base_placement.tolist()] if laws else []
    return repr(
        (
            equations.bodies.fingerprint(),
            equations.robot.gravity.tolist(),
            equations.model_name,
            laws,
            numbers,
        )
    )


def _derive(equations: ArmEquations, effect_set: EffectSet) -> list[ca.Function]:
    """Derive the functions of a system, in the order of :data:`_DERIVED`.

    With tau_J taken from the drive equation, (1) reads `left side + effects = [0; tau_m]`, linear
    in the accelerations also where a law contains them (an added mass).
    """
    n = equations.robot.n
    dof = equations.dof
    Psi = equations.Psi
    speed = SX.sym("speed", 2 * n)
    signs = SX.sym("signs", 2 * n)
    motion = _symbolic_motion(equations, signs)
    x = motion.x
    dx = motion.dx
    ddx = motion.ddx
    tau_m = motion.tau_m
    added, rates = effect_set.contribution(motion)
    joint_torque = _joint_torque(motion, added)

    def finished(expression: SX) -> SX:
        expression = ca.substitute(expression, motion.tau_J, joint_torque)
        return ca.substitute(expression, signs, _smooth_signs(motion, speed))

    rows = ca.substitute(_rows(motion, added), motion.tau_J, joint_torque)
    of_laws = ca.jacobian(rows, ddx)
    still = finished(ca.substitute(rows, ddx, SX.zeros(dof)))
    M = mass_matrix(equations.bodies)(x, Psi) + finished(of_laws)
    h = bias(equations.bodies)(x, dx, Psi) + still
    solution = solve(M, _input_rows(motion, tau_m) - h)
    outputs = ca.cse([solution, finished(rates), finished(joint_torque)])
    given = ca.vertcat(Psi, effect_set.p, speed)
    outputs, symbols, hoisted = ca.extract_parametric(outputs, given, {"extract_trivial": True})
    constants = ca.vertcat(SX(0, 1), *symbols)
    names = ["x", "dx", "z", "tau_m", "constants"]
    at = [x, dx, effect_set.z, Psi, effect_set.p, speed]
    h = ca.substitute(h, tau_m, SX.zeros(n))
    return [
        ca.Function("constants", [Psi, effect_set.p, speed], [ca.vertcat(SX(0, 1), *hoisted)]),
        ca.Function(
            "accelerations",
            [x, dx, effect_set.z, tau_m, constants],
            [ca.densify(o) for o in outputs],
            names,
            ["ddx", "dz", "tau_J"],
        ),
        ca.Function("balance", at, [h]),
        ca.Function("stiffness_of_balance", at, [ca.jacobian(h, x)]),
        ca.Function("friction", [*at[:3], tau_m, *at[3:]], [finished(ca.jacobian(rows, signs)), M]),
    ]


def law_rows(equations: ArmEquations, effect_set: EffectSet) -> ca.Function:
    """Return the function of what laws add to (1), and of the rates of z.

    (x, dx, ddx, z, tau_m, Psi, p, speed) -> addition to the left side of (1), rates of z

    For other engines: `speed` (2n,) regularises the signs of the velocities, as in the simulator.
    """
    n = equations.robot.n
    speed = SX.sym("speed", 2 * n)
    signs = SX.sym("signs", 2 * n)
    motion = _symbolic_motion(equations, signs)
    added, rates = effect_set.contribution(motion)
    joint_torque = _joint_torque(motion, added)
    smooth_signs = _smooth_signs(motion, speed)
    outputs = []
    for expression in (_rows(motion, added), rates):
        expression = ca.substitute(expression, motion.tau_J, joint_torque)
        outputs.append(ca.densify(ca.substitute(expression, signs, smooth_signs)))
    moving = [motion.x, motion.dx, motion.ddx, effect_set.z, motion.tau_m]
    return ca.Function(
        "law_rows",
        [*moving, equations.Psi, effect_set.p, speed],
        outputs,
        ["x", "dx", "ddx", "z", "tau_m", "Psi", "p", "speed"],
        ["rows", "dz"],
    )


def _symbolic_motion(equations: ArmEquations, signs: SX) -> SymbolicMotion:
    """Return the motion of an arm in symbols.

    signs: (2n, 1) of the link and motor velocities.
    """
    n = equations.robot.n
    dof = equations.dof
    unused = SX.zeros(n)
    return SymbolicMotion(
        equations,
        SX.sym("x", dof),
        SX.sym("dx", dof),
        SX.sym("ddx", dof),
        SX.sym("tau_J", n),
        SX.sym("tau_m", n),
        unused,
        unused,
        sign=lambda side, i: signs[i if side == "link" else n + i],
    )


def _smooth_signs(motion: SymbolicMotion, speed: SX) -> SX:
    """Return the signs (2n, 1) of the velocities, regularised below a speed."""
    return ca.tanh(ca.vertcat(motion.dq, motion.dtheta) / speed)


def _joint_torque(motion: SymbolicMotion, added: Contribution) -> SX:
    """tau_J of the drive equation; without a drive it is the motor torque."""
    if not motion.robot.elastic:
        return motion.tau_m
    return (
        motion.K * (motion.theta - motion.q) + motion.D * (motion.dtheta - motion.dq) + added.drive
    )


def _rows(motion: SymbolicMotion, added: Contribution) -> SX:
    """What the effects add to the left side of (1): the drive pulls the link and holds the motor
    back."""
    if not motion.robot.elastic:
        return added.link + added.motor
    tilts = motion.x.shape[0] - 2 * motion.n
    free = added.tilts if added.tilts is not None else SX(tilts, 1)
    return ca.vertcat(added.link - added.drive, added.motor + added.drive, free)


def _input_rows(motion: SymbolicMotion, tau_m: SX) -> SX:
    """Right side of (1)."""
    n = motion.n
    dof = motion.x.shape[0]
    return tau_m if not motion.robot.elastic else ca.vertcat(SX(n, 1), tau_m, SX(dof - 2 * n, 1))
