"""mod_ad: the virtual prototype, dynamics by MuJoCo, motion imposed at the rotors, torques read at the HD output.

Rotors, wave generators and splines are driven, the bushings are free. The engine gives the mass matrix and the bias
forces of all bodies; couplers r_b and r_hd are exact because the driven bodies' velocities are written as G dtheta
with a constant G, and the engine's own numbers are projected on (theta, bushing):

    T = [G F],   T' M T (ddtheta, a_f) + T' (bias - passive) = (tau_m, 0).

With the motion imposed, ddtheta is known: the lower rows give the bushing's acceleration a_f (forward dynamics), the
upper rows the torque tau_m at the harmonic-drive output (inverse dynamics). With torques imposed it is all forward.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from elastic_arm.errors import SimulationError
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.mechanism import BUSHING, Bushing, build_spec, engine, transmissions
from elastic_arm.studies.paper.virtual_prototype.motions import ImposedMotion
from elastic_arm.studies.paper.virtual_prototype.rotations import link_coordinates

Torque = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
_Sample = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
RUNGE_KUTTA_REACH = 2.78  # of |eigenvalue| times step, on the real axis
DEFAULT_STEP = 1.0e-4
RECORD_RATE = 1000.0


@dataclass(frozen=True)
class PrototypeRun:
    """What the prototype did: samples first, joints second; angles at the harmonic-drive output, rad.

    `q` and `tilt` are the link's angles in the paper's order Ry(q_y) Rx(q_x) Rz(q) relative to the link before; `tilt`
    (3, N, 2n) holds [q_x, q_y], their rates and their accelerations.
    `tau_m` is the generalized force on theta, `tau_J` the torque of the drive's spring and damper, Nm.
    `tool` is the last link's frame origin in the world (N, 3), m.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    ddtheta: np.ndarray
    tilt: np.ndarray
    tau_m: np.ndarray
    tau_J: np.ndarray
    tool: np.ndarray

    def coordinates(self, bearings: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, dx, ddx for a model: [q, theta] (N, 2n), with bearings [q, theta, q_x, q_y] (N, 4n)."""
        q, theta = (self.q, self.dq, self.ddq), (self.theta, self.dtheta, self.ddtheta)
        parts = zip(q, theta, self.tilt, strict=True) if bearings else zip(q, theta, strict=True)
        x, dx, ddx = (np.hstack(part) for part in parts)
        return x, dx, ddx

    def every(self, stride: int) -> PrototypeRun:
        """Return the run with one sample in `stride`."""
        thinned = {name: value[::stride] for name, value in self.__dict__.items() if name != "tilt"}
        return PrototypeRun(tilt=self.tilt[:, ::stride], **thinned)


@dataclass
class _Reduced:
    """The engine's dynamics on (theta, bushing) at one state."""

    mass: np.ndarray
    force: np.ndarray


class Prototype:
    """The virtual prototype of an elastic robot.

    Parameters
    ----------
    robot
        Every joint with a transmission and a bearing.
    bushing
        The bushing's numbers that the arm file does not hold.

    Raises
    ------
    RobotError
        When the robot lacks a transmission or a bearing.
    MissingExtraError
        When the engine is not installed.
    """

    def __init__(self, robot: Robot, bushing: Bushing | None = None) -> None:
        self.bushing = bushing or Bushing()
        self.robot = robot
        self.n = len(robot.joints)
        self._mj = engine()
        self._model = build_spec(robot, self.bushing).compile()
        self._data = self._mj.MjData(self._model)
        self._index()
        self._full = np.zeros((self._model.nv, self._model.nv))
        # Views of the engine's own arrays: to ask for them anew takes as long as a small product.
        self._qpos, self._qvel = self._data.qpos, self._data.qvel
        self._bias, self._passive = self._data.qfrc_bias, self._data.qfrc_passive

    def _index(self) -> None:
        """Build the constant velocity map T = [G F] of the module's docstring."""
        drives = transmissions(self.robot)
        self._drive = np.array([(drive.stiffness, drive.damping) for drive in drives])
        free = BUSHING[-1:] if self.bushing.locked else BUSHING
        self.T = np.zeros((self._model.nv, self.n + len(free) * self.n))
        for i, (name, drive) in enumerate(zip(self.robot.joint_names, drives, strict=True)):
            for part, (_, ratio) in drive.components.items():
                self.T[self._address(f"{name}.{part}"), i] = ratio
            for k, axis in enumerate(free):
                self.T[self._address(f"{name}.{axis}"), self.n + len(free) * i + k] = 1.0
        self._Tt = np.ascontiguousarray(self.T.T)
        self._driven, self._free = np.ascontiguousarray(self.T[:, : self.n]), self.T[:, self.n :].argmax(axis=0)
        self._among_free = (self._free[:, None] * self._model.nv + self._free).ravel()  # places in the flat mass matrix
        self._delta = self.n + np.arange(self.n) * len(free) + len(free) - 1  # the drive's deflection of each joint

    def _address(self, joint: str) -> int:
        return int(self._model.joint(joint).dofadr[0])

    def reduced(self, y: np.ndarray, dy: np.ndarray) -> _Reduced:
        """Return the engine's mass matrix and bias minus passive forces on y = (theta, bushing)."""
        force = self._evaluate(self.T @ y, self.T @ dy)
        return _Reduced(self._Tt @ self._full @ self.T, self._Tt @ force)

    def _evaluate(self, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Let the engine fill its full mass matrix; return its bias minus passive forces (nv,)."""
        data, model, mj = self._data, self._model, self._mj
        self._qpos[:] = position
        self._qvel[:] = velocity
        mj.mj_fwdPosition(model, data)
        mj.mj_fwdVelocity(model, data)
        mj.mj_fullM(model, data, self._full)
        force: np.ndarray = self._bias - self._passive
        return force

    def equilibrium(self, theta: np.ndarray) -> np.ndarray:
        """Return the bushing's deflections (6 n,) in which the arm stands still at theta (n,).

        Newton's iteration with the springs' stiffness alone; gravity's own stiffness is smaller by 1e3 and more, and
        the iteration shrinks the error by that factor each time.
        """
        n = self.n
        y, rest = np.concatenate([theta, np.zeros(self.T.shape[1] - n)]), np.zeros(self.T.shape[1])
        stiffness = self._model.jnt_stiffness @ self.T[:, n:]
        for _ in range(20):
            change = -self.reduced(y, rest).force[n:] / stiffness
            y[n:] += change
            if np.abs(change).max() < 1e-15:
                break
        return y[n:]

    def stable_step(self) -> float:
        """Return the largest step that the integration of the bushings bears, with a tenth to spare, s.

        From the eigenvalues of the springs and dampers against the engine's mass matrix at the zero pose.
        """
        n, size = self.n, self.T.shape[1] - self.n
        rest = np.zeros(self.T.shape[1])
        inverse = np.linalg.inv(self.reduced(rest, rest).mass[n:, n:])
        stiffness, damping = (values @ self.T[:, n:] for values in (self._model.jnt_stiffness, self._model.dof_damping))
        system = np.block([[np.zeros((size, size)), np.eye(size)], [-inverse * stiffness, -inverse * damping]])
        return 0.9 * RUNGE_KUTTA_REACH / float(np.abs(np.linalg.eigvals(system)).max())

    def tool(self, q: np.ndarray) -> np.ndarray:
        """Return where the tool would be with rigid joints at q (N, n): (N, 3) in the world, m."""
        data, y = self._data, np.zeros(self.T.shape[1])
        places = np.empty((len(q), 3))
        for k, angles in enumerate(q):
            y[: self.n] = angles
            data.qpos[:] = self.T @ y
            self._mj.mj_kinematics(self._model, data)
            places[k] = data.site_xpos[0]
        return places

    def follow(self, motion: ImposedMotion, *, step: float = DEFAULT_STEP, rate: float = RECORD_RATE) -> PrototypeRun:
        """Impose a motion on the rotors (through the couplers) and record what the arm does.

        Parameters
        ----------
        motion
            theta, dtheta, ddtheta over time, in smooth pieces; recorded from t = 0 on. Where the acceleration jumps
            between two pieces, the sample is the limit from before.
        step
            Largest step of the fourth-order Runge-Kutta integration of the bushings, s.
        rate
            Samples per second.

        Raises
        ------
        SimulationError
            When the bushing's motion leaves the finite numbers (a step too large for its stiffness).
        """
        u = self.equilibrium(motion.pieces[0].evaluate(np.array([motion.pieces[0].start]))[0][0])
        du, samples = np.zeros_like(u), []
        for piece in motion.pieces:
            steps, stride, h = _division(piece.end - piece.start, step, rate)
            times = piece.start + 0.5 * h * np.arange(2 * steps + 1)
            imposed = list(zip(*piece.evaluate(times), strict=True))
            if piece is motion.pieces[0] and piece.start >= 0.0:
                samples.append(self._sample(piece.start, imposed[0], u, du))
            for k in range(steps):
                respond = _Imposed(self, imposed[2 * k : 2 * k + 3])
                u, du = runge_kutta(respond, u, du, respond(0, u, du), h)
                if (k + 1) % stride == 0 and piece.start + (k + 1) * h > -0.5 * h:
                    samples.append(self._sample(times[2 * k + 2], imposed[2 * k + 2], u, du))
            self._refuse_unless_finite(u, h)
        return self._gather(samples)

    def actuate(
        self,
        torque: Torque,
        start: tuple[np.ndarray, np.ndarray],
        duration: float,
        *,
        step: float = DEFAULT_STEP,
        rate: float = RECORD_RATE,
    ) -> PrototypeRun:
        """Apply torques at the harmonic-drive output (through the couplers) and record what the arm does.

        Parameters
        ----------
        torque
            Called with the number of half steps (of :func:`dividing_step`) since the start, theta and dtheta (n,);
            returns tau_m (n,), Nm.
        start
            theta and dtheta at t = 0; the bushings begin in static equilibrium, turning along.
        """
        n = self.n
        y = np.concatenate([start[0], self.equilibrium(start[0])])
        dy, samples = np.concatenate([start[1], np.zeros(len(y) - n)]), []
        steps, stride, h = _division(duration, step, rate)
        for k in range(steps + 1):

            def respond(half: int, y: np.ndarray, dy: np.ndarray, k: int = k) -> np.ndarray:
                at = self.reduced(y, dy)
                force = -at.force
                force[:n] += torque(2 * k + half, y[:n], dy[:n])
                return _solve(at.mass, force)

            ddy = respond(0, y, dy)
            if k % stride == 0:
                tau_m = torque(2 * k, y[:n], dy[:n])
                samples.append((k * h, y, dy, ddy, tau_m, self._data.site_xpos[0].copy()))
            if k < steps:
                y, dy = runge_kutta(respond, y, dy, ddy, h)
        self._refuse_unless_finite(y, h)
        return self._gather(samples)

    def respond(self, imposed: tuple[np.ndarray, ...], u: np.ndarray, du: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the bushing's acceleration and the motor torque tau_m under imposed theta, dtheta, ddtheta.

        Parameters
        ----------
        imposed
            theta, dtheta, ddtheta (n,).
        u, du
            Deflections of the bushing and their rates.
        """
        ddu, force = self._bushing_acceleration(imposed, u, du)
        torque = force + self._full @ self._placed(imposed[2], ddu)
        return ddu, self._driven.T @ torque

    def _bushing_acceleration(
        self, imposed: tuple[np.ndarray, ...], u: np.ndarray, du: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the bushing's acceleration, and the engine's bias minus passive forces (nv,).

        The rows of the bushing alone are solved: its deflections are coordinates of the engine, so that their part of
        T' M T is a part of M.
        """
        theta, dtheta, ddtheta = imposed
        force = self._evaluate(self._placed(theta, u), self._placed(dtheta, du))
        imposed_force = force + self._full @ (self._driven @ ddtheta)
        mass = self._full.take(self._among_free).reshape(len(u), len(u))
        return _solve(mass, -imposed_force[self._free]), force

    def _placed(self, theta: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return T (theta, u), the engine's coordinates (nv,)."""
        full: np.ndarray = self._driven @ theta
        full[self._free] = u
        return full

    def acceleration(self, imposed: tuple[np.ndarray, ...], u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Return the bushing's acceleration alone.

        Parameters
        ----------
        imposed, u, du
            See :meth:`respond`.
        """
        return self._bushing_acceleration(imposed, u, du)[0]

    def _sample(self, t: float, imposed: tuple[np.ndarray, ...], u: np.ndarray, du: np.ndarray) -> _Sample:
        ddu, tau_m = self.respond(imposed, u, du)
        y, dy, ddy = (np.concatenate(pair) for pair in zip(imposed, (u, du, ddu), strict=True))
        return t, y, dy, ddy, tau_m, self._data.site_xpos[0].copy()

    def _refuse_unless_finite(self, state: np.ndarray, step: float) -> None:
        if not np.isfinite(state).all():
            raise SimulationError(
                f"the virtual prototype left the finite numbers at a step of {step:g} s",
                "Choose a smaller step, a softer bushing or smaller torques",
            )

    def _gather(self, samples: list[_Sample]) -> PrototypeRun:
        """Turn the engine's coordinates into the paper's."""
        t, y, dy, ddy, tau_m, tool = (np.array(column) for column in zip(*samples, strict=True))
        full = [part @ self.T.T for part in (y, dy, ddy)]
        links = []
        for joint in self.robot.joints:
            spline = self._address(f"{joint.name}.spline")
            hinges = [self._address(f"{joint.name}.{axis}") for axis in BUSHING[3:]]
            links.append(link_coordinates([part[:, spline] for part in full], [part[:, hinges] for part in full]))
        angles = np.array(links)  # joint, derivative, sample, (q_y, q_x, q)
        q_y, q_x, q = (np.moveaxis(angles[..., k], 0, 2) for k in range(3))
        theta = [part[:, : self.n] for part in (y, dy, ddy)]
        tilt = np.concatenate([q_x, q_y], axis=2)
        tau_J = -y[:, self._delta] * self._drive[:, 0] - dy[:, self._delta] * self._drive[:, 1]
        return PrototypeRun(t, q[0], q[1], q[2], theta[0], theta[1], theta[2], tilt, tau_m, tau_J, tool)


class _Imposed:
    """The bushing's acceleration over one step, given the imposed motion at its start, middle and end."""

    def __init__(self, prototype: Prototype, imposed: Sequence[tuple[np.ndarray, ...]]) -> None:
        self._prototype, self._imposed = prototype, imposed

    def __call__(self, half: int, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        return self._prototype.acceleration(self._imposed[half], u, du)


def runge_kutta(
    acceleration: Callable[[int, np.ndarray, np.ndarray], np.ndarray],
    u: np.ndarray,
    du: np.ndarray,
    ddu: np.ndarray,
    h: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Take one classical fourth-order step of u'' = acceleration(half step 0, 1 or 2, u, u'); `ddu` is the first.

    Parameters
    ----------
    acceleration
        (half step 0, 1 or 2, u, u') -> u''.
    u, du
        State at the beginning of the step.
    ddu
        Acceleration there.
    h
        Step, s.
    """
    v2 = du + 0.5 * h * ddu
    a2 = acceleration(1, u + 0.5 * h * du, v2)
    v3 = du + 0.5 * h * a2
    a3 = acceleration(1, u + 0.5 * h * v2, v3)
    v4 = du + h * a3
    a4 = acceleration(2, u + h * v3, v4)
    return u + h / 6.0 * (du + 2.0 * v2 + 2.0 * v3 + v4), du + h / 6.0 * (ddu + 2.0 * a2 + 2.0 * a3 + a4)


def _solve(mass: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Solve with a symmetric positive definite matrix; LAPACK itself, as this is most of a small step's overhead."""
    solution: np.ndarray = dposv(mass, force)[1]
    return solution


def dividing_step(step: float, rate: float = RECORD_RATE) -> float:
    """Return the largest step, at most `step`, of which a whole number makes one sample, s."""
    return 1.0 / (rate * max(1, int(np.ceil(1.0 / (rate * step) - 1e-9))))


def _division(duration: float, step: float, rate: float) -> tuple[int, int, float]:
    """Return the number of steps, steps a sample, and the step, no larger than requested and dividing the samples."""
    stride = round(1.0 / (rate * dividing_step(step, rate)))
    steps = stride * round(duration * rate)
    return steps, stride, duration / steps
