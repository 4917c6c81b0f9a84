"""The controller on the motor side,

    tau_m = limit(kp (r(t - d) - theta) + kd (dr(t - d) - dtheta) + ki int(r - theta) +
    feed-forward),

held between commands. By default it is computed torque, otherwise the controller in the description
of the arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.derivations import cached_functions
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.errors import SimulationError
from elastic_arm.robot import Robot
from elastic_arm.simulation.assembly import SOURCES

Feedforward = Callable[[Array, Array, Array], Array]

BANDWIDTH = 3.0
DAMPING_RATIO = 0.8
# Where the motor bounds kd: how much of the bound is used, and how far kp may then go.
HELD_SHARE = 0.6
LEAST_DAMPING_RATIO = 0.2


def no_feedforward(q: Array, dq: Array, ddq: Array) -> Array:
    """Feed no torque forward, (N, n)."""
    return np.zeros_like(q)


@dataclass(frozen=True)
class Controller:
    """A controller that reads the motor side without noise."""

    # kp, kd, ki: (n,) Nm/rad, Nm s/rad, Nm/(rad s). The integral rests where the torque is at its
    # limit
    kp: Array
    kd: Array
    feedforward: Feedforward = no_feedforward  # reference q, dq, ddq (N, n) -> torque (N, n)
    ki: Array | float = 0.0
    # limit, delay: (n,) Nm, beside the joint's own limit, and s by which the reference comes late
    limit: Array | float = np.inf
    delay: Array | float = 0.0
    # (n,) 1 where the reference's rate is followed; 0 where it counts as zero, so that kd damps the
    # motor's own
    speed: Array | float = 1.0
    commands: int = 1  # a sample: 1, or an even number
    dead_band: Array | float = (
        0.0  # (n,) rad, of the error of theta: kp makes a torque of what exceeds it
    )

    def __post_init__(self) -> None:
        n = np.size(self.kp)
        for name in ("kp", "kd", "ki", "limit", "delay", "speed", "dead_band"):
            values = np.asarray(getattr(self, name), dtype=float)
            values = np.full(n, values) if values.ndim == 0 and name not in ("kp", "kd") else values
            if values.shape != (n,) or np.isnan(values).any() or (values < 0).any():
                raise SimulationError(
                    f"{name} of the controller is {getattr(self, name)!r}",
                    f"Give {n} numbers, zero or positive.",
                )
            object.__setattr__(self, name, values)
        if not np.isfinite(np.array([self.kp, self.kd, self.ki, self.delay])).all():
            raise SimulationError(
                "a gain or delay of the controller is infinite", "Give finite numbers."
            )
        if self.commands != 1 and (self.commands < 1 or self.commands % 2):
            raise SimulationError(
                f"{self.commands} commands per sample", "Give 1 or an even number."
            )

    def commanded(self, q: Array, dq: Array, ddq: Array, rate: float) -> Array:
        """Return what the drives are given over samples (N, n) at a rate (Hz).

        theta, dtheta, torque (N commands, 3n)

        Between samples the reference goes on with its acceleration: what comes next is not known to
        a live arm.
        """
        if self.commands == 1:
            return np.concatenate([q, self.speed * dq, self.feedforward(q, dq, ddq)], axis=1)
        later = np.arange(self.commands)[:, None] / (self.commands * rate)
        q = q[:, None]
        dq = dq[:, None]
        ddq = ddq[:, None]
        wanted = (q + later * (dq + 0.5 * later * ddq), dq + later * ddq, ddq + 0.0 * later)
        q, dq, ddq = (values.reshape(-1, values.shape[-1]) for values in wanted)
        return np.concatenate([q, self.speed * dq, self.feedforward(q, dq, ddq)], axis=1)


def controller_of(robot: Robot, *, model: str = "mod3", rate: float = 1000.0) -> Controller:
    """Return the controller that an arm's description states, else one that is tuned to it."""
    own = tuned(robot, model=model, rate=rate)
    if not any(joint.controller for joint in robot.joints):
        return own
    names = ("kp", "kd", "ki", "delay", "limit", "speed", "dead_band")
    values = {name: np.array(getattr(own, name)) for name in names}
    held = np.ones(robot.n)  # share of gravity that is fed forward
    moved = np.ones(robot.n)  # share of the rest that is fed forward
    for i, joint in enumerate(robot.joints):
        if (drive := joint.controller) is None:
            continue
        if drive.stall is not None:
            raise SimulationError(
                f"the duty of {joint.name} has a limit, which only MuJoCo simulates",
                "Write a new MJCF with `elastic-arm export`, or state the controller without stall",
            )
        kp, kd, ki = drive.gains
        limit = np.inf if drive.torque is None else drive.torque
        stated = (kp, kd, ki, drive.delay, limit, drive.follows_rate, drive.dead_band)
        for name, value in zip(names, stated, strict=True):
            values[name][i] = value
        held[i] = drive.feedforward != "none"
        moved[i] = drive.feedforward == "model"
    rigid = RigidFeedforward(ArmEquations(robot, model))

    def feedforward(q: Array, dq: Array, ddq: Array) -> Array:
        weight = rigid(q, 0.0 * q, 0.0 * q)
        return held * weight + moved * (rigid(q, dq, ddq) - weight)

    return Controller(
        feedforward=feedforward,
        commands=_commands(values["kp"], values["kd"], rigid, rate),
        **values,
    )


