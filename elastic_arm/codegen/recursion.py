"""Recursions over the samples of arrays: in C where there is a compiler, by CasADi elsewhere."""

import ctypes
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.loop import build_loop
from elastic_arm.errors import KernelError

_STEPS = 200  # in one call of CasADi: calling a function costs more than a step


class Recursion:
    """A recursion z, arguments, constants -> next z.

    step: CasADi function of z (s,), the arguments of one sample (a,), and constants (c,).
    """

    def __init__(self, step: ca.Function) -> None:
        self._states = int(step.numel_in(0))
        self._arguments = int(step.numel_in(1))
        self._constants = int(step.numel_in(2))
        self._compiled: Any = None
        self._steps: Any = None
        try:
            self._compiled = self._build(step)
        except KernelError:  # kernels say why there is no compiled code
            self._steps = self._unrolled(step)

    def run(self, arguments: Array, constants: Array, start: float = 0.0) -> Array:
        """Return the states (N, s) at all samples.

        arguments, constants: (N, a) and (c,).
        """
        if self._compiled is not None:
            z = np.full(self._states, start)
            states = np.empty((len(arguments), self._states))
            arrays = (z, np.ascontiguousarray(arguments), np.ascontiguousarray(constants), states)
            self._compiled(len(arguments), *(array.ctypes.data for array in arrays))
            return states
        chunks = -(-len(arguments) // _STEPS)
        missing = chunks * _STEPS - len(arguments)
        padded = np.vstack([arguments, np.repeat(arguments[-1:], missing, axis=0)])
        state = np.full(self._states, start)
        parts = []
        for chunk in padded.reshape(chunks, -1):
            last, states = self._steps(state, chunk, constants)
            state = np.asarray(last, dtype=float).ravel()
            parts.append(np.asarray(states, dtype=float).ravel())
        return np.concatenate(parts).reshape(-1, self._states)[: len(arguments)]

    def _build(self, step: ca.Function) -> Any:
        sizes = {"STATES": self._states, "ARGUMENTS": self._arguments, "CONSTANTS": self._constants}
        loop = (Path(__file__).parent / "c" / "recursion.c").read_text(encoding="utf-8")
        recursion = build_loop(step, "step", loop, sizes).recursion
        recursion.argtypes = [ctypes.c_long, *[ctypes.c_void_p] * 4]
        recursion.restype = None
        return recursion

    def _unrolled(self, step: ca.Function) -> ca.Function:
        arguments = [ca.SX.sym(f"s{k}", self._arguments) for k in range(_STEPS)]
        constants = ca.SX.sym("c", self._constants)
        states = [ca.SX.sym("z", self._states)]
        for now in arguments:
            states.append(step(states[-1], now, constants))
        inputs = [states[0], ca.vertcat(*arguments), constants]
        return ca.Function("steps", inputs, [states[-1], ca.vertcat(*states[:-1])])
