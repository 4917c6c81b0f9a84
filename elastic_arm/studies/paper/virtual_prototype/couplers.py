"""The same prototype with soft couplers: the engine's own constraints and integrator, to show where they converge.

Each coupler is an equality constraint between two hinges, each rotor follows its imposed angle by a stiff servo. As
both grow stiff, motor torque and link motion must approach those of the exact couplers in :mod:`.prototype`.
"""

from __future__ import annotations

import numpy as np

from elastic_arm.errors import SimulationError
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.mechanism import Bushing, build_spec, engine, transmissions
from elastic_arm.studies.paper.virtual_prototype.motions import ImposedMotion
from elastic_arm.studies.paper.virtual_prototype.prototype import Prototype


class SoftCouplers:
    """The prototype on MuJoCo's equality constraints."""

    def __init__(self, robot: Robot, frequency: float, bushing: Bushing | None = None) -> None:
        bushing = bushing or Bushing()
        self._exact = Prototype(robot, bushing)
        self._mj = engine()
        self._frequency = frequency
        spec = build_spec(robot, bushing)
        for joint, drive in zip(robot.joints, transmissions(robot), strict=True):
            self._couple(spec, f"{joint.name}.wave_generator", f"{joint.name}.rotor", drive.belt_ratio)
            self._couple(spec, f"{joint.name}.spline", f"{joint.name}.wave_generator", drive.harmonic_drive_ratio)
        spec.option.integrator = self._mj.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.iterations = 50
        spec.option.tolerance = 1e-15
        self._model = spec.compile()
        self._rotors = [int(self._model.joint(f"{name}.rotor").dofadr[0]) for name in robot.joint_names]
        self._ratios = np.array([drive.r_tot for drive in transmissions(robot)])

    def _couple(self, spec: object, driven: str, driver: str, ratio: float) -> None:
        """Add the constraint driven = driver / ratio."""
        mj = self._mj
        equality = spec.add_equality(type=mj.mjtEq.mjEQ_JOINT, name1=driven, name2=driver)  # type: ignore[attr-defined]
        equality.objtype = mj.mjtObj.mjOBJ_JOINT
        equality.data[:5] = [0.0, 1.0 / ratio, 0.0, 0.0, 0.0]
        equality.solref = [-(self._frequency**2), -2.0 * self._frequency]
        equality.solimp = [0.9999, 0.9999, 0.001, 0.5, 2.0]  # the engine's ceiling: all but rigid

    def follow(self, motion: ImposedMotion, *, step: float, rate: float = 1000.0) -> tuple[np.ndarray, np.ndarray]:
        """Servo the rotors along a motion; return tau_m and theta (N, n) as `rate` samples per second."""
        mj, model, exact = self._mj, self._model, self._exact
        model.opt.timestep = step
        data = mj.MjData(model)
        first = motion.pieces[0]
        start = first.evaluate(np.array([first.start]))[0][0]
        y = np.concatenate([start, exact.equilibrium(start)])
        holding = exact.reduced(y, np.zeros_like(y))
        data.qpos[:] = exact.T @ y
        inertia = np.diag(holding.mass)[: exact.n] / self._ratios**2
        rest = holding.force[: exact.n] / self._ratios
        stiffness, damping = inertia * self._frequency**2, 2.0 * inertia * self._frequency
        stride = round(1.0 / (rate * step))
        torques, angles = [], []
        for piece in motion.pieces:
            steps = round((piece.end - piece.start) / step)
            theta, dtheta, ddtheta = (
                part * self._ratios for part in piece.evaluate(piece.start + step * np.arange(steps))
            )
            for k in range(steps):
                lag, slip = theta[k] - data.qpos[self._rotors], dtheta[k] - data.qvel[self._rotors]
                effort = rest + inertia * ddtheta[k] + stiffness * lag + damping * slip
                if piece.start >= 0.0 and k % stride == 0:
                    torques.append(effort * self._ratios)
                    angles.append(data.qpos[self._rotors] / self._ratios)
                data.qfrc_applied[self._rotors] = effort
                mj.mj_step(model, data)
        if not np.isfinite(data.qpos).all():
            raise SimulationError(
                f"the soft couplers left the finite numbers at a step of {step:g} s", "Choose a smaller step"
            )
        return np.array(torques), np.array(angles)
