"""The symbolic equations of an arm for laws: a thin layer over the derivation in `dynamics`."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import recursion
from elastic_arm.dynamics.bodies import Bodies, Body
from elastic_arm.dynamics.composition import compose
from elastic_arm.dynamics.derivation import TRIG, nominal
from elastic_arm.robot import Robot

SX = ca.SX
ARRAYS = recursion.Trig(np.sin, np.cos)


@dataclass(frozen=True)
class Mechanism:
    """Bodies that are the same for all arms of the same equations, whatever their numbers."""

    fingerprint: str
    bodies: Bodies = field(compare=False, repr=False)


class ArmEquations:
    """Equation (1) of one arm in one model variant."""

    def __init__(self, robot: Robot, model: str = "mod3", *, bearings: bool = False) -> None:
        self.robot = robot
        self.model_name = model
        self._bearings = bearings
        self.bodies: Bodies = compose(robot, model, bearings=bearings)
        self.Psi = SX.sym("Psi", len(self.bodies.parameters))

    @property
    def dof(self) -> int:
        """Number of generalized coordinates."""
        return self.bodies.dof

    @cached_property
    def nominal(self) -> np.ndarray:
        """Psi of the robot's description (P,)."""
        return nominal(self.bodies)

    @cached_property
    def K(self) -> SX:
        """Stiffnesses of the drives (n, 1); of no row for an arm without transmissions."""
        return ca.vertcat(
            *(self.Psi[s.stiffness] for s in self.bodies.springs if s.against is not None)
        )

    @cached_property
    def D(self) -> SX:
        """Dampings of the drives (n, 1)."""
        return ca.vertcat(
            *(self.Psi[s.damping] for s in self.bodies.springs if s.against is not None)
        )

    @cached_property
    def B(self) -> SX:
        """Diagonal of B, (6) or (7); of an arm without transmissions its armatures."""
        n = self.robot.n
        first = n if self.robot.elastic else 0
        inertias: list[Any] = [SX(0.0)] * n
        for spin in self.bodies.spins:
            for coordinate, ratio in spin.gears:
                inertias[coordinate - first] += ratio**2 * self.Psi[spin.parameter]
        return ca.vertcat(*inertias)

    def left_side(self, x: SX, dx: SX, ddx: SX, *, model: str | None = None) -> SX:
        """Return the left side of (1) with K and D (dof, 1).

        That of another variant has its nominal numbers.
        """
        if model is None:
            return _derived_left_side(self._mechanism)(x, dx, ddx, self.Psi)
        bodies = compose(self.robot, model, bearings=self._bearings)
        return _left_side(bodies, x, dx, ddx, [float(value) for value in nominal(bodies)])

    def carried_body(
        self, link: int, mass: SX, moment: SX, inertia: SX, x: SX, dx: SX, ddx: SX
    ) -> SX:
        """Return what a body fixed to a link adds to the left side of (1)."""
        frame = next(i for i, f in enumerate(self.bodies.frames) if f.coordinate == link)
        # The frames behind it do not move it.
        alone = replace(
            self.bodies,
            frames=self.bodies.frames[: frame + 1],
            bodies=(Body("carried", frame, np.eye(4), tuple(range(10))),),
            spins=(),
            springs=(),
        )
        ten = [mass, *_entries(SX(moment))] + [
            inertia[index] for index in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]
        return _column(
            recursion.inverse_dynamics(alone, _entries(x), _entries(dx), _entries(ddx), ten, TRIG)
        )

    def gravity_columns(self, x: SX) -> SX:
        """Return the derivative of (1)'s left side by the gravity vector, (dof, 3).

        The vector is in the ground frame.
        """
        columns = _derived_gravity_columns(self._mechanism)(x, self.Psi)
        return columns @ ca.DM(self.robot.base_placement[:3, :3].T)

    @cached_property
    def _mechanism(self) -> Mechanism:
        return Mechanism(self.bodies.fingerprint(), self.bodies)

    def moved_and_pulled(
        self, x: Array, dx: Array, ddx: Array, *, motors: bool
    ) -> tuple[Array, Array]:
        """Return torques of motion and of gravity at the nominal arm, for samples."""
        # A few thousand samples once: the recursion runs over them, and nothing is derived for
        # them.
        still: list[Any] = [0.0] * self.dof
        motions = [
            ([*dx.T], [*ddx.T], [0.0, 0.0, 0.0]),
            *((still, still, axis.tolist()) for axis in np.eye(3)),
        ]
        values = np.zeros((len(x), self.dof, 4))
        for k, (rates, accelerations, weight) in enumerate(motions):
            symbols = ([*x.T], rates, accelerations, self.nominal.tolist())
            forces = recursion.inverse_dynamics(self.bodies, *symbols, ARRAYS, weight)
            for i, force in enumerate(forces):
                values[:, i, k] = force
        values[:, :, 1:] = values[:, :, 1:] @ self.robot.base_placement[:3, :3].T
        if self.robot.elastic:
            # A motor bears what its link needs and what it needs itself.
            n = self.robot.n
            values = values[:, :n] + (values[:, n:] if motors else 0.0)
        return values[:, :, 0], values[:, :, 1:]


@lru_cache(maxsize=8)
def _derived_left_side(mechanism: Mechanism) -> ca.Function:
    """(x, dx, ddx, Psi) -> left side of (1): each effect that takes it would derive it anew."""
    bodies = mechanism.bodies
    x = SX.sym("x", bodies.dof)
    dx = SX.sym("dx", bodies.dof)
    ddx = SX.sym("ddx", bodies.dof)
    Psi = SX.sym("Psi", len(bodies.parameters))
    left = _left_side(bodies, x, dx, ddx, _entries(Psi))
    return ca.Function("left_side", [x, dx, ddx, Psi], [left])


@lru_cache(maxsize=8)
def _derived_gravity_columns(mechanism: Mechanism) -> ca.Function:
    """(x, Psi) -> derivative of the left side by gravity along the axes of the base, (dof, 3)."""
    bodies = mechanism.bodies
    x = SX.sym("x", bodies.dof)
    Psi = SX.sym("Psi", len(bodies.parameters))
    still: list[Any] = [0.0] * bodies.dof
    columns = [
        _column(
            recursion.inverse_dynamics(
                bodies, _entries(x), still, still, _entries(Psi), TRIG, list(axis)
            )
        )
        for axis in np.eye(3)
    ]
    return ca.Function("gravity_columns", [x, Psi], [ca.horzcat(*columns)])


def _left_side(bodies: Bodies, x: SX, dx: SX, ddx: SX, Psi: Sequence[Any]) -> SX:
    rigid = recursion.inverse_dynamics(bodies, _entries(x), _entries(dx), _entries(ddx), Psi, TRIG)
    return _column(rigid) + _column(recursion.spring_forces(bodies, _entries(x), _entries(dx), Psi))


def _entries(vector: SX) -> list[SX]:
    return [vector[k] for k in range(vector.numel())]


def _column(scalars: Sequence[Any]) -> SX:
    return ca.vertcat(*(SX(s) for s in scalars))
