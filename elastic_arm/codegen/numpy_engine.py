"""Programs run by NumPy, one operation over a chunk of samples at a time: for machines without a
compiler."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from elastic_arm.codegen.parallel import in_chunks
from elastic_arm.codegen.program import NAMES, OPERATIONS, Program

# Samples: enough to hide the cost of a call, few enough for the values to stay in the caches.
CHUNK = 4096


def _number(comparison: Callable[..., Any]) -> Callable[..., Any]:
    """Return a comparison that gives numbers: NumPy does not subtract truth values."""
    return lambda *operands: comparison(*operands).astype(float)


def _if_else_zero(condition: Any, value: Any) -> Any:
    # A product would make NaN of zero times what must not count.
    return np.where(np.not_equal(condition, 0.0), value, 0.0)


def _erf(value: Any) -> Any:
    from scipy.special import erf

    return erf(value)


_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "pow": np.power,
    "fmod": np.fmod, "copysign": np.copysign, "fmin": np.fmin, "fmax": np.fmax, "atan2": np.arctan2,
    "hypot": np.hypot, "lt": _number(np.less), "le": _number(np.less_equal),
    "eq": _number(np.equal), "ne": _number(np.not_equal), "and": _number(np.logical_and),
    "or": _number(np.logical_or), "not": _number(np.logical_not), "if_else_zero": _if_else_zero,
    "neg": np.negative, "exp": np.exp, "log": np.log, "log1p": np.log1p, "expm1": np.expm1,
    "sqrt": np.sqrt, "fabs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "erf": _erf,
    "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
}  # fmt: skip


class _Step(NamedTuple):
    """An operation, where its value goes in the outputs, and the values that nothing later
    needs."""

    number: int
    operation: str
    operands: list[int]  # values; of an input its index and the element
    places: list[tuple[int, int]]  # number of the output, column in it
    spent: list[int]


class NumpyEngine:
    """Runs a program over arrays of samples.

    shared: names of inputs that are the same for all samples.
    """

    name = "numpy"

    def __init__(self, program: Program, shared: Sequence[str]) -> None:
        uniform = program.uniform(shared)
        steps = _steps(program, uniform)
        self._constant = program.constant
        self._once = [step for step in steps if uniform[step.number]]
        self._each = [step for step in steps if not uniform[step.number]]

    def run(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], *, fresh: bool
    ) -> None:
        """Fill `outputs` from `arrays`.

        arrays: (N, k) values of each argument; (k,) where it is shared by all samples; outputs: (N,
        size) each, to be filled; fresh: whether they hold zeros.
        """
        for out in () if fresh else outputs:
            out.fill(0.0)
        self.run_at(arrays, [out.T for out in outputs], 1)

    def run_at(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], points: int
    ) -> None:
        """Fill `outputs`, which hold zeros, at several values of shared inputs.

        What does not depend on these is evaluated once.

        arrays: as for :meth:`run`, but (k, P, 1) for an input of several values; outputs: (size, P,
        N) each, or (size, N) where all have one value.
        """
        shared: list[Any] = [None] * len(self._constant)
        with np.errstate(all="ignore"):
            self._evaluate(self._once, shared, arrays, outputs, slice(None))
        chunk = -(-CHUNK // points)

        def part(start: int, stop: int) -> None:
            # Both sides of a branch are computed: faults on the side not taken do not matter.
            with np.errstate(all="ignore"):
                for first in range(start, stop, chunk):
                    rows = slice(first, min(first + chunk, stop))
                    self._evaluate(self._each, shared.copy(), arrays, outputs, rows)

        # NumPy releases the interpreter while it works on an array this long: threads do help.
        in_chunks(outputs[0].shape[-1], part)

    def _evaluate(
        self,
        steps: Sequence[_Step],
        values: list[Any],
        arrays: Sequence[np.ndarray],
        outputs: Sequence[np.ndarray],
        rows: slice,
    ) -> None:
        """Carry out steps for some samples; `values` holds what earlier steps gave."""
        for number, operation, operands, places, spent in steps:
            if operation == "const":
                value = self._constant[number]
            elif operation == "input":
                array, element = operands
                given = arrays[array]
                value = given[rows, element].copy() if given.ndim == 2 else given[element]
            else:
                value = _FUNCTIONS[operation](*[values[k] for k in operands])
            values[number] = value
            for output, place in places:
                outputs[output][place][..., rows] = value
            for k in spent:
                values[k] = None

    @staticmethod
    def allocate(samples: int, size: int) -> np.ndarray:
        """Zeros (samples, size): a run writes only the structural non-zeros."""
        return np.zeros((samples, size))


def _steps(program: Program, uniform: np.ndarray) -> list[_Step]:
    places = defaultdict(list)
    for number, out in enumerate(program.outputs):
        for value, place in zip(out.values.tolist(), out.places.tolist(), strict=True):
            places[value].append((number, place))
    steps = []
    last: dict[int, int] = {}
    rows = zip(program.op.tolist(), program.a.tolist(), program.b.tolist(), strict=True)
    for k, (code, a, b) in enumerate(rows):
        operation = NAMES[code]
        operands = [a, b] if operation == "input" else [a, b][: OPERATIONS[operation]]
        steps.append(_Step(k, operation, operands, places[k], []))
        if operation != "input":
            last |= dict.fromkeys(operands, k)
    for value, step in last.items():
        if not uniform[value]:
            steps[step].spent.append(value)
    return steps
