"""CasADi functions from bodies: everything in (1) and (10), by one recursion.

Only this module imports CasADi for derivations; a cached kernel does not need it.
"""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import recursion
from elastic_arm.dynamics.bodies import Bodies

TRIG = recursion.Trig(ca.sin, ca.cos)


class Symbols:
    """The variables of a mechanism: x, dx, ddx, f (dof,) and Psi (P,)."""

    def __init__(self, bodies: Bodies) -> None:
        self.x = ca.SX.sym("x", bodies.dof)
        self.dx = ca.SX.sym("dx", bodies.dof)
        self.ddx = ca.SX.sym("ddx", bodies.dof)
        self.f = ca.SX.sym("f", bodies.dof)
        self.Psi = ca.SX.sym("Psi", len(bodies.parameters))


def inverse_dynamics(bodies: Bodies) -> ca.Function:
    """(x, dx, ddx, Psi) -> f, the left side of (1)."""
    s = Symbols(bodies)
    return _function(
        "inverse_dynamics", s, ("x", "dx", "ddx", "Psi"), {"f": _forces(bodies, s, s.dx, s.ddx)}
    )


def regressor(bodies: Bodies) -> ca.Function:
    """(x, dx, ddx) -> Phi (dof, P) of (10), in the whole of Psi."""
    s = Symbols(bodies)
    forces = _forces(bodies, s, s.dx, s.ddx)
    # One adjoint sweep a row walks the joint's twist outward: far fewer operations than one sweep a
    # parameter.
    rows = [ca.gradient(forces[k], s.Psi).T for k in range(bodies.dof)]
    return _function("regressor", s, ("x", "dx", "ddx"), {"Phi": ca.vertcat(*rows)})


def mass_matrix(bodies: Bodies) -> ca.Function:
    """(x, Psi) -> the whole matrix of (1), (dof, dof), in the order of x."""
    s = Symbols(bodies)
    return _function("mass_matrix", s, ("x", "Psi"), {"M": _mass_matrix(bodies, s)})


def bias(bodies: Bodies) -> ca.Function:
    """(x, dx, Psi) -> all of the left side of (1) that is not acceleration."""
    s = Symbols(bodies)
    return _function("bias", s, ("x", "dx", "Psi"), {"h": _forces(bodies, s, s.dx, None)})


def forward_dynamics(bodies: Bodies) -> ca.Function:
    """(x, dx, f, Psi) -> ddx."""
    s = Symbols(bodies)
    ddx = solve(_mass_matrix(bodies, s), s.f - _forces(bodies, s, s.dx, None))
    return _function("forward_dynamics", s, ("x", "dx", "f", "Psi"), {"ddx": ddx})


def energy(bodies: Bodies) -> ca.Function:
    """(x, dx, Psi) -> kinetic, potential, J."""
    s = Symbols(bodies)
    kinetic, potential = recursion.energy(bodies, _list(s.x), _list(s.dx), _list(s.Psi), TRIG)
    outputs = {"kinetic": ca.SX(kinetic), "potential": ca.SX(potential)}
    return _function("energy", s, ("x", "dx", "Psi"), outputs)


def terms(bodies: Bodies) -> ca.Function:
    """(x, dx, Psi) -> M, S, B, c, c1, c2, g of (1), without springs.

    With bearings the tilts count as link side.
    """
    s = Symbols(bodies)
    link = list(bodies.link_side)
    motor = list(bodies.motor_side)
    whole = _mass_matrix(bodies, s)
    motor_at_rest = [0.0 if k in motor else s.dx[k] for k in range(bodies.dof)]
    no_gravity = [0.0, 0.0, 0.0]
    bias_all = _vector(_rigid(bodies, s, _list(s.dx), None, no_gravity))
    bias_link = _vector(_rigid(bodies, s, motor_at_rest, None, no_gravity))
    weight = _vector(_rigid(bodies, s, [0.0] * bodies.dof, None, None))
    outputs = {
        "M": whole[link, link],
        "S": whole[link, motor],
        "B": whole[motor, motor],
        "c": bias_link[link],
        # Linear in the motors' speeds: the axes of the spins do not turn on their carriers.
        "c1": ca.jacobian(bias_all[link], s.dx)[:, motor] @ s.dx[motor],
        "c2": bias_all[motor],
        "g": weight[link],
    }
    return _function("terms", s, ("x", "dx", "Psi"), outputs)


DERIVATIONS: dict[str, Callable[[Bodies], ca.Function]] = {
    f.__name__: f
    for f in (inverse_dynamics, regressor, mass_matrix, bias, forward_dynamics, energy, terms)
}


def solve(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve a symmetric positive definite system by L D LT without square roots.

    The code has no branches. Rows are eliminated in an order of little fill (approximate minimum
    degree), so structural zeros cost nothing.
    """
    factors = ca.ldl(ca.sparsify(matrix), True)
    return ca.ldl_solve(right, *factors)


def _list(vector: ca.SX) -> list[ca.SX]:
    return [vector[k] for k in range(vector.numel())]


def _vector(scalars: list[ca.SX | float]) -> ca.SX:
    return ca.vertcat(*(ca.SX(s) for s in scalars))


def _rigid(
    bodies: Bodies,
    s: Symbols,
    dx: Sequence[ca.SX | float],
    ddx: Sequence[ca.SX | float] | None,
    gravity: list[float] | None,
) -> list[ca.SX | float]:
    """Forces without springs; `ddx` zero when None."""
    acceleration: Sequence[ca.SX | float] = [0.0] * bodies.dof if ddx is None else ddx
    return recursion.inverse_dynamics(
        bodies, _list(s.x), dx, acceleration, _list(s.Psi), TRIG, gravity
    )


def _forces(bodies: Bodies, s: Symbols, dx: ca.SX, ddx: ca.SX | None) -> ca.SX:
    rigid = _rigid(bodies, s, _list(dx), None if ddx is None else _list(ddx), None)
    springs = recursion.spring_forces(bodies, _list(s.x), _list(dx), _list(s.Psi))
    return _vector(rigid) + _vector(springs)


def _mass_matrix(bodies: Bodies, s: Symbols) -> ca.SX:
    """One recursion a column, at rest and without weight; the symmetric half is taken from below
    the diagonal."""
    at_rest: list[ca.SX | float] = [0.0] * bodies.dof
    columns = []
    for k in range(bodies.dof):
        unit: list[ca.SX | float] = [float(j == k) for j in range(bodies.dof)]
        columns.append(_vector(_rigid(bodies, s, at_rest, unit, [0.0, 0.0, 0.0])))
    whole = ca.sparsify(ca.horzcat(*columns))
    return ca.tril2symm(ca.tril(whole))


def _function(
    name: str, s: Symbols, inputs: tuple[str, ...], outputs: dict[str, ca.SX]
) -> ca.Function:
    dense = ca.cse([ca.sparsify(value) for value in outputs.values()])
    return ca.Function(name, [getattr(s, i) for i in inputs], dense, list(inputs), list(outputs))


def nominal(bodies: Bodies) -> Array:
    """Psi of the description, (P,)."""
    return np.array([p.nominal for p in bodies.parameters])
