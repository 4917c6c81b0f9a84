"""A law tried on symbols, before an arm needs it."""

from __future__ import annotations

import casadi as ca

from elastic_arm.effects.effect_set import EffectSet
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Effect
from elastic_arm.effects.motion import SymbolicMotion
from elastic_arm.robot import Robot, load_robot


def check_law(effect: Effect, robot: Robot | None = None) -> None:
    """Write the law of an effect over the symbols of an arm, of the nominal one when None."""
    robot = robot or load_robot(None)
    equations = ArmEquations(robot, effect.lacked_by[-1])
    EffectSet([next(effect.candidates(robot))], robot, duration=1.0).contribution(_symbols(equations))


def _symbols(equations: ArmEquations) -> SymbolicMotion:
    """Return a motion of symbols, with exact signs of velocities."""
    n, dof = equations.robot.n, equations.dof
    x, dx, ddx = (ca.SX.sym(name, dof) for name in ("x", "dx", "ddx"))
    tau_J, tau_m, dtau_J, dtau_m = (ca.SX.sym(name, n) for name in ("tau_J", "tau_m", "dtau_J", "dtau_m"))
    velocities = {"link": dx[:n], "motor": dx[dof - n :]}
    return SymbolicMotion(
        equations, x, dx, ddx, tau_J, tau_m, dtau_J, dtau_m, lambda side, i: ca.sign(velocities[side][i]),
        r=ca.SX.sym("r", n), dr=ca.SX.sym("dr", n), made=ca.SX.sym("made", n),
    )  # fmt: skip