def tuned(robot: Robot, *, model: str = "mod3", rate: float = 1000.0) -> Controller:
    """Return a controller for a nominal arm, well damped at :data:`BANDWIDTH`.

    The model variant provides its feed-forward.

    The gains fit the inertia of each whole joint, link and motor, in the zero position; but the
    motor alone, on its drive's damper, must stay stable under a held command. Where the ratio is
    low and the motor light, that bounds both gains. At a low sample rate, Hz, the drives are
    commanded several times a sample, as real ones are.
    """
    equations = ArmEquations(robot, model)
    feedforward = RigidFeedforward(equations)
    inertia = np.diag(feedforward.inertia(np.zeros(robot.n))).copy()
    speed = 2 * np.pi * BANDWIDTH
    commands = _commands(speed**2 * inertia, 2 * DAMPING_RATIO * speed * inertia, feedforward, rate)
    held = HELD_SHARE * _largest_held_damping(equations, commands * rate)
    kd = np.minimum(2 * DAMPING_RATIO * speed * inertia, held)
    slowed = kd / (2 * LEAST_DAMPING_RATIO * inertia)
    return Controller(np.minimum(speed, slowed) ** 2 * inertia, kd, feedforward, commands=commands)


def _commands(kp: Array, kd: Array, rigid: RigidFeedforward, rate: float) -> int:
    """Return how many commands a sample it takes that none is held for longer than the loop's
    fastest time constant.

    The joints turn one another: a light wrist may follow a shoulder's gains much faster than its
    own. Poses are those of any arm, as the fastest eigenvalue varies by a small factor over them.
    """
    # 8 poses at which the inertia of an arm is looked at
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (8, len(kp)))
    fastest = max(
        fastest_eigenvalue(rigid.inertia(pose), np.diag(kp), np.diag(kd)) for pose in poses
    )
    needed = fastest / rate
    return 1 if needed <= 1.0 else 2 * int(np.ceil(0.5 * needed))


def fastest_eigenvalue(mass: Array, stiffness: Array, damping: Array) -> float:
    """Return the largest eigenvalue of M x'' + D x' + K x = 0, all (m, m), by size, 1/s."""
    eye = np.eye(len(mass))
    none = np.zeros_like(mass)
    below = np.linalg.solve(mass, np.hstack([-stiffness, -damping]))
    return float(np.abs(np.linalg.eigvals(np.vstack([np.hstack([none, eye]), below]))).max())


def _largest_held_damping(equations: ArmEquations, rate: float) -> Array:
    """Return the kd (n,) at which B dv/dt = -D v - kd v_k, v_k held for a sample, ceases to
    decay."""
    if not equations.robot.elastic:
        return np.full(equations.robot.n, np.inf)
    numbers = ca.Function("numbers", [equations.Psi], [equations.D, equations.B])
    D, B = (np.array(values).ravel() for values in numbers(equations.nominal))
    decay = D / (B * rate)
    # D (1 + a) / (1 - a) with a = exp(-decay), which without damping is 2 B rate.
    return (
        2.0
        * B
        * rate
        * np.where(decay > 1e-9, 0.5 * decay / np.tanh(0.5 * np.maximum(decay, 1e-9)), 1.0)
    )


class RigidFeedforward:
    """The torque that moves an arm along a reference as if its drives were rigid (q = theta).

    Evaluated sample by sample in one way, so that a run and its single steps agree to the bit.
    """

    def __init__(self, equations: ArmEquations) -> None:
        # The buffer points into the function and the arrays: they live as long as it does.
        self._function = _together(equations)
        self._arguments = [
            *(np.zeros(equations.robot.n) for _ in range(3)),
            equations.nominal.copy(),
        ]
        self._torque = np.zeros(equations.robot.n)
        self._buffer, self._evaluate = self._function.buffer()
        for k, array in enumerate(self._arguments):
            self._buffer.set_arg(k, memoryview(array))  # type: ignore[call-arg, arg-type]
        self._buffer.set_res(0, memoryview(self._torque))  # type: ignore[call-arg, arg-type]

    def __call__(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return torques (N, n) for a reference (N, n)."""
        out = np.empty_like(q)
        for k in range(len(q)):
            for slot, values in zip(self._arguments, (q, dq, ddq), strict=False):
                slot[:] = values[k]
            self._evaluate()
            out[k] = self._torque
        return out

    def inertia(self, q: Array) -> Array:
        """Return the mass matrix (n, n) at a pose (n,), link and motor side turning together."""
        n = len(self._torque)
        poses = np.tile(q, (n + 1, 1))
        none = np.zeros((n + 1, n))
        torque = self(poses, none, np.vstack([np.zeros(n), np.eye(n)]))
        return np.asarray((torque[1:] - torque[0]).T)


# Functions derived in this process, by the shape of the arm.
_known: dict[str, ca.Function] = {}


def _together(equations: ArmEquations) -> ca.Function:
    """(q, dq, ddq, Psi) -> sum of both sides' torques (n,) when link and motor move alike."""
    shape = equations.bodies.fingerprint()
    if shape not in _known:
        (_known[shape],) = cached_functions(
            f"together:{shape}", lambda: [_derive_together(equations)], SOURCES
        )
    return _known[shape]


def _derive_together(equations: ArmEquations) -> ca.Function:
    n = equations.robot.n
    dof = equations.dof
    names = ("q", "dq", "ddq")
    q, dq, ddq = (ca.SX.sym(name, n) for name in names)
    x = ca.vertcat(*[q] * (dof // n))
    dx = ca.vertcat(*[dq] * (dof // n))
    ddx = ca.vertcat(*[ddq] * (dof // n))
    force = equations.left_side(x, dx, ddx)
    total = ca.sum2(ca.reshape(force, n, dof // n))
    return ca.Function(
        "together",
        [q, dq, ddq, equations.Psi],
        [ca.densify(ca.cse(total))],
        [*names, "Psi"],
        ["torque"],
    )
