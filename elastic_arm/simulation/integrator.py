"""Integrators of a closed loop from sample to sample: in C, and without a compiler by CasADi's interpreter (slower).

Both integrate with the classical Runge-Kutta scheme of fourth order and hold the command between samples. The mean of
tau_J over a sample interval is a state of its own, so it is as exact as the motion.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.compiler import find_compiler
from elastic_arm.codegen.loop import build_loop
from elastic_arm.errors import KernelError, SimulationError
from elastic_arm.simulation.assembly import System

Array = NDArray[np.float64]
log = logging.getLogger(__name__)


@dataclass
class IntegratorState:
    """What passes from one sample to the next.

    Parameters
    ----------
    y : (2 dof + states,)
        Generalized coordinates, their rates, and internal states of effects.
    half : (n,)
        Integral of tau_J over the half interval before the sample, Nm s.
    command : (n,)
        Motor torque held until the sample, Nm.
    """

    y: Array
    half: Array
    command: Array


@dataclass(frozen=True)
class Solution:
    """The motion at each sample, and the torques around it.

    Parameters
    ----------
    y : (N, 2 dof + states)
        As in :class:`IntegratorState`.
    tau_J, tau_m : (N, n)
        Means over the sample interval centred on the sample, Nm.
    command : (N, n)
        Motor torque held from the sample on, Nm.
    """

    y: Array
    tau_J: Array
    tau_m: Array
    command: Array


@dataclass(frozen=True)
class ClosedLoop:
    """What does not change during a run.

    Parameters
    ----------
    constants
        Of the system, as its function of that name gives them.
    gains : (3, n)
        kp in Nm/rad, kd in Nms/rad, torque limit in Nm.
    period
        Of the samples, s.
    half_steps
        Integration steps in half a period.
    """

    constants: Array
    gains: Array
    period: float
    half_steps: int


class Integrator(Protocol):
    """Advances a closed loop over samples."""

    name: str

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """Advance `state` over `reference` (N, 3n): theta, dtheta, feed-forward torque.

        Where numbers stop being finite the solution ends early.

        Parameters
        ----------
        loop
            Arm, effects and controller.
        reference
            (N, 3n): theta (rad), dtheta (rad/s), feed-forward torque (Nm).
        state
            Where the arm is; left at the end of the run.
        """


def make_integrator(system: System, name: str | None = None) -> Integrator:
    """Return the integrator "c" or "casadi"; the faster that this machine has when None.

    Raises
    ------
    SimulationError
        If there is no integrator of that name.
    KernelError
        If "c" is asked for and cannot be had.
    """
    if name not in (None, "c", "casadi"):
        raise SimulationError(f"there is no engine {name!r}", "Choose c or casadi, or None for the faster one.")
    if name is None:
        return _faster_integrator(system)
    if name not in system.integrators:
        system.integrators[name] = CompiledIntegrator(system) if name == "c" else CasadiIntegrator(system)
    integrator: Integrator = system.integrators[name]
    return integrator


def _faster_integrator(system: System) -> Integrator:
    try:
        if find_compiler():
            return make_integrator(system, "c")
        reason = "no C compiler was found. Install gcc or clang."
    except KernelError as error:
        reason = str(error)
    log.warning("The simulation runs about fifty times slower than compiled: %s", reason)
    return make_integrator(system, "casadi")


class CompiledIntegrator:
    """All samples in one call of compiled, straight-line code."""

    name = "c"

    def __init__(self, system: System) -> None:
        self._n, self._ode = system.n, 2 * system.dof + system.states
        sizes = {
            "DOF": system.dof,
            "STATES": system.states,
            "JOINTS": system.n,
            "CONSTANTS": system.constants.numel_out(0),
        }
        loop = (resources.files("elastic_arm.simulation") / "rollout.c").read_text(encoding="utf-8")
        self._rollout = build_loop(system.accelerations, "accelerations", loop, sizes).rollout
        self._rollout.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_double, *[ctypes.c_void_p] * 5]
        self._rollout.restype = ctypes.c_long

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """See :meth:`Integrator.run`.

        Parameters
        ----------
        loop
            Arm, effects and controller.
        reference
            (N, 3n): theta (rad), dtheta (rad/s), feed-forward torque (Nm).
        state
            Where the arm is; left at the end of the run.
        """
        ode, n = self._ode, self._n
        passed = np.concatenate([state.y, state.half, state.command])
        out = np.empty((len(reference), ode + 3 * n))
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (loop.constants, loop.gains, reference, passed)]
        addresses = [a.ctypes.data for a in (*arrays, out)]
        done = self._rollout(len(reference), loop.half_steps, loop.period, *addresses)
        passed = arrays[-1]
        state.y, state.half, state.command = passed[:ode], passed[ode : ode + n], passed[ode + n :]
        return _solution(out[:done], ode, n)


def _solution(rows: Array, ode: int, n: int) -> Solution:
    return Solution(rows[:, :ode], rows[:, ode : ode + n], rows[:, ode + n : ode + 2 * n], rows[:, ode + 2 * n :])


def runge_kutta_step(rate: Callable[[Any], Any], y: Any, h: Any) -> Any:
    """Return the state a step later by the classical Runge-Kutta scheme of fourth order.

    Parameters
    ----------
    rate
        State -> its time derivative, under inputs that are constant over the step.
    y
        State, a NumPy array or a CasADi expression of any shape.
    h
        Step, s.
    """
    k1 = rate(y)
    k2 = rate(y + h / 2 * k1)
    k3 = rate(y + h / 2 * k2)
    return y + h / 6 * (k1 + 2 * (k2 + k3) + rate(y + h * k3))


class CasadiIntegrator:
    """One call a half interval; needs no compiler."""

    name = "casadi"

    def __init__(self, system: System) -> None:
        self._n, self._dof, self._ode = system.n, system.dof, 2 * system.dof + system.states
        y, h = ca.SX.sym("y", self._ode + self._n), ca.SX.sym("h")
        command = ca.SX.sym("command", self._n)
        constants = ca.SX.sym("constants", system.constants.numel_out(0))

        def rate(at: ca.SX) -> ca.SX:
            x, dx, z = at[: self._dof], at[self._dof : 2 * self._dof], at[2 * self._dof : self._ode]
            return ca.vertcat(dx, *system.accelerations(x, dx, z, command, constants))

        step = ca.Function("step", [y, command, constants, h], [runge_kutta_step(rate, y, h)])
        self._step = step
        self._half: dict[int, ca.Function] = {}

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """See :meth:`Integrator.run`.

        Parameters
        ----------
        loop
            Arm, effects and controller.
        reference
            (N, 3n): theta (rad), dtheta (rad/s), feed-forward torque (Nm).
        state
            Where the arm is; left at the end of the run.
        """
        n, ode = self._n, self._ode
        motor = n if self._dof > n else 0
        half = self._half.setdefault(loop.half_steps, self._step.fold(loop.half_steps))
        h = loop.period / (2 * loop.half_steps)
        kp, kd, limit = loop.gains
        rows = []
        for theta, dtheta, torque in reference.reshape(len(reference), 3, n):
            y = state.y
            torque = torque + kp * (theta - y[motor : motor + n])
            torque = torque + kd * (dtheta - y[self._dof + motor : self._dof + motor + n])
            command = np.clip(torque, -limit, limit)
            middle = np.array(half(np.append(y, np.zeros(n)), command, loop.constants, h)).ravel()
            end = np.array(half(np.append(middle[:ode], np.zeros(n)), command, loop.constants, h)).ravel()
            if not np.isfinite(end).all():
                break
            mean_J = (state.half + middle[ode:]) / loop.period
            rows.append(np.concatenate([y, mean_J, 0.5 * (state.command + command), command]))
            state.y, state.half, state.command = end[:ode], end[ode:], command
        return _solution(np.array(rows).reshape(-1, ode + 3 * n), ode, n)
