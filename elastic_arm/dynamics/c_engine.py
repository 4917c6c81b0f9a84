"""Programs run by compiled C, eight samples side by side, chunks of samples on all cores."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from elastic_arm.dynamics.compiler import build_once
from elastic_arm.dynamics.emit_block import block_identity, emit_block
from elastic_arm.dynamics.parallel import in_chunks
from elastic_arm.dynamics.program import Program

# Outputs larger than the caches are written past them.
_PAST_CACHES_BYTES = 1 << 21
_ARRAY = ctypes.c_void_p


class CEngine:
    """Runs a program over arrays of samples.

    Raises
    ------
    KernelError
        If there is no compiler, or it fails.
    """

    name = "c"

    def __init__(self, program: Program, shared: Sequence[str]) -> None:
        self._program = program
        self.library = build_once(block_identity(program, shared), lambda: emit_block(program, shared))
        self.library.dense.argtypes = [ctypes.c_long, _ARRAY, _ARRAY, _ARRAY, ctypes.c_int]
        self.library.prepare_shared.argtypes = [_ARRAY, _ARRAY]
        self.library.prepared_size.restype = ctypes.c_long
        self._is_shared = [name in set(shared) for name, _ in program.inputs]

    def run(self, arrays: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> None:
        """Fill `outputs` (N, size), whose memory is 64-byte aligned, from `arrays`: (N, k), or (k,) where shared."""
        prepared = self.prepare(arrays)
        samples = len(outputs[0])

        def chunk(start: int, stop: int) -> None:
            into = pointers([out[start:stop] for out in outputs])
            past_caches = sum(out.nbytes for out in outputs) > _PAST_CACHES_BYTES
            short = self.library.dense(
                stop - start, self.inputs(arrays, start), prepared.ctypes.data, into, int(past_caches)
            )
            if short:
                raise MemoryError("no memory for a block of samples")

        in_chunks(samples, chunk)

    @staticmethod
    def allocate(samples: int, size: int) -> np.ndarray:
        """Uninitialised memory (samples, size) that starts on a cache line."""
        memory = np.empty(samples * size + 8)
        skip = (-memory.ctypes.data % 64) // 8
        return memory[skip : skip + samples * size].reshape(samples, size)

    def prepare(self, arrays: Sequence[np.ndarray]) -> np.ndarray:
        """Return what no sample changes, computed once."""
        prepared = np.empty(max(self.library.prepared_size(), 1))
        self.library.prepare_shared(self.inputs(arrays, 0), prepared.ctypes.data)
        return prepared

    def inputs(self, arrays: Sequence[np.ndarray], start: int) -> ctypes.Array[ctypes.c_void_p]:
        """Pointers to the inputs from sample `start` on."""
        return pointers(
            [array if shared else array[start:] for array, shared in zip(arrays, self._is_shared, strict=True)]
        )


def pointers(arrays: Sequence[np.ndarray]) -> ctypes.Array[ctypes.c_void_p]:
    """C array of the arrays' addresses."""
    return (ctypes.c_void_p * max(len(arrays), 1))(*(array.ctypes.data for array in arrays))
