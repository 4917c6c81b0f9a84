"""Programs run by numpy, one operation over a chunk of samples at a time: for machines without a compiler."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from elastic_arm.dynamics.parallel import in_chunks
from elastic_arm.dynamics.program import NAMES, OPERATIONS, Program

# Long enough to hide the cost of a call, short enough for the registers to stay in the caches.
CHUNK = 4096

_Load = tuple[np.ndarray, np.ndarray]
_Step = tuple[Callable[..., np.ndarray], tuple[np.ndarray, ...], np.ndarray]


def _if_else_zero(condition: np.ndarray, value: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    return np.multiply(np.not_equal(condition, 0.0), value, out=out) if out is not None else condition * value


def _erf(value: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    from scipy.special import erf

    return np.asarray(erf(value, out=out))


_UFUNCS: dict[str, Callable[..., np.ndarray]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power, "fmod": np.fmod,
    "copysign": np.copysign, "fmin": np.fmin, "fmax": np.fmax, "atan2": np.arctan2, "hypot": np.hypot,
    "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "and": np.logical_and,
    "or": np.logical_or, "if_else_zero": _if_else_zero, "neg": np.negative, "exp": np.exp, "log": np.log,
    "log1p": np.log1p, "expm1": np.expm1, "sqrt": np.sqrt, "fabs": np.abs, "sign": np.sign, "floor": np.floor,
    "ceil": np.ceil, "not": np.logical_not, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin,
    "acos": np.arccos, "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "erf": _erf,
    "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
}  # fmt: skip


class NumpyEngine:
    """Runs a program over arrays of samples.

    Parameters
    ----------
    program
        What to run.
    shared
        Names of inputs that are the same for all samples.
    """

    name = "numpy"

    def __init__(self, program: Program, shared: Sequence[str]) -> None:
        self._program = program
        self._shared = set(shared)
        self._uniform = program.uniform(shared)
        self._registers, self._count = _allocate(program, self._uniform)

    def run(self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> None:
        """Fill `outputs` (N, size) from `arrays`: (N, k), or (k,) where shared."""
        constants = self._uniform_values(arrays)
        # numpy lets go of the interpreter while it works on an array this long: threads do help.
        in_chunks(len(outputs[0]), lambda start, stop: self._run_part(arrays, outputs, constants, start, stop))

    def _run_part(
        self,
        arrays: Sequence[np.ndarray],
        outputs: Sequence[np.ndarray],
        constants: dict[int, np.ndarray],
        start: int,
        stop: int,
    ) -> None:
        width = min(CHUNK, stop - start)
        registers = np.empty((self._count, width))
        operands, loads, steps = self._bind(arrays, constants, registers)
        for first in range(start, stop, CHUNK):
            size = min(width, stop - first)
            for register, column in loads:
                register[:size] = column[first : first + size]
                register[size:] = register[0]
            for ufunc, taken, target in steps:
                ufunc(*taken, out=target)
            for out, array in zip(self._program.outputs, outputs, strict=True):
                for value, place in zip(out.values.tolist(), out.places.tolist(), strict=True):
                    source = operands[value]
                    array[first : first + size, place] = source[:size] if source.ndim else source

    def _bind(
        self, arrays: Sequence[np.ndarray], constants: dict[int, np.ndarray], registers: np.ndarray
    ) -> tuple[list[np.ndarray], list[_Load], list[_Step]]:
        """Give every value its memory: what is loaded for each chunk, and what is called on what."""
        program = self._program
        operands: list[np.ndarray] = [np.empty(0)] * len(program)
        loads: list[_Load] = []
        steps: list[_Step] = []
        for k in range(len(program)):
            if self._uniform[k]:
                operands[k] = constants[k]
                continue
            name = NAMES[program.op[k]]
            operands[k] = registers[self._registers[k]]
            if name == "input":
                loads.append((operands[k], arrays[program.a[k]][:, program.b[k]]))
            else:
                taken = (program.a[k], program.b[k])[: OPERATIONS[name]]
                steps.append((_UFUNCS[name], tuple(operands[t] for t in taken), operands[k]))
        return operands, loads, steps

    @staticmethod
    def allocate(samples: int, size: int) -> np.ndarray:
        """Zeros (samples, size): a run writes only the structural non-zeros."""
        return np.zeros((samples, size))

    def _uniform_values(self, arrays: Sequence[np.ndarray]) -> dict[int, np.ndarray]:
        """Values that no sample changes, as arrays without dimensions: numpy converts those fastest."""
        program = self._program
        values: dict[int, np.ndarray] = {}
        for k in np.flatnonzero(self._uniform).tolist():
            name = NAMES[program.op[k]]
            if name == "const":
                value = program.constant[k]
            elif name == "input":
                value = arrays[program.a[k]][program.b[k]]
            else:
                taken = (int(program.a[k]), int(program.b[k]))[: OPERATIONS[name]]
                value = _UFUNCS[name](*(values[t] for t in taken))
            values[k] = np.array(value, dtype=float)
        return values


def _allocate(program: Program, uniform: np.ndarray) -> tuple[np.ndarray, int]:
    """Give every value a register: inputs and outputs one of their own, others share after their last use."""
    is_input = np.array([NAMES[code] == "input" for code in program.op]) & ~uniform
    last = np.arange(len(program))
    for k in range(len(program)):
        for operand in (program.a[k], program.b[k])[: OPERATIONS[NAMES[program.op[k]]]]:
            last[operand] = k
    for out in program.outputs:
        last[out.values] = len(program)
    last[is_input] = len(program)
    ends: dict[int, list[int]] = {}
    for k in np.flatnonzero(~uniform).tolist():
        ends.setdefault(int(last[k]), []).append(k)
    registers = np.full(len(program), -1)
    count = int(is_input.sum())
    # Inputs are loaded before the first operation, so no register that an operation writes may be theirs.
    registers[is_input] = np.arange(count)
    free: list[int] = []
    for k in range(len(program)):
        if not uniform[k] and not is_input[k]:
            if free:
                registers[k] = free.pop()
            else:
                registers[k], count = count, count + 1
        free += [int(registers[v]) for v in ends.get(k, ())]
    return registers, count
