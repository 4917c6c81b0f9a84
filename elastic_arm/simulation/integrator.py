"""Integrators of a closed loop from sample to sample: in C, or by CasADi's interpreter without a
compiler (slower).

Both use the classical Runge-Kutta scheme of fourth order and hold the command between samples. The
mean of tau_J over a sample interval is a state of its own, so it is as accurate as the motion.
"""

import ctypes
import logging
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any, Protocol

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.compiler import find_compiler
from elastic_arm.codegen.loop import build_loop
from elastic_arm.errors import KernelError, SimulationError
from elastic_arm.simulation.assembly import System

log = logging.getLogger(__name__)


@dataclass
class IntegratorState:
    """What passes from one sample to the next.

    `y` (2 dof + states,) holds the generalized coordinates, their rates and the internal states of
    effects. Of the half interval before the sample, (n,) each: the integral of tau_J, Nm s, and
    half the mean of tau_m, Nm; then the motor torque held until the sample, Nm, and the integral of
    the error of theta, rad s.
    """

    y: Array
    half_J: Array
    half_m: Array
    command: Array
    integral: Array


@dataclass(frozen=True)
class Solution:
    """The motion at each sample, and the torques around it."""

    y: Array  # (N, 2 dof + states) as in :class:`IntegratorState`
    # tau_J, tau_m: (N, n) means over the sample interval centred on the sample, Nm
    tau_J: Array
    tau_m: Array
    command: Array  # (N, n) motor torque held from the sample on, Nm


@dataclass(frozen=True)
class ClosedLoop:
    """What does not change during a run."""

    constants: Array  # of the system, as its function of that name gives them
    # (5, n) kp in Nm/rad, kd in Nm s/rad, ki in Nm/(rad s), torque limit in Nm, dead band in rad
    gains: Array
    period: float  # of the samples, s
    half_steps: int  # integration steps in half a period
    commands: int = 1  # a sample: 1, or an even number that divides the steps


class Integrator(Protocol):
    """Advances a closed loop over samples."""

    name: str

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """Advance `state` over a reference (N commands, 3n).

        theta (rad), dtheta (rad/s), feed-forward torque (Nm)

        Where numbers stop being finite the solution ends early.
        """


def make_integrator(system: System, name: str | None = None) -> Integrator:
    """Return the integrator "c" or "casadi"; the faster that this machine has when None."""
    if name not in (None, "c", "casadi"):
        raise SimulationError(
            f"unknown engine {name!r}", "Choose c or casadi, or None for the faster one."
        )
    if name is None:
        return _faster_integrator(system)
    if name not in system.integrators:
        system.integrators[name] = (
            CompiledIntegrator(system) if name == "c" else CasadiIntegrator(system)
        )
    return system.integrators[name]


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
        self._n = system.n
        self._ode = 2 * system.dof + system.states
        sizes = {
            "DOF": system.dof,
            "STATES": system.states,
            "JOINTS": system.n,
            "CONSTANTS": system.constants.numel_out(0),
        }
        loop = (resources.files("elastic_arm.simulation") / "rollout.c").read_text(encoding="utf-8")
        self._rollout = build_loop(system.accelerations, "accelerations", loop, sizes).rollout
        self._rollout.argtypes = [*[ctypes.c_long] * 3, ctypes.c_double, *[ctypes.c_void_p] * 5]
        self._rollout.restype = ctypes.c_long

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """See :meth:`Integrator.run`."""
        ode = self._ode
        n = self._n
        samples = len(reference) // loop.commands
        passed = np.concatenate(
            [state.y, state.half_J, state.half_m, state.command, state.integral]
        )
        out = np.empty((samples, ode + 3 * n))
        arrays = [
            np.ascontiguousarray(a, dtype=float)
            for a in (loop.constants, loop.gains, reference, passed)
        ]
        addresses = [a.ctypes.data for a in (*arrays, out)]
        done = self._rollout(samples, loop.half_steps, loop.commands, loop.period, *addresses)
        state.y = arrays[-1][:ode]
        rest = arrays[-1][ode:].reshape(4, n)
        state.half_J, state.half_m, state.command, state.integral = rest
        return _solution(out[:done], ode, n)


def _solution(rows: Array, ode: int, n: int) -> Solution:
    return Solution(
        rows[:, :ode],
        rows[:, ode : ode + n],
        rows[:, ode + n : ode + 2 * n],
        rows[:, ode + 2 * n :],
    )


def runge_kutta_step(rate: Callable[[Any], Any], y: Any, h: Any) -> Any:
    """Return the state h (s) later by the classical Runge-Kutta scheme.

    From its rate under held inputs.
    """
    k1 = rate(y)
    k2 = rate(y + h / 2 * k1)
    k3 = rate(y + h / 2 * k2)
    return y + h / 6 * (k1 + 2 * (k2 + k3) + rate(y + h * k3))


class CasadiIntegrator:
    """One call a command, two at least a sample; needs no compiler."""

    name = "casadi"

    def __init__(self, system: System) -> None:
        self._n = system.n
        self._dof = system.dof
        self._ode = 2 * system.dof + system.states
        y = ca.SX.sym("y", self._ode + self._n)
        h = ca.SX.sym("h")
        command = ca.SX.sym("command", self._n)
        constants = ca.SX.sym("constants", system.constants.numel_out(0))

        def rate(at: ca.SX) -> ca.SX:
            x = at[: self._dof]
            dx = at[self._dof : 2 * self._dof]
            z = at[2 * self._dof : self._ode]
            return ca.vertcat(dx, *system.accelerations(x, dx, z, command, constants))

        step = ca.Function("step", [y, command, constants, h], [runge_kutta_step(rate, y, h)])
        self._step = step
        self._advance: dict[int, ca.Function] = {}

    def run(self, loop: ClosedLoop, reference: Array, state: IntegratorState) -> Solution:
        """See :meth:`Integrator.run`."""
        n = self._n
        ode = self._ode
        motor = n if self._dof > n else 0
        parts = max(2, loop.commands)
        steps = 2 * loop.half_steps // parts
        advance = self._advance.setdefault(steps, self._step.fold(steps))
        h = loop.period / (2 * loop.half_steps)
        kp, kd, ki, limit, dead_band = loop.gains
        rows: list[Array] = []
        given = iter(reference.reshape(len(reference), 3, n))
        command = state.command
        integral = state.integral.copy()
        for _ in range(len(reference) // loop.commands):
            y = np.append(state.y, np.zeros(n))
            held = np.zeros(n)
            for part in range(parts):
                if part * loop.commands % parts == 0:
                    theta, dtheta, forward = next(given)
                    error = theta - y[motor : motor + n]
                    speed = y[self._dof + motor : self._dof + motor + n]
                    felt = error - np.clip(error, -dead_band, dead_band)
                    torque = forward + kp * felt + kd * (dtheta - speed) + ki * integral
                    command = np.clip(torque, -limit, limit)
                    integral = integral + np.where(
                        command == torque, error * loop.period / loop.commands, 0.0
                    )
                if part == 0:
                    first = command
                y = np.array(advance(y, command, loop.constants, h)).ravel()
                held = held + command / parts
                if 2 * (part + 1) == parts:
                    means = [(state.half_J + y[ode:]) / loop.period, state.half_m + held]
                    y[ode:] = 0.0
                    held = np.zeros(n)
            if not np.isfinite(y).all():
                break
            rows.append(np.concatenate([state.y, *means, first]))
            state.y = y[:ode]
            state.half_J = y[ode:]
            state.half_m = held
            state.command = command
            state.integral = integral
        return _solution(np.array(rows).reshape(-1, ode + 3 * n), ode, n)
