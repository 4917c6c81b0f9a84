"""Engines that run a closed loop from sample to sample: in C, and without a compiler in CasADi's own machine (slower).

Both integrate with the classical Runge-Kutta scheme of fourth order and hold the command between samples. The mean of
tau_J over a sample interval is a state of its own, so it is as exact as the motion.
"""

from __future__ import annotations

import ctypes
import logging
from dataclasses import dataclass
from importlib import resources
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.compiler import build, find_compiler
from elastic_arm.codegen.emit_c import emit_scalar
from elastic_arm.codegen.program import from_casadi
from elastic_arm.errors import SimulationError
from elastic_arm.simulation.assembly import System

Array = NDArray[np.float64]
log = logging.getLogger(__name__)


@dataclass
class Carry:
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
class Course:
    """What happened at each sample: y (N, 2 dof + states), and (N, n) in Nm the means and the command that follows."""

    y: Array
    tau_J: Array
    tau_m: Array
    command: Array


@dataclass(frozen=True)
class Loop:
    """What holds during a run: constants of the system, gains (3, n) of kp, kd and torque limit, period (s), steps."""

    constants: Array
    gains: Array
    period: float
    half_steps: int


class Engine(Protocol):
    """Runs samples."""

    name: str

    def run(self, loop: Loop, reference: Array, carry: Carry) -> Course:
        """Advance `carry` over `reference` (N, 3n): theta, dtheta, feed-forward torque.

        Where numbers stop being finite the course ends early.
        """


def make_engine(system: System, name: str | None = None) -> Engine:
    """Return the engine "c" or "casadi"; the fastest that this machine has when None.

    Raises
    ------
    SimulationError
        If there is no engine of that name.
    """
    if name not in (None, "c", "casadi"):
        raise SimulationError(f"there is no engine {name!r}", "Choose c or casadi, or None for the faster one.")
    if name is None:
        name = "c" if find_compiler() else "casadi"
        if name == "casadi":
            log.warning("no C compiler was found: the simulation runs about fifty times slower. Install gcc or clang.")
    if name not in system.engines:
        system.engines[name] = CEngine(system) if name == "c" else CasadiEngine(system)
    engine: Engine = system.engines[name]
    return engine


class CEngine:
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
        source = emit_scalar(from_casadi(system.accelerations), "accelerations")
        source += "".join(f"#define {name} {size}\n" for name, size in sizes.items())
        source += (resources.files("elastic_arm.simulation") / "rollout.c").read_text(encoding="utf-8")
        self._rollout = build(source).rollout
        self._rollout.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_double, *[ctypes.c_void_p] * 5]
        self._rollout.restype = ctypes.c_long

    def run(self, loop: Loop, reference: Array, carry: Carry) -> Course:
        """See :meth:`Engine.run`."""
        ode, n = self._ode, self._n
        state = np.concatenate([carry.y, carry.half, carry.command])
        out = np.empty((len(reference), ode + 3 * n))
        arrays = [np.ascontiguousarray(a, dtype=float) for a in (loop.constants, loop.gains, reference, state)]
        addresses = [a.ctypes.data for a in (*arrays, out)]
        done = self._rollout(len(reference), loop.half_steps, loop.period, *addresses)
        state = arrays[-1]
        carry.y, carry.half, carry.command = state[:ode], state[ode : ode + n], state[ode + n :]
        return _course(out[:done], ode, n)


def _course(rows: Array, ode: int, n: int) -> Course:
    return Course(rows[:, :ode], rows[:, ode : ode + n], rows[:, ode + n : ode + 2 * n], rows[:, ode + 2 * n :])


class CasadiEngine:
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

        k1 = rate(y)
        k2 = rate(y + h / 2 * k1)
        k3 = rate(y + h / 2 * k2)
        k4 = rate(y + h * k3)
        step = ca.Function("step", [y, command, constants, h], [y + h / 6 * (k1 + 2 * (k2 + k3) + k4)])
        self._step = step
        self._half: dict[int, ca.Function] = {}

    def run(self, loop: Loop, reference: Array, carry: Carry) -> Course:
        """See :meth:`Engine.run`."""
        n, ode = self._n, self._ode
        motor = n if self._dof > n else 0
        half = self._half.setdefault(loop.half_steps, self._step.fold(loop.half_steps))
        h = loop.period / (2 * loop.half_steps)
        kp, kd, limit = loop.gains
        rows = []
        for theta, dtheta, torque in reference.reshape(len(reference), 3, n):
            y = carry.y
            torque = torque + kp * (theta - y[motor : motor + n])
            torque = torque + kd * (dtheta - y[self._dof + motor : self._dof + motor + n])
            command = np.clip(torque, -limit, limit)
            middle = np.array(half(np.append(y, np.zeros(n)), command, loop.constants, h)).ravel()
            end = np.array(half(np.append(middle[:ode], np.zeros(n)), command, loop.constants, h)).ravel()
            if not np.isfinite(end).all():
                break
            mean_J = (carry.half + middle[ode:]) / loop.period
            rows.append(np.concatenate([y, mean_J, 0.5 * (carry.command + command), command]))
            carry.y, carry.half, carry.command = end[:ode], end[ode:], command
        return _course(np.array(rows).reshape(-1, ode + 3 * n), ode, n)
