"""Programs run by numpy, one operation over a chunk of samples at a time: for machines without a
compiler."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from elastic_arm.codegen.parallel import in_chunks
from elastic_arm.codegen.program import NAMES, OPERATIONS, Program

# Long enough to hide the cost of a call, short enough for the registers to stay in the caches.
CHUNK = 4096


_Places = list[tuple[int, int]]  # number of the output, column in it


class _Step(NamedTuple):
    """An operation, the registers it takes and that of its result, and where in the outputs this
    goes."""

    ufunc: Callable[..., np.ndarray]
    arguments: tuple[np.ndarray, ...]
    target: np.ndarray
    places: _Places


class _Load(NamedTuple):
    """An element of an input, the register or constant that holds it, and where in the outputs it
    goes."""

    input: int
    element: int
    target: np.ndarray
    places: _Places


def _if_else_zero(condition: np.ndarray, value: np.ndarray, out: np.ndarray) -> np.ndarray:
    # A product would make NaN of zero times what must not count.
    out[...] = np.where(np.not_equal(condition, 0.0), value, 0.0)
    return out


def _erf(value: np.ndarray, out: np.ndarray) -> np.ndarray:
    from scipy.special import erf

    return np.asarray(erf(value, out=out))


_UFUNCS: dict[str, Callable[..., np.ndarray]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power,
    "fmod": np.fmod, "copysign": np.copysign, "fmin": np.fmin, "fmax": np.fmax, "atan2": np.arctan2,
    "hypot": np.hypot, "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal,
    "and": np.logical_and, "or": np.logical_or, "if_else_zero": _if_else_zero, "neg": np.negative,
    "exp": np.exp, "log": np.log, "log1p": np.log1p, "expm1": np.expm1, "sqrt": np.sqrt,
    "fabs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil, "not": np.logical_not,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "erf": _erf,
    "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
}  # fmt: skip


class NumpyEngine:
    """Runs a program over arrays of samples.

    shared: names of inputs that are the same for all samples.
    """

    name = "numpy"

    def __init__(self, program: Program, shared: Sequence[str]) -> None:
        self._program = program
        self._uniform = program.uniform(shared)
        self._registers, self._count = _allocate(program, self._uniform)
        self._idle: dict[int, list[_BoundProgram]] = {}

    def run(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], *, fresh: bool
    ) -> None:
        """Fill `outputs` (N, size) from `arrays`: (N, k), or (k,) where shared.

        `fresh` ones hold zeros.

        arrays: (N, k) values of each argument; (k,) where it is shared by all samples; outputs: (N,
        size) each, to be filled.
        """
        for out in () if fresh else outputs:
            out.fill(0.0)

        def part(start: int, stop: int) -> None:
            # Widths are powers of two, so that few workspaces serve all.
            width = min(CHUNK, 1 << (stop - start - 1).bit_length()) if stop > start else 1
            idle = self._idle.setdefault(width, [])
            try:
                workspace = idle.pop()
            except IndexError:
                workspace = _BoundProgram(
                    self._program, self._uniform, self._registers, self._count, width
                )
            workspace.run(arrays, outputs, start, stop)
            idle.append(workspace)

        # numpy lets go of the interpreter while it works on an array this long: threads do help.
        in_chunks(len(outputs[0]), part)

    @staticmethod
    def allocate(samples: int, size: int) -> np.ndarray:
        """Zeros (samples, size): a run writes only the structural non-zeros."""
        return np.zeros((samples, size))


class _BoundProgram:
    """Memory for the values of `width` samples, with a program's operations bound to it; for one
    thread at a time."""

    def __init__(
        self, program: Program, uniform: np.ndarray, registers: np.ndarray, count: int, width: int
    ) -> None:
        self._width = width
        memory = np.empty((count, width))
        places: dict[int, _Places] = {}
        for number, out in enumerate(program.outputs):
            for value, place in zip(out.values.tolist(), out.places.tolist(), strict=True):
                places.setdefault(value, []).append((number, place))
        self._once: list[_Load | _Step] = []
        self._loads: list[_Load] = []
        self._steps: list[_Step] = []
        # Values that no sample changes are arrays without dimensions: numpy converts those fastest.
        operands: list[np.ndarray] = []
        rows = zip(
            *(v.tolist() for v in (program.op, program.a, program.b, uniform, registers)),
            strict=True,
        )
        for k, (op, a, b, once, register) in enumerate(rows):
            name, mine = NAMES[op], places.get(k, [])
            target = np.array(program.constant[k]) if once else memory[register]
            operands.append(target)
            if name == "input":
                (self._once if once else self._loads).append(_Load(a, b, target, mine))
            elif name != "const":
                arguments = (*(operands[t] for t in (a, b)[: OPERATIONS[name]]), target)
                (self._once if once else self._steps).append(
                    _Step(_UFUNCS[name], arguments, target, mine)
                )
        # What is the same for all samples is not computed before each chunk, but stored.
        self._constants = [(operands[k], places[k]) for k in places if uniform[k]]

    def run(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], start: int, stop: int
    ) -> None:
        """Fill samples `start` to `stop` of `outputs`."""
        for task in self._once:
            if isinstance(task, _Load):
                task.target[...] = arrays[task.input][task.element]
            else:
                task.ufunc(*task.arguments)
        for value, places in self._constants:
            for number, place in places:
                outputs[number][start:stop, place] = value
        # Both sides of a branch are computed: what is wrong on the one not taken is nobody's
        # business.
        with np.errstate(all="ignore"):
            for first in range(start, stop, self._width):
                self._run_chunk(arrays, outputs, slice(first, min(first + self._width, stop)))

    def _run_chunk(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], part: slice
    ) -> None:
        size = part.stop - part.start
        for number, element, target, places in self._loads:
            target[:size] = arrays[number][part, element]
            target[size:] = target[0]
            for output, place in places:
                outputs[output][part, place] = target[:size]
        for ufunc, arguments, target, places in self._steps:
            ufunc(*arguments)
            # At once, while the caches hold it.
            for output, place in places:
                outputs[output][part, place] = target[:size]


def _allocate(program: Program, uniform: np.ndarray) -> tuple[np.ndarray, int]:
    """Give every value a register: inputs one of their own, others share after their last use."""
    is_input = np.array([NAMES[code] == "input" for code in program.op]) & ~uniform
    last = np.arange(len(program))
    for k in range(len(program)):
        for operand in (program.a[k], program.b[k])[: OPERATIONS[NAMES[program.op[k]]]]:
            last[operand] = k
    last[is_input] = len(program)
    ends: dict[int, list[int]] = {}
    for k in np.flatnonzero(~uniform).tolist():
        ends.setdefault(int(last[k]), []).append(k)
    registers = np.full(len(program), -1)
    count = int(is_input.sum())
    # Inputs are loaded before the first operation, so no register that an operation writes may be
    # theirs.
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
