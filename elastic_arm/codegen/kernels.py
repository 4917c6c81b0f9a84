"""Compiled functions over whole arrays of samples.

A CasADi function becomes a straight-line :class:`~elastic_arm.codegen.program.Program`, and the
program a kernel: in C if there is a compiler, otherwise in NumPy.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from elastic_arm.codegen.c_engine import CEngine
from elastic_arm.codegen.compiler import build
from elastic_arm.codegen.numpy_engine import NumpyEngine
from elastic_arm.codegen.program import Program, from_casadi
from elastic_arm.errors import KernelError

if TYPE_CHECKING:
    import casadi

_LOG = logging.getLogger(__name__)


__all__ = ["Engine", "Kernel", "build", "compile", "make"]


# What runs a program.
Engine = CEngine | NumpyEngine


class Kernel:
    """A function of samples.

    Call it with one array an input: (N, k), or (k,) for an input that all samples share. It returns
    one array an output: (N, m) of a vector, (N, r, c) of a matrix; a single array where there is
    one output.
    """

    def __init__(self, program: Program, engine: Engine, shared: Sequence[str]) -> None:
        self.program = program
        self.engine = engine
        self.shared = frozenset(shared)

    def __call__(
        self, *arrays: np.ndarray, out: Sequence[np.ndarray] | None = None
    ) -> np.ndarray | tuple[np.ndarray, ...]:
        """Evaluate at all samples.

        out: arrays to write to, one an output, of the shapes returned: spares the system's clearing
        of new memory, which for large arrays costs more than the evaluation.

        Raises a ValueError if an array's shape is not the input's, or the numbers of samples
        differ, or `out` does not fit.
        """
        ready, samples = self.check(arrays)
        if out is None:
            flat = [self.engine.allocate(samples, o.size) for o in self.program.outputs]
        else:
            flat = self._flat(out, samples)
        self.engine.run(ready, flat, fresh=out is None)
        shapes = self._shapes(samples)
        shaped = tuple(array.reshape(shape) for array, shape in zip(flat, shapes, strict=True))
        return shaped if len(shaped) > 1 else shaped[0]

    def at_each(self, name: str, points: np.ndarray, *arrays: np.ndarray) -> np.ndarray:
        """Return the only output (P, m, N), a vector, at several values (P, k) of a shared input.

        arrays: as for a call; of this input any value.
        """
        place = [own for own, _ in self.program.inputs].index(name)
        if not isinstance(self.engine, NumpyEngine):
            each = [self(*arrays[:place], point, *arrays[place + 1 :]) for point in points]
            return np.stack([np.asarray(values).T for values in each])
        ready, samples = self.check(arrays)
        ready[place] = points.T[:, :, None]
        (output,) = self.program.outputs
        found = np.zeros((len(points), output.size, samples))
        self.engine.run_at(ready, [found.swapaxes(0, 1)], len(points))
        return found

    def _shapes(self, samples: int) -> list[tuple[int, ...]]:
        return [
            (samples, out.size) if out.shape[1] == 1 else (samples, *out.shape)
            for out in self.program.outputs
        ]

    def _flat(self, given: Sequence[np.ndarray], samples: int) -> list[np.ndarray]:
        shapes = self._shapes(samples)
        if [(a.shape, a.dtype, a.flags.carray) for a in given] != [
            (s, np.dtype(float), True) for s in shapes
        ]:
            raise ValueError(
                f"out must be contiguous, writable arrays of floats of shapes {shapes}"
            )
        return [array.reshape(samples, -1) for array in given]

    def check(self, arrays: Sequence[np.ndarray]) -> tuple[list[np.ndarray], int]:
        """Return contiguous arrays of the inputs' shapes, and the number of samples.

        Raises a ValueError if an array's shape is not the input's, or the numbers of samples
        differ.
        """
        if len(arrays) != len(self.program.inputs):
            names = ", ".join(name for name, _ in self.program.inputs)
            raise ValueError(f"{len(arrays)} arrays given, but the inputs are {names}")
        ready = []
        samples = None
        for (name, size), given in zip(self.program.inputs, arrays, strict=True):
            array = np.ascontiguousarray(given, dtype=float)
            expected: tuple[int, ...] = (size,)
            if name not in self.shared:
                expected = (len(array) if array.ndim else 0, size)
            if array.shape != expected:
                raise ValueError(
                    f"{name} has shape {array.shape}, but must be {('N', size)[-len(expected) :]}"
                )
            if name not in self.shared:
                if samples not in (None, len(array)):
                    raise ValueError(
                        f"{name} has {len(array)} samples, but the inputs before it have {samples}"
                    )
                samples = len(array)
            ready.append(array)
        return ready, 1 if samples is None else samples


def compile(
    function: casadi.Function, engine: str | None = None, shared: Sequence[str] = ()
) -> Kernel:
    """Make a kernel of a CasADi SX function.

    engine: ``"c"``, ``"numpy"``, or None for the fastest that this machine has; shared: names of
    inputs that are the same for all samples.

    Raises a KernelError if there is no engine of that name, or "c" is asked for and cannot be had.
    """
    return make(from_casadi(function), engine, shared)


def make(program: Program, engine: str | None = None, shared: Sequence[str] = ()) -> Kernel:
    """Make a kernel of a program; see :func:`compile`.

    engine: "c", "numpy", or None for the faster one that this machine has; shared: arguments that
    have one value for all samples.
    """
    return Kernel(program, _choose(program, engine, shared), shared)


def _choose(program: Program, engine: str | None, shared: Sequence[str]) -> Engine:
    if engine not in (None, "c", "numpy"):
        raise KernelError(
            f"unknown engine {engine!r}", "Choose c or numpy, or None for the faster one"
        )
    if engine == "numpy":
        return NumpyEngine(program, shared)
    try:
        return CEngine(program, shared)
    except KernelError as error:
        if engine == "c":
            raise
        _say_once(str(error))
        return NumpyEngine(program, shared)


@functools.cache
def _say_once(reason: str) -> None:
    _LOG.warning("Kernels run in numpy, about ten times slower than compiled: %s", reason)
