"""Internal states of a law run over the samples of a recording: in C where there is a compiler, by CasADi elsewhere."""

from __future__ import annotations

import ctypes
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen import kernels
from elastic_arm.codegen.compiler import find_compiler

Array = NDArray[np.float64]

STEPS = 200  # in one call of CasADi: calling a function costs more than a step
LOOP = """
void scan(long samples, double *z, const double *arguments, const double *constants, double *course)
{
    double in[STATES + ARGUMENTS + CONSTANTS];
    for (long k = 0; k < samples; k++) {
        for (int i = 0; i < STATES; i++) in[i] = course[k * STATES + i] = z[i];
        for (int i = 0; i < ARGUMENTS; i++) in[STATES + i] = arguments[k * ARGUMENTS + i];
        for (int i = 0; i < CONSTANTS; i++) in[STATES + ARGUMENTS + i] = constants[i];
        step(in, z);
    }
}
"""


class Scan:
    """A recursion z, arguments, constants -> next z.

    Parameters
    ----------
    step
        CasADi function of z (s,), the arguments of one sample (a,), and constants (c,).
    """

    def __init__(self, step: ca.Function) -> None:
        self._states, self._arguments, self._constants = (int(step.numel_in(i)) for i in range(3))
        self._compiled: Any = self._build(step) if find_compiler() else None
        self._steps: Any = None if self._compiled else self._unrolled(step)

    def run(self, arguments: Array, constants: Array) -> Array:
        """Return the states (N, s) at all samples, from zero on, for arguments (N, a)."""
        if self._compiled is not None:
            z, course = np.zeros(self._states), np.empty((len(arguments), self._states))
            arrays = (z, np.ascontiguousarray(arguments), np.ascontiguousarray(constants), course)
            self._compiled(len(arguments), *(array.ctypes.data for array in arrays))
            return course
        chunks = -(-len(arguments) // STEPS)
        missing = chunks * STEPS - len(arguments)
        padded = np.vstack([arguments, np.repeat(arguments[-1:], missing, axis=0)])
        state, courses = np.zeros(self._states), []
        for chunk in padded.reshape(chunks, -1):
            last, passed = self._steps(state, chunk, constants)
            state = np.asarray(last, dtype=float).ravel()
            courses.append(np.asarray(passed, dtype=float).ravel())
        return np.concatenate(courses).reshape(-1, self._states)[: len(arguments)]

    def _build(self, step: ca.Function) -> Any:
        sizes = {"STATES": self._states, "ARGUMENTS": self._arguments, "CONSTANTS": self._constants}
        source = kernels.emit_c(step, "step") + "".join(f"#define {name} {size}\n" for name, size in sizes.items())
        scan = kernels.build(source + LOOP).scan
        scan.argtypes, scan.restype = [ctypes.c_long, *[ctypes.c_void_p] * 4], None
        return scan

    def _unrolled(self, step: ca.Function) -> ca.Function:
        many = [ca.SX.sym(f"s{k}", self._arguments) for k in range(STEPS)]
        constants = ca.SX.sym("c", self._constants)
        course = [ca.SX.sym("z", self._states)]
        start = course[0]
        for now in many:
            course.append(step(course[-1], now, constants))
        return ca.Function("steps", [start, ca.vertcat(*many), constants], [course[-1], ca.vertcat(*course[:-1])])
