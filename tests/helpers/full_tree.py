"""An arm in Pinocchio with every component a body on a joint of its own, reduced by the constant
gear matrix G."""

import numpy as np
import pinocchio as pin

from elastic_arm.robot import Robot


class FullTree:
    """Inverse dynamics and mass matrix of mod3 from an engine that nobody here wrote."""

    def __init__(self, robot: Robot, *, bearings: bool) -> None:
        self.robot = robot
        n = robot.n
        self.dof = (4 if bearings else 2) * n if robot.elastic else n
        self.bearings = bearings
        self.model = pin.Model()
        self.model.gravity.linear[:] = robot.gravity
        self._gears: list[tuple[int, int, float]] = []
        parent, placement = 0, pin.SE3(robot.base_placement)
        for i, joint in enumerate(robot.joints):
            before_joint = (parent, placement * pin.SE3(joint.before))
            at = before_joint
            for kind, coordinate in (
                (pin.JointModelRY(), 3 * n + i),
                (pin.JointModelRX(), 2 * n + i),
            ):
                if bearings:
                    at = (
                        self._turning(at, kind, f"{joint.name}_{coordinate}", coordinate, 1.0),
                        pin.SE3.Identity(),
                    )
            own = pin.JointModelPZ() if joint.prismatic else pin.JointModelRZ()
            turned = self._turning(at, own, joint.name, i, 1.0)
            after = pin.SE3(joint.after)
            link = joint.link
            self.model.appendBodyToJoint(
                turned, pin.Inertia(link.mass, link.com, link.inertia), after
            )
            if joint.transmission is not None:
                for what, (component, ratio) in joint.transmission.components.items():
                    seat, seat_placement = (
                        (turned, pin.SE3.Identity())
                        if component.carrier == joint.link_name
                        else before_joint
                    )
                    centre = pin.SE3(np.eye(3), component.position)
                    name = f"{joint.name}_{what}"
                    spinning = self._turning(
                        (seat, seat_placement * centre), pin.JointModelRZ(), name, n + i, ratio
                    )
                    tensor = np.diag([component.ixx, component.ixx, component.izz])
                    self.model.appendBodyToJoint(
                        spinning,
                        pin.Inertia(component.mass, np.zeros(3), tensor),
                        pin.SE3.Identity(),
                    )
            parent, placement = turned, after
        self.data = self.model.createData()
        self.G = np.zeros((self.model.nv, self.dof))
        for joint_id, coordinate, ratio in self._gears:
            self.G[self.model.joints[joint_id].idx_v, coordinate] = ratio

    def _turning(
        self,
        at: tuple[int, pin.SE3],
        kind: pin.JointModel,
        name: str,
        coordinate: int,
        ratio: float,
    ) -> int:
        joint_id = self.model.addJoint(at[0], kind, at[1], name)
        self._gears.append((joint_id, coordinate, ratio))
        return joint_id

    def inverse_dynamics(self, x: np.ndarray, dx: np.ndarray, ddx: np.ndarray) -> np.ndarray:
        """Left side of (1) at one sample, (dof,)."""
        rigid = pin.rnea(self.model, self.data, self.G @ x, self.G @ dx, self.G @ ddx)
        return self.G.T @ rigid + self._springs(x, dx)

    def mass_matrix(self, x: np.ndarray) -> np.ndarray:
        """(dof, dof)."""
        # By columns of inverse dynamics: crba wants every subtree's joints in a row, and a robot's
        # are not.
        rest, unit = np.zeros(self.dof), np.eye(self.dof)
        weight = pin.rnea(self.model, self.data, self.G @ x, self.G @ rest, self.G @ rest)
        columns = [
            pin.rnea(self.model, self.data, self.G @ x, self.G @ rest, self.G @ e) - weight
            for e in unit
        ]
        return self.G.T @ np.column_stack(columns)

    def energy(self, x: np.ndarray, dx: np.ndarray) -> tuple[float, float]:
        """Kinetic, and potential of gravity alone."""
        kinetic = pin.computeKineticEnergy(self.model, self.data, self.G @ x, self.G @ dx)
        return kinetic, pin.computePotentialEnergy(self.model, self.data, self.G @ x)

    def _springs(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        forces, n = np.zeros(self.dof), self.robot.n
        for i, joint in enumerate(self.robot.joints):
            t = joint.transmission
            if t is None:
                continue
            force = t.stiffness * (x[i] - x[n + i]) + t.damping * (dx[i] - dx[n + i])
            forces[i] += force
            forces[n + i] -= force
            if self.bearings:
                for k in (2 * n + i, 3 * n + i):
                    forces[k] += t.bearing.stiffness * x[k] + t.bearing.damping * dx[k]
        return forces
