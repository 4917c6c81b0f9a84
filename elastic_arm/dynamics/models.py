"""The equations of motion of an arm over arrays of samples."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.codegen import kernels
from elastic_arm.codegen.derivations import cached_program
from elastic_arm.dynamics.bodies import Bodies, ModelParameter
from elastic_arm.dynamics.composition import compose
from elastic_arm.robot.description import Robot, require_robot

if TYPE_CHECKING:
    import casadi

Columns = Sequence[int] | Indices
# What shapes a derived program besides the bodies.
_DERIVED_BY = tuple(
    Path(__file__).with_name(f"{name}.py") for name in ("bodies", "recursion", "derivation")
)
TERMS = ("M", "S", "B", "c", "c1", "c2", "g")


def build_model(
    robot: Robot, name: str = "mod3", *, bearings: bool = False, engine: str | None = None
) -> Model:
    """Model `name` of `robot`.

    Parameters
    ----------
    name
        ``"mod1"``, ``"mod2"`` or ``"mod3"``; for a robot without transmissions all three are its
        rigid links.
    bearings
        Let the joints tilt about x and y on their bearings.
    engine
        ``"c"``, ``"numpy"``, or None for the fastest that this machine has.

    Raises
    ------
    RobotError
        If there is no such model, `robot` is something else, or the arm describes no bearings.
    """
    require_robot(robot)
    return Model(robot, name, compose(robot, name, bearings=bearings), engine)


class Model:
    """Equation (1) and regressor (10) of one composition of bodies.

    Attributes
    ----------
    robot, name
        As built.
    bodies
        What the recursion walks over.
    parameters
        Of Psi, with names, units and nominal values.
    Psi : (P,)
        Nominal values.
    """

    def __init__(self, robot: Robot, name: str, bodies: Bodies, engine: str | None = None) -> None:
        self.robot = robot
        self.name = name
        self.bodies = bodies
        self.parameters: tuple[ModelParameter, ...] = bodies.parameters
        self.Psi = np.array([p.nominal for p in bodies.parameters])
        self._engine = engine
        self._functions: dict[str, casadi.Function] = {}
        self._kernels: dict[tuple[str, tuple[int, ...] | None], kernels.Kernel] = {}

    def at(self, Psi: Array) -> Model:
        """Return the model at other parameters (P,), physical or not."""
        moved = copy(self)
        moved.Psi = np.asarray(Psi, dtype=float)
        return moved

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.robot.n

    @property
    def dof(self) -> int:
        """Number of generalized coordinates x."""
        return self.bodies.dof

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of x: q, theta, and the tilts with bearings."""
        return self.bodies.coordinates

    def inverse_dynamics(self, x: Array, dx: Array, ddx: Array, Psi: Array | None = None) -> Array:
        """Left side of (1) with K and D: (N, dof), [0; tau_m] for a true motion.

        x, dx, ddx: (N, dof) rad, rad/s and rad/s²; Psi: (P,) parameters; the description's when
        None.
        """
        return self._run("inverse_dynamics", x, dx, ddx, self._psi(Psi))[0]

    def regressor(
        self,
        x: Array,
        dx: Array,
        ddx: Array,
        columns: Columns | None = None,
        out: Array | None = None,
    ) -> Array:
        """Phi of (10), (N, dof, P), or only its `columns`.

        Written to `out`, if given, of that shape.

        x, dx, ddx: (N, dof) rad, rad/s and rad/s².
        """
        kernel = self.kernel("regressor", columns)
        width = len(self.parameters) if columns is None else len(columns)
        return np.asarray(kernel(x, dx, ddx, out=None if out is None else [out])).reshape(
            len(x), self.dof, width
        )

    def mass_matrix(self, x: Array) -> Array:
        """Whole matrix of (1), (N, dof, dof), in the order of x."""
        return self._run("mass_matrix", x, self.Psi)[0].reshape(len(x), self.dof, self.dof)

    def bias(self, x: Array, dx: Array) -> Array:
        """All of the left side of (1) that is not acceleration, K and D included: (N, dof).

        x, dx: (N, dof) rad and rad/s.
        """
        return self._run("bias", x, dx, self.Psi)[0]

    def terms(self, x: Array, dx: Array) -> dict[str, Array]:
        """M, S, B, c, c1, c2, g of (1) by name, samples first; the tilts count as link side.

        x, dx: (N, dof) rad and rad/s.
        """
        values = self._run("terms", x, dx, self.Psi)
        rows = len(self.bodies.link_side)
        columns = len(self.bodies.motor_side)
        shapes = {
            "M": (rows, rows),
            "S": (rows, columns),
            "B": (columns, columns),
            "c2": (columns,),
        }
        return {
            name: value.reshape(len(x), *shapes.get(name, (rows,)))
            for name, value in zip(TERMS, values, strict=True)
        }

    def forward_dynamics(self, x: Array, dx: Array, f: Array, Psi: Array | None = None) -> Array:
        """Accelerations ddx (N, dof) under generalized forces f (N, dof).

        x, dx: (N, dof) rad and rad/s; f: (N, dof) generalized forces, Nm; Psi: (P,) parameters; the
        description's when None.
        """
        return self._run("forward_dynamics", x, dx, f, self._psi(Psi))[0]

    def energy(self, x: Array, dx: Array, Psi: Array | None = None) -> tuple[Array, Array]:
        """Kinetic and potential energy, (N,) each, J.

        Springs are included; gravity counts from the ground's origin.

        x, dx: (N, dof) rad and rad/s; Psi: (P,) parameters; the description's when None.
        """
        kinetic, potential = self._run("energy", x, dx, self._psi(Psi))
        return kinetic[:, 0], potential[:, 0]

    def function(self, name: str) -> casadi.Function:
        """CasADi SX function of that name: see :mod:`elastic_arm.dynamics.derivation`."""
        if name not in self._functions:
            from elastic_arm.dynamics.derivation import DERIVATIONS

            self._functions[name] = DERIVATIONS[name](self.bodies)
        return self._functions[name]

    def kernel(self, name: str, columns: Columns | None = None) -> kernels.Kernel:
        """Compiled function of that name; of the regressor, only `columns`."""
        key = (name, None if columns is None else tuple(int(c) for c in columns))
        if key not in self._kernels:
            program = cached_program(
                f"{name}:{self.bodies.fingerprint()}", lambda: self.function(name), _DERIVED_BY
            )
            if key[1] is not None:
                program = program.columns("Phi", key[1])
            self._kernels[key] = kernels.make(program, self._engine, shared=("Psi",))
        return self._kernels[key]

    def _psi(self, Psi: Array | None) -> Array:
        return self.Psi if Psi is None else np.asarray(Psi, dtype=float)

    def _run(self, name: str, *arrays: Array) -> tuple[Array, ...]:
        result = self.kernel(name)(*arrays)
        return result if isinstance(result, tuple) else (result,)
