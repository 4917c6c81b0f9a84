"""The controller on the motor side: PD on theta, with the torque of a model fed forward."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.function_cache import stored
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.errors import SimulationError
from elastic_arm.robot import Robot
from elastic_arm.simulation.assembly import SOURCES

Array = NDArray[np.float64]
Feedforward = Callable[[Array, Array, Array], Array]

BANDWIDTH = 3.0
DAMPING_RATIO = 0.8
# Where the motor bounds kd: how much of the bound is used, and how far kp may then go.
HELD_SHARE = 0.6
LEAST_DAMPING_RATIO = 0.2


def no_feedforward(q: Array, dq: Array, ddq: Array) -> Array:
    """Feed no torque forward.

    Parameters
    ----------
    q, dq, ddq
        (n,) or (N, n) rad, rad/s and rad/s².
    """
    return np.zeros_like(q)


@dataclass(frozen=True)
class Controller:
    """tau_m = kp (theta_ref - theta) + kd (dtheta_ref - dtheta) + feed-forward, held for a sample, within limits.

    It reads the motor side without noise.

    Parameters
    ----------
    kp, kd : (n,)
        Nm/rad, Nm s/rad.
    feedforward
        Reference q, dq, ddq (N, n) -> torque (N, n).
    """

    kp: Array
    kd: Array
    feedforward: Feedforward = no_feedforward

    def __post_init__(self) -> None:
        for name in ("kp", "kd"):
            gains = np.asarray(getattr(self, name), dtype=float)
            if gains.ndim != 1 or not np.isfinite(gains).all() or (gains < 0).any():
                raise SimulationError(
                    f"{name} of the controller is {getattr(self, name)!r}", "Give n gains, zero or more."
                )
            object.__setattr__(self, name, gains)


def tuned(robot: Robot, *, bandwidth: float = BANDWIDTH, model: str = "mod3", rate: float = 1000.0) -> Controller:
    """Return a controller for a nominal arm: well damped at `bandwidth` (Hz), with feed-forward.

    The gains fit the inertia of each whole joint, link and motor, in the zero position; but the motor alone, on its
    drive's damper, must stay stable under a command held for a sample. Where the ratio is low and the motor light, that
    bounds both gains.

    Parameters
    ----------
    robot
        The nominal arm.
    bandwidth
        Hz.
    model
        Variant of the feed-forward torque.
    rate
        Of the commands, Hz.
    """
    equations = ArmEquations(robot, model)
    feedforward = RigidFeedforward(equations)
    inertia = feedforward.joint_inertia()
    speed = 2 * np.pi * bandwidth
    kd = np.minimum(2 * DAMPING_RATIO * speed * inertia, HELD_SHARE * _largest_held_damping(equations, rate))
    slowed = kd / (2 * LEAST_DAMPING_RATIO * inertia)
    return Controller(np.minimum(speed, slowed) ** 2 * inertia, kd, feedforward)


def _largest_held_damping(equations: ArmEquations, rate: float) -> Array:
    """Return the kd (n,) at which B dv/dt = -D v - kd v_k, v_k held for a sample, ceases to decay."""
    if not equations.robot.elastic:
        return np.full(equations.robot.n, np.inf)
    numbers = ca.Function("numbers", [equations.Psi], [equations.D, equations.B])
    D, B = (np.array(values).ravel() for values in numbers(equations.nominal))
    decay = D / (B * rate)
    # D (1 + a) / (1 - a) with a = exp(-decay), which without damping is 2 B rate.
    return 2.0 * B * rate * np.where(decay > 1e-9, 0.5 * decay / np.tanh(0.5 * np.maximum(decay, 1e-9)), 1.0)


class RigidFeedforward:
    """The torque that moves an arm along a reference as if its drives were rigid (q = theta).

    Evaluated sample by sample in one way, so that a run and its single steps agree to the bit.
    """

    def __init__(self, equations: ArmEquations) -> None:
        # The buffer points into the function and the arrays: they live as long as it does.
        self._function = _together(equations)
        self._arguments = [*(np.zeros(equations.robot.n) for _ in range(3)), equations.nominal.copy()]
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

    def joint_inertia(self) -> Array:
        """Return the inertia (n,) of each joint in the zero position, link and motor side turning together, kg m²."""
        n = len(self._torque)
        none = np.zeros((n + 1, n))
        torque = self(none, none, np.vstack([np.zeros(n), np.eye(n)]))
        return np.diag(torque[1:] - torque[0]).copy()


# Functions derived in this process, by the shape of the arm.
_known: dict[str, ca.Function] = {}


def _together(equations: ArmEquations) -> ca.Function:
    """(q, dq, ddq, Psi) -> sum of both sides' torques (n,) when link and motor move alike."""
    shape = equations.bodies.fingerprint()
    if shape not in _known:
        (_known[shape],) = stored(f"together:{shape}", lambda: [_derive_together(equations)], SOURCES)
    return _known[shape]


def _derive_together(equations: ArmEquations) -> ca.Function:
    n, dof = equations.robot.n, equations.dof
    names = ("q", "dq", "ddq")
    q, dq, ddq = (ca.SX.sym(name, n) for name in names)
    x, dx, ddx = (ca.vertcat(*[v] * (dof // n)) for v in (q, dq, ddq))
    force = equations.left_side(x, dx, ddx)
    total = ca.sum2(ca.reshape(force, n, dof // n))
    return ca.Function(
        "together", [q, dq, ddq, equations.Psi], [ca.densify(ca.cse(total))], [*names, "Psi"], ["torque"]
    )
