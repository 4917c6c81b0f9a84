"""mod_ad: the virtual prototype, with dynamics by MuJoCo, imposed motion of the rotors, and torques
at the output of the harmonic drive.

Rotors, wave generators and splines are driven, and the bushings are free. The engine provides the
mass matrix and the bias forces of all bodies. The couplers r_b and r_hd are exact, because the
velocities of the driven bodies are G dtheta with a constant G, and the engine's numbers are
projected on (theta, bushing):

    T = [G F],   T' M T (ddtheta, a_f) + T' (bias - passive) = (tau_m, 0).

With an imposed motion, ddtheta is known: the lower rows give the acceleration a_f of the bushing
(forward dynamics), and the upper rows the torque tau_m at the output of the harmonic drive (inverse
dynamics). With imposed torques, all rows are forward dynamics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from elastic_arm.arrays import Array
from elastic_arm.errors import SimulationError
from elastic_arm.robot.description import Robot
from elastic_arm.studies.paper.virtual_prototype.mechanism import (
    BUSHING,
    Bushing,
    build_spec,
    engine,
    transmissions,
)
from elastic_arm.studies.paper.virtual_prototype.motions import ImposedMotion, SmoothPiece
from elastic_arm.studies.paper.virtual_prototype.rotations import link_coordinates

Torque = Callable[[int, Array, Array], Array]
_Sample = tuple[float, Array, Array, Array, Array, Array]
DEFAULT_STEP = 1.0e-4
RUNGE_KUTTA_REACH = 2.78  # of |eigenvalue| times step, on the real axis
RECORD_RATE = 1000.0


@dataclass(frozen=True)
class PrototypeRun:
    """What the prototype did.

    Samples first, joints second; angles at the harmonic-drive output, rad.

    `q` and `tilt` are the link's angles in the paper's order Ry(q_y) Rx(q_x) Rz(q) relative to the
    link before; `tilt` (3, N, 2n) holds [q_x, q_y], their rates and their accelerations. `tau_m` is
    the generalized force on theta, `tau_J` the torque of the drive's spring and damper, Nm. `tool`
    is the last link's frame origin in the world (N, 3), m.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    theta: Array
    dtheta: Array
    ddtheta: Array
    tilt: Array
    tau_m: Array
    tau_J: Array
    tool: Array

    def coordinates(self, bearings: bool = False) -> tuple[Array, Array, Array]:
        """Return x, dx, ddx for a model: [q, theta] (N, 2n).

        With bearings [q, theta, q_x, q_y] (N, 4n).
        """
        q = (self.q, self.dq, self.ddq)
        theta = (self.theta, self.dtheta, self.ddtheta)
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

    mass: Array
    force: Array


