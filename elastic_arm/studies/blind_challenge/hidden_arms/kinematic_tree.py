"""The arm in Pinocchio: every link, rotor, wave generator and spline is a separate body.

Nothing is shared with `elastic_arm.dynamics`, because the diagnosis must not be checked against its
own equations. The gears are ideal, so the velocities of all bodies are a constant matrix times
those of the generalized coordinates, v_full = G v, and M = G' M_full G, h = G' h_full.
"""

from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RobotError, require_libraries
from elastic_arm.robot import Component, Robot


def pinocchio() -> Any:
    """Return the Pinocchio module."""
    require_libraries(
        "the challenge simulates its hidden arms with Pinocchio and needs", "pin:pinocchio"
    )
    import pinocchio as pin

    return pin


class KinematicTree:
    """Rigid-body tree of a robot with transmissions, reduced by the gears."""

    def __init__(
        self, robot: Robot, *, bearings: bool = False, base_tilt: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        self._pin = pin = pinocchio()
        self.n = n = robot.n
        self.dof = 4 * n if bearings else 2 * n
        self.model = pin.Model()
        self.model.gravity = pin.Motion(np.asarray(robot.gravity, dtype=float), np.zeros(3))
        self._rows: list[tuple[int, float]] = []
        tilt = pin.utils.rotate("x", base_tilt[0]) @ pin.utils.rotate("y", base_tilt[1])
        placement = pin.SE3(tilt, np.zeros(3)) * _se3(pin, robot.base_placement)
        parent = 0
        for i, joint in enumerate(robot.joints):
            placement = placement * _se3(pin, joint.before)
            gear = joint.transmission
            if gear is None:
                raise RobotError(
                    f"{joint.name} has no transmission", "The challenge needs an elastic arm"
                )
            parts = [(part, ratio) for part, ratio in gear.components.values()]
            # A component rides either on what carries the joint, or (rotor 1) on the joint's own
            # link. Pinocchio's composite-body algorithm needs bodies depth first, so what rides on
            # the carrier comes before the joint.
            for part, ratio in parts:
                if part.carrier != joint.link_name:
                    self._add_component(i, part, ratio, parent, placement)
            if bearings:
                parent = self._add(parent, pin.JointModelRY(), placement, 3 * n + i, 1.0)
                placement = pin.SE3.Identity()
                parent = self._add(parent, pin.JointModelRX(), placement, 2 * n + i, 1.0)
            axis = pin.JointModelPZ() if joint.prismatic else pin.JointModelRZ()
            parent = self._add(parent, axis, placement, i, 1.0)
            placement = _se3(pin, joint.after)
            link = joint.link
            self.model.appendBodyToJoint(
                parent,
                pin.Inertia(link.mass, np.asarray(link.com), np.asarray(link.inertia)),
                placement,
            )
            for part, ratio in parts:
                if part.carrier == joint.link_name:
                    self._add_component(i, part, ratio, parent, pin.SE3.Identity())
        self._data = self.model.createData()
        self.gears = np.zeros((len(self._rows), self.dof))
        for row, (column, ratio) in enumerate(self._rows):
            self.gears[row, column] = ratio

    def _add(self, parent: int, kind: Any, placement: Any, coordinate: int, ratio: float) -> int:
        self._rows.append((coordinate, ratio))
        return int(self.model.addJoint(parent, kind, placement, f"body_{len(self._rows)}"))

    def _add_component(
        self, i: int, part: Component, ratio: float, carrier: int, placement: Any
    ) -> None:
        pin = self._pin
        centre = placement * pin.SE3(np.eye(3), np.asarray(part.position, dtype=float))
        body = self._add(carrier, pin.JointModelRZ(), centre, self.n + i, ratio)
        inertia = pin.Inertia(part.mass, np.zeros(3), np.diag([part.ixx, part.ixx, part.izz]))
        self.model.appendBodyToJoint(body, inertia, pin.SE3.Identity())

    def terms(self, x: Array, dx: Array) -> tuple[Array, Array]:
        """Return the mass matrix (dof, dof) and the bias (dof,).

        Coriolis, centrifugal, gyroscopic and gravity.
        """
        q = self.gears @ x
        v = self.gears @ dx
        full = self._pin.crba(self.model, self._data, q)
        bias = self._pin.nonLinearEffects(self.model, self._data, q, v)
        return self.gears.T @ full @ self.gears, self.gears.T @ bias

    def gravity(self, x: Array) -> Array:
        """Return what holds the bodies at rest (dof,)."""
        return self.gears.T @ self._pin.computeGeneralizedGravity(
            self.model, self._data, self.gears @ x
        )

    def torque(self, x: Array, dx: Array, ddx: Array) -> Array:
        """Return M ddx + h (dof,), without stiffness and damping."""
        G = self.gears
        return G.T @ self._pin.rnea(self.model, self._data, G @ x, G @ dx, G @ ddx)


def _se3(pin: Any, placement: Array) -> Any:
    placement = np.asarray(placement, dtype=float)
    return pin.SE3(placement[:3, :3], placement[:3, 3])
