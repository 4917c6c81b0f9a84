"""Many short predictions at once: angles from measured states and motor torques.

The arm starts in the measured state at many instants and is driven by the measured motor torque.
All starts are integrated in one call per step, with the equations and the scheme of the simulator,
or with a linearly implicit scheme if a light link with strong friction makes them too stiff.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array, Indices
from elastic_arm.codegen import kernels
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.simulation.assembly import System, assemble
from elastic_arm.simulation.integrator import runge_kutta_step
from elastic_arm.simulation.simulator import sign_speed

LONGEST_STEP = 1e-3  # s
FIXED_POINT_STEPS = 12
GAMMA = 1.0 - np.sqrt(0.5)  # of the scheme ROS2, which is L-stable with it


class MeasuredMotion(Protocol):
    """A measured motion at times (N,) s.

    (N, n) angles, rates, accelerations of both sides, and torques, Nm.

    `span` is begin and end of its recording on the axis of the times.
    """

    @property
    def t(self) -> Array: ...
    @property
    def q(self) -> Array: ...
    @property
    def dq(self) -> Array: ...
    @property
    def ddq(self) -> Array: ...
    @property
    def theta(self) -> Array: ...
    @property
    def dtheta(self) -> Array: ...
    @property
    def ddtheta(self) -> Array: ...
    @property
    def tau_J(self) -> Array: ...
    @property
    def tau_m(self) -> Array: ...
    @property
    def span(self) -> tuple[float, float] | None: ...


class BatchPrediction:
    """An arm that can be put into many measured states at once and driven from there."""

    def __init__(
        self,
        equations: ArmEquations,
        laws: Sequence[EffectInstance],
        Psi: Array,
        stiffness: Array,
        period: float,
        duration: float | None = None,
    ) -> None:
        self._equations = equations
        self._Psi = Psi
        self._K = stiffness
        self._period = period
        self._system: System = assemble(equations, laws, duration)
        self._substeps = 1
        # Interpreted, the accelerations of all starts at all steps take longer than compiling them.
        self._accelerations = kernels.compile(self._system.accelerations, shared=("constants",))
        self._jacobian: ca.Function | None = None
        self._constants = np.zeros(0)

    def angles(
        self, motion: MeasuredMotion, begins: Indices, steps: Sequence[int]
    ) -> tuple[Array, Array]:
        """Predict the angles some samples after each start."""
        n = self._system.n
        y = self._start(motion, begins)
        torque = 0.5 * (motion.tau_m[:-1] + motion.tau_m[1:])
        link = []
        motor = []
        for k in range(1, steps[-1] + 1):
            y = self._advance(y, torque[begins + k - 1])
            if k in steps:
                link.append(y[:, :n])
                motor.append(y[:, n : 2 * n] if self._system.dof > n else y[:, :n])
        return np.stack(link, axis=1), np.stack(motor, axis=1)

    def _start(self, motion: MeasuredMotion, begins: Indices) -> Array:
        """Return states (S, 2 dof + states): measured motors, links behind them by the measured
        joint torque."""
        x, dx = self._coordinates(motion)
        self._prepare(len(begins), x[begins[0]], motion.tau_m[begins[0]])
        y = np.hstack([values[begins] for values in (x, dx, self._internal_states(motion, x, dx))])
        if self._system.dof > self._system.n:
            # A fixed point, slow where true over nominal stiffness is near one.
            for _ in range(FIXED_POINT_STEPS):
                excess = self._evaluate(y, motion.tau_m[begins])[2] - motion.tau_J[begins]
                y[:, : self._system.n] += excess / self._K
        return y

    def _coordinates(self, motion: MeasuredMotion) -> tuple[Array, Array]:
        """Return x, dx (N, dof) along the motion; bearings tilt by the moments that the motion puts
        on them."""
        if not self._equations.robot.elastic:
            return motion.q, motion.dq
        pairs = ((motion.q, motion.theta), (motion.dq, motion.dtheta), (motion.ddq, motion.ddtheta))
        x, dx, ddx = (np.hstack(pair) for pair in pairs)
        tilts = self._system.dof - x.shape[1]
        if not tilts:
            return x, dx
        whole = build_model(self._equations.robot, self._equations.model_name, bearings=True)
        at = np.pad(x, ((0, 0), (0, tilts)))
        rate = np.pad(dx, ((0, 0), (0, tilts)))
        acceleration = np.pad(ddx, ((0, 0), (0, tilts)))
        bearings = [
            (s.coordinate, s.stiffness) for s in self._equations.bodies.springs if s.against is None
        ]
        stiffness = [index for _, index in sorted(bearings)]
        tilt = (
            -whole.inverse_dynamics(at, rate, acceleration, self._Psi)[:, -tilts:]
            / self._Psi[stiffness]
        )
        return np.hstack([x, tilt]), np.hstack([dx, CubicSpline(motion.t, tilt)(motion.t, 1)])

    def _internal_states(self, motion: MeasuredMotion, x: Array, dx: Array) -> Array:
        """Return internal states of effects (N, states) along the measured motion.

        They begin at zero, the time where the motion stands in its recording.
        """
        system = self._system
        if not system.states:
            return np.zeros((len(x), 0))
        given = [ca.SX.sym(f"given_{k}", *system.accelerations.size_in(k)) for k in (2, 0, 1, 3, 4)]
        z = given[0]
        rest = given[1:]
        rate = system.accelerations(rest[0], rest[1], z, *rest[2:])[1]
        course = ca.Function("step", given, [z + self._period * rate]).mapaccum(len(x) - 1)
        known = [values[:-1].T for values in (x, dx, motion.tau_m)]
        start = np.zeros(system.states)
        if system.effect_set.in_time and motion.span is not None:
            start[-1] = motion.t[0] - motion.span[0]
        z_later = course(start, *known, np.tile(self._constants[:, None], len(x) - 1))
        return np.vstack([start[None], np.array(z_later).T])

    def _prepare(self, starts: int, x: Array, torque: Array) -> None:
        """Choose the step, and with it the scheme, by the fastest vibration."""
        system = self._system
        z = np.zeros(self._system.states)
        fastest = self._fastest(x, z, torque)
        # The fastest eigenvalue times the step is 1.0; Runge-Kutta is stable up to 2.8.
        step = min(LONGEST_STEP, 1.0 / fastest) if fastest > 0.0 else LONGEST_STEP
        self._substeps = int(np.ceil(self._period / step - 1e-9))
        self._jacobian = None
        # 32 a sample; where more were needed, the implicit scheme takes over
        if self._substeps > 32:
            self._substeps = int(np.ceil(self._period / LONGEST_STEP - 1e-9))
            self._jacobian = self._state_jacobian().map(starts)
        speed = sign_speed(system, self._Psi, x, z, torque, self._period / self._substeps)
        self._constants = np.array(
            system.constants(self._Psi, system.effect_set.numbers(), speed)
        ).ravel()

    def _fastest(self, x: Array, z: Array, torque: Array) -> float:
        """Return the largest eigenvalue, 1/s, of the arm at rest, dry friction aside (its slope
        follows the step)."""
        system = self._system
        never = np.full(2 * system.n, np.inf)
        constants = system.constants(self._Psi, system.effect_set.numbers(), never)
        state = np.concatenate([x, np.zeros_like(x), z])
        slope = np.array(self._state_jacobian()(state, torque, constants))
        return float(np.abs(np.linalg.eigvals(slope)).max())

    def _state_jacobian(self) -> ca.Function:
        """Return the derivative of the state's rate with respect to the state: (y, torque,
        constants) -> (m, m)."""
        system = self._system
        x, dx, z, torque, constants = (
            ca.SX.sym(f"given_{k}", *system.accelerations.size_in(k)) for k in range(5)
        )
        ddx, dz, _ = system.accelerations(x, dx, z, torque, constants)
        state = ca.vertcat(x, dx, z)
        return ca.Function(
            "jacobian", [state, torque, constants], [ca.jacobian(ca.vertcat(dx, ddx, dz), state)]
        )

    def _evaluate(self, y: Array, torque: Array) -> tuple[Array, Array, Array]:
        """Return accelerations, rates of internal states, and joint torques, starts first."""
        dof = self._system.dof
        ddx, dz, tau_J = self._accelerations(
            y[:, :dof], y[:, dof : 2 * dof], y[:, 2 * dof :], torque, self._constants
        )
        return ddx, dz, tau_J

    def _advance(self, y: Array, torque: Array) -> Array:
        """Return the states (S, …) a sample later."""
        dof = self._system.dof
        h = self._period / self._substeps

        def rate(at: Array) -> Array:
            ddx, dz, _ = self._evaluate(at, torque)
            return np.hstack([at[:, dof : 2 * dof], ddx, dz])

        for _ in range(self._substeps):
            y = (
                runge_kutta_step(rate, y, h)
                if self._jacobian is None
                else self._implicit_step(rate, y, torque, h)
            )
        return y

    def _implicit_step(
        self, rate: Callable[[Array], Array], y: Array, torque: Array, h: float
    ) -> Array:
        """Return the states a step later by ROS2 (Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci.
        Comput. 20, 1999)."""
        assert self._jacobian is not None
        m = y.shape[1]
        constants = np.tile(self._constants[:, None], len(y))
        jacobian = (
            np.array(self._jacobian(y.T, torque.T, constants)).reshape(m, len(y), m).swapaxes(0, 1)
        )
        implicit = np.eye(m) - GAMMA * h * jacobian
        k1 = np.linalg.solve(implicit, rate(y)[:, :, None])[:, :, 0]
        k2 = np.linalg.solve(implicit, (rate(y + h * k1) - 2.0 * k1)[:, :, None])[:, :, 0]
        return y + h * (1.5 * k1 + 0.5 * k2)