class Prototype:
    """The virtual prototype of an elastic robot."""

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
        self._qpos = self._data.qpos
        self._qvel = self._data.qvel
        self._bias = self._data.qfrc_bias
        self._passive = self._data.qfrc_passive

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
        self._driven = np.ascontiguousarray(self.T[:, : self.n])
        self._free = self.T[:, self.n :].argmax(axis=0)
        # places in the flat mass matrix
        self._among_free = self._free[:, None] * self._model.nv + self._free
        # the drive's deflection of each joint
        self._delta = self.n + np.arange(self.n) * len(free) + len(free) - 1

    def _address(self, joint: str) -> int:
        return int(self._model.joint(joint).dofadr[0])

    def reduced(self, y: Array, dy: Array) -> _Reduced:
        """Return the engine's mass matrix and bias minus passive forces on y = (theta, bushing)."""
        n = self.n
        driven = self._driven
        force = self._evaluate(driven.dot(y[:n]), driven.dot(dy[:n]), y[n:], dy[n:])
        return _Reduced(self._Tt.dot(self._full).dot(self.T), self._Tt.dot(force))

    def _evaluate(self, position: Array, velocity: Array, u: Array, du: Array) -> Array:
        """Let the engine fill its full mass matrix; return its bias minus passive forces (nv,)."""
        data = self._data
        model = self._model
        mj = self._mj
        qpos = self._qpos
        qvel = self._qvel
        qpos[:] = position
        qpos[self._free] = u
        qvel[:] = velocity
        qvel[self._free] = du
        # The parts of mj_fwdPosition that a model without constraints and sensors needs.
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_crb(model, data)
        mj.mj_fwdVelocity(model, data)
        mj.mj_fullM(model, data, self._full)
        return self._bias - self._passive

    def equilibrium(self, theta: Array) -> Array:
        """Return the bushing's deflections (6 n,) in which the arm stands still at theta (n,).

        Newton's iteration with the springs' stiffness alone; gravity's own stiffness is smaller by
        1e3 and more, and the iteration shrinks the error by that factor each time.
        """
        n = self.n
        y = np.concatenate([theta, np.zeros(self.T.shape[1] - n)])
        rest = np.zeros(self.T.shape[1])
        stiffness = self._model.jnt_stiffness @ self.T[:, n:]
        for _ in range(20):
            change = -self.reduced(y, rest).force[n:] / stiffness
            y[n:] += change
            if np.abs(change).max() < 1e-15:
                break
        return y[n:]

    def stable_step(self) -> float:
        """Return the largest step, s, that the integration of the bushings bears.

        With a tenth to spare.

        From the eigenvalues of the springs and dampers against the engine's mass matrix at the zero
        pose.
        """
        n = self.n
        size = self.T.shape[1] - self.n
        rest = np.zeros(self.T.shape[1])
        inverse = np.linalg.inv(self.reduced(rest, rest).mass[n:, n:])
        stiffness = self._model.jnt_stiffness @ self.T[:, n:]
        damping = self._model.dof_damping @ self.T[:, n:]
        system = np.block(
            [[np.zeros((size, size)), np.eye(size)], [-inverse * stiffness, -inverse * damping]]
        )
        return 0.9 * RUNGE_KUTTA_REACH / float(np.abs(np.linalg.eigvals(system)).max())

    def tool(self, q: Array) -> Array:
        """Return where the tool would be with rigid joints at q (N, n): (N, 3) in the world, m."""
        data = self._data
        y = np.zeros(self.T.shape[1])
        places = np.empty((len(q), 3))
        for k, angles in enumerate(q):
            y[: self.n] = angles
            data.qpos[:] = self.T @ y
            self._mj.mj_kinematics(self._model, data)
            places[k] = data.site_xpos[0]
        return places

    def follow(
        self, motion: ImposedMotion, *, step: float = DEFAULT_STEP, rate: float = RECORD_RATE
    ) -> PrototypeRun:
        """Impose a motion on the rotors (through the couplers) and record what the arm does."""
        first = motion.pieces[0]
        u = self.equilibrium(first.evaluate(np.array([first.start]))[0][0])
        state = np.array([u, np.zeros_like(u)])
        samples: list[_Sample] = []
        for piece in motion.pieces:
            steps, stride, h = division(piece.end - piece.start, step, rate)
            # where a piece begins, the one before has ended
            begin = 0 if piece is first else stride
            kept = {k for k in range(begin, steps + 1, stride) if piece.start + k * h > -0.5 * h}
            state = self._follow_piece(piece, state, (steps, h), kept, samples)
            self._refuse_unless_finite(state, h)
        return self._gather(samples)

    def _follow_piece(
        self,
        piece: SmoothPiece,
        state: Array,
        division: tuple[int, float],
        kept: set[int],
        samples: list[_Sample],
    ) -> Array:
        """Integrate the bushings over one smooth piece.

        Returns the state at the piece's end (2, 6 n).
        """
        steps, h = division
        times = piece.start + 0.5 * h * np.arange(2 * steps + 1, dtype=float)
        imposed = piece.evaluate(times)
        driven = list(zip(*(part.dot(self._driven.T) for part in imposed), strict=True))

        def accelerate(half: int, state: Array) -> Array:
            return self._bushing_acceleration(driven[half], state)[0]

        for k in range(steps + 1):
            ddu, force = self._bushing_acceleration(driven[2 * k], state)
            if k in kept:
                y, dy, ddy = (
                    np.concatenate([part[2 * k], own])
                    for part, own in zip(imposed, (*state, ddu), strict=True)
                )
                accelerations = driven[2 * k][2].copy()
                accelerations[self._free] = ddu
                tau_m = self._driven.T.dot(force + self._full.dot(accelerations))
                samples.append((times[2 * k], y, dy, ddy, tau_m, self._data.site_xpos[0].copy()))
            if k < steps:
                state = runge_kutta(accelerate, 2 * k, state, ddu, h)
        return state

    def actuate(
        self,
        torque: Torque,
        start: tuple[Array, Array],
        duration: float,
        *,
        step: float = DEFAULT_STEP,
    ) -> PrototypeRun:
        """Apply torques at the harmonic-drive output, through the couplers; record the motion."""
        n = self.n
        state = np.zeros((2, self.T.shape[1]))
        samples = []
        state[:, :n] = start
        state[0, n:] = self.equilibrium(start[0])
        steps, stride, h = division(duration, step, RECORD_RATE)

        def accelerate(half: int, state: Array) -> Array:
            at = self.reduced(*state)
            force = -at.force
            force[:n] += torque(half, *state[:, :n])
            return solve(at.mass, force)

        for k in range(steps + 1):
            ddy = accelerate(2 * k, state)
            if k % stride == 0:
                tau_m = torque(2 * k, *state[:, :n])
                samples.append((k * h, *state, ddy, tau_m, self._data.site_xpos[0].copy()))
            if k < steps:
                state = runge_kutta(accelerate, 2 * k, state, ddy, h)
        self._refuse_unless_finite(state, h)
        return self._gather(samples)

    def _bushing_acceleration(self, driven: tuple[Array, ...], state: Array) -> tuple[Array, Array]:
        """Return the bushing's acceleration, and the engine's bias minus passive forces (nv,).

        The rows of the bushing alone are solved: its deflections are coordinates of the engine, so
        that their part of T' M T is a part of M.
        """
        u, du = state
        force = self._evaluate(driven[0], driven[1], u, du)
        imposed_force = force + self._full.dot(driven[2])
        mass = self._full.take(self._among_free)
        return solve(mass, -imposed_force[self._free]), force

    def _refuse_unless_finite(self, state: Array, step: float) -> None:
        if not np.isfinite(state).all():
            raise SimulationError(
                f"the simulation of the virtual prototype diverged at a step of {step:g} s",
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
            links.append(
                link_coordinates(
                    [part[:, spline] for part in full], [part[:, hinges] for part in full]
                )
            )
        angles = np.array(links)  # joint, derivative, sample, (q_y, q_x, q)
        q_y = np.moveaxis(angles[..., 0], 0, 2)
        q_x = np.moveaxis(angles[..., 1], 0, 2)
        q = np.moveaxis(angles[..., 2], 0, 2)
        theta = [part[:, : self.n] for part in (y, dy, ddy)]
        tilt = np.concatenate([q_x, q_y], axis=2)
        tau_J = -y[:, self._delta] * self._drive[:, 0] - dy[:, self._delta] * self._drive[:, 1]
        return PrototypeRun(
            t, q[0], q[1], q[2], theta[0], theta[1], theta[2], tilt, tau_m, tau_J, tool
        )


def runge_kutta(
    acceleration: Callable[[int, Array], Array],
    half: int,
    state: Array,
    first: Array,
    h: float,
) -> Array:
    """Take one classical fourth-order step of u'' = acceleration(number of the half step, (u, u')).

    Returns u and u' at the end of the step (2, m).
    """
    # Position and velocity are advanced together: a step costs as much in calls of NumPy as in
    # arithmetic.
    rates = np.empty((4, *state.shape))
    one, two, three, four = rates
    one[0] = state[1]
    one[1] = first
    for k, (rate, known, reach) in enumerate(
        ((two, one, 0.5 * h), (three, two, 0.5 * h), (four, three, h))
    ):
        at = reach * known
        at += state
        rate[0] = at[1]
        rate[1] = acceleration(half + 1 + k // 2, at)
    rates[1:3] *= 2.0
    change = one + two
    change += three
    change += four
    change *= h / 6.0
    change += state
    return change


def solve(mass: Array, force: Array) -> Array:
    """Solve with a symmetric positive definite matrix.

    By LAPACK itself, as this is most of a small step's overhead.
    """
    return dposv(mass, force)[1]


def dividing_step(step: float, rate: float = RECORD_RATE) -> float:
    """Return the largest step, at most `step`, of which a whole number makes one sample, s."""
    return 1.0 / (rate * max(1, int(np.ceil(1.0 / (rate * step) - 1e-9))))


def division(duration: float, step: float, rate: float) -> tuple[int, int, float]:
    """Divide a time into steps of which a whole number makes one sample.

    Returns the number of steps, steps a sample, and the step, s.
    """
    stride = round(1.0 / (rate * dividing_step(step, rate)))
    steps = stride * round(duration * rate)
    return steps, stride, duration / steps
