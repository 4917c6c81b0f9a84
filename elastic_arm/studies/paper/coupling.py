"""The low-inertia coupling S in symbols, as in (8) and (9), by the recursion of the numbers.

Column j of S is the torque on the link side when only motor j accelerates and nothing else moves.
"""

from collections import defaultdict
from dataclasses import dataclass, replace

import sympy

from elastic_arm.dynamics.bodies import Bodies
from elastic_arm.dynamics.composition import compose
from elastic_arm.dynamics.recursion import Trig, inverse_dynamics
from elastic_arm.errors import RobotError
from elastic_arm.robot.description import Robot


@dataclass(frozen=True)
class SymbolicCoupling:
    """S in symbols, a column a motor."""

    # coordinates of the link side: q_1 … q_n and, with bearings, the tilts q_ix, q_iy
    rows: tuple[str, ...]
    matrix: sympy.Matrix  # (len(rows), n); its first n rows are the S of (8)
    # Per motor j, the sum of izz times ratio over its bodies that ride on a moving link: the
    # bracket in (9)
    reflected: tuple[sympy.Expr, ...]
    sigma: sympy.Matrix  # matrix[i, j] = reflected[j] sigma[i, j], functions of the angles alone


def symbolic_coupling(robot: Robot, *, bearings: bool = False) -> SymbolicCoupling:
    """Derive S of mod3 in symbols."""
    if not robot.elastic:
        raise RobotError(
            f"robot {robot.name} has no transmissions", "S couples motors to links; use an arm file"
        )
    bodies = _with_symbols(robot, compose(robot, "mod3", bearings=bearings))
    x = [sympy.Symbol(name, real=True) for name in bodies.coordinates]
    Psi = [_parameter(parameter.name) for parameter in bodies.parameters]
    n = robot.n
    zero = [sympy.Integer(0)] * bodies.dof
    links = bodies.link_side
    matrix = sympy.zeros(len(links), n)
    for j in range(n):
        push = list(zero)
        push[bodies.motor_side[j]] = sympy.Integer(1)
        forces = inverse_dynamics(
            bodies, x, zero, push, Psi, Trig(sympy.sin, sympy.cos), gravity=[0.0, 0.0, 0.0]
        )
        for i, coordinate in enumerate(links):
            matrix[i, j] = sympy.expand(sympy.nsimplify(forces[coordinate], rational=True))
    spun = defaultdict(list)
    for spin in bodies.spins:
        for motor, ratio in spin.gears if spin.frame >= 0 else ():
            spun[motor].append(Psi[spin.parameter] * ratio)
    reflected = tuple(sympy.Add(*spun[motor]) for motor in bodies.motor_side)
    sigma = sympy.Matrix(*matrix.shape, lambda i, j: sympy.simplify(matrix[i, j] / reflected[j]))
    return SymbolicCoupling(tuple(bodies.coordinates[k] for k in links), matrix, reflected, sigma)


def linearized(expression: sympy.Expr) -> sympy.Expr:
    """Return the first-order part of an expression in the bearing tilts q_ix, q_iy."""
    tilts = [s for s in sorted(expression.free_symbols, key=str) if s.name[-1] in "xy"]
    level = dict.fromkeys(tilts, 0)
    terms = [sympy.simplify(expression.diff(tilt).subs(level)) * tilt for tilt in tilts]
    return sympy.simplify(expression.subs(level)) + sympy.Add(*terms)


def _with_symbols(robot: Robot, bodies: Bodies) -> Bodies:
    """Put the symbols r_b and r_hd in the place of the gear ratios' numbers."""
    r_b, r_hd = sympy.symbols("r_b r_hd", positive=True)
    symbols = {"rotor": r_b * r_hd, "wave_generator": r_hd, "spline": sympy.Integer(1)}
    spins = []
    for spin in bodies.spins:
        ratio = symbols[bodies.parameters[spin.parameter].name.split(".")[-2]]
        spins.append(replace(spin, gears=tuple((k, ratio) for k, _ in spin.gears)))
    return replace(bodies, spins=tuple(spins))


_SHORT = {"rotor": "r", "wave_generator": "wg", "spline": "spl"}


def _parameter(name: str) -> sympy.Symbol:
    """Name an inertia as in (9): I_zz^{r,1} for joint_1.rotor.Izz; other parameters keep their
    names."""
    parts = name.split(".")
    if len(parts) == 3 and parts[1] in _SHORT and parts[2] == "Izz":
        return sympy.Symbol(
            f"I_zz^({_SHORT[parts[1]]},{parts[0].removeprefix('joint_')})", positive=True
        )
    return sympy.Symbol(name, real=True)
