"""Programs run by compiled C, eight samples side by side, chunks of samples on all cores."""

import ctypes
from collections.abc import Sequence

import numpy as np

from elastic_arm.codegen.compiler import build_once
from elastic_arm.codegen.emit_block import block_identity, emit_block
from elastic_arm.codegen.parallel import in_chunks
from elastic_arm.codegen.program import Program

# Outputs larger than the caches are written past them.
_PAST_CACHES_BYTES = 1 << 21
# The C library takes memory this large from the system, which clears it: of zeros, only the others
# need writing.
_CLEARED_BYTES = 1 << 25
_LINE_BYTES = 64
# What is written past them in one go at least.
_STREAMED_BYTES = 16
# How outputs are written, as block.c names it.
_COPY, _PAST_CACHES, _ONTO_ZEROS = range(3)
_ARRAY = ctypes.c_void_p


class CEngine:
    """Runs a program over arrays of samples.

    Raises a KernelError if there is no compiler, or it fails.
    """

    name = "c"

    def __init__(self, program: Program, shared: Sequence[str]) -> None:
        self.library = build_once(
            block_identity(program, shared), lambda: emit_block(program, shared)
        )
        self.library.dense.argtypes = [ctypes.c_long, _ARRAY, _ARRAY, _ARRAY, ctypes.c_int]
        self.library.prepare_shared.argtypes = [_ARRAY, _ARRAY]
        self.library.prepared_size.restype = ctypes.c_long
        self._is_shared = [name in set(shared) for name, _ in program.inputs]

    def run(
        self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray], *, fresh: bool
    ) -> None:
        """Fill `outputs` (N, size) from `arrays`: (N, k), or (k,) where shared.

        `fresh` outputs are just allocated.

        arrays: (N, k) values of each argument; (k,) where it is shared by all samples; outputs: (N,
        size) each, to be filled.
        """
        prepared = self.prepare(arrays)
        way = _way(outputs, fresh)

        def chunk(start: int, stop: int) -> None:
            into = pointers([out[start:stop] for out in outputs])
            if self.library.dense(
                stop - start, self.inputs(arrays, start), prepared.ctypes.data, into, way
            ):
                raise MemoryError("no memory for a block of samples")

        in_chunks(len(outputs[0]), chunk)

    @staticmethod
    def allocate(samples: int, size: int) -> np.ndarray:
        """Memory (samples, size) from a cache line on.

        Zeros where it is cleared anyhow, else uninitialised.
        """
        make = np.zeros if samples * size * 8 >= _CLEARED_BYTES else np.empty
        memory = make(samples * size + 8)
        skip = (-memory.ctypes.data % _LINE_BYTES) // 8
        return memory[skip : skip + samples * size].reshape(samples, size)

    def prepare(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return what no sample changes, computed once."""
        prepared = np.empty(max(self.library.prepared_size(), 1))
        self.library.prepare_shared(self.inputs(arrays, 0), prepared.ctypes.data)
        return prepared

    def inputs(self, arrays: Sequence[np.ndarray], start: int) -> ctypes.Array[ctypes.c_void_p]:
        """Pointers to the inputs from sample `start` on."""
        return pointers(
            [
                array if shared else array[start:]
                for array, shared in zip(arrays, self._is_shared, strict=True)
            ]
        )


def _way(outputs: Sequence[np.ndarray], fresh: bool) -> int:
    if fresh and all(out.nbytes >= _CLEARED_BYTES for out in outputs):
        return _ONTO_ZEROS
    aligned = all(out.ctypes.data % _STREAMED_BYTES == 0 for out in outputs)
    return (
        _PAST_CACHES
        if aligned and sum(out.nbytes for out in outputs) > _PAST_CACHES_BYTES
        else _COPY
    )


def pointers(arrays: Sequence[np.ndarray]) -> ctypes.Array[ctypes.c_void_p]:
    """C array of the arrays' addresses."""
    return (ctypes.c_void_p * max(len(arrays), 1))(*(array.ctypes.data for array in arrays))
