"""The checksum of chunks, by the processor's carry-less multiplication where that is worth a compiled library."""

from __future__ import annotations

import ctypes
import functools
import zlib
from collections.abc import Callable
from importlib import resources

import numpy as np

from elastic_arm.codegen.compiler import build, processor
from elastic_arm.errors import KernelError
from elastic_arm.recording.spans import Bytes

# Of fewer bytes zlib has the checksum before the library is loaded.
_WORTH_LOADING = 1 << 24
_BLOCK = 64
_FROM_ZERO = 0xFFFFFFFF  # the value from which zlib goes on with a register of zeros


def crc32_for(size: int) -> Callable[[Bytes], int]:
    """Return the function, bytes to CRC-32, that is fastest where it is to be taken of `size` bytes in all."""
    return _folding_crc32() if size >= _WORTH_LOADING else _crc32_by_zlib


def _crc32_by_zlib(data: Bytes) -> int:
    return zlib.crc32(data.data)


@functools.cache
def _folding_crc32() -> Callable[[Bytes], int]:
    # Elsewhere every compiler refuses the source, and every process would ask it again.
    if "pclmulqdq" not in processor():
        return _crc32_by_zlib
    source = (resources.files("elastic_arm.recording.storage") / "crc32.c").read_text(encoding="utf-8")
    try:
        library = build(source)
    except KernelError:
        return _crc32_by_zlib
    library.fold.argtypes = [ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p]
    library.fold.restype = None

    def crc32(data: Bytes) -> int:
        """Fold what fills blocks to 16 bytes, and leave these and the rest to zlib."""
        blocks = len(data) // _BLOCK
        if not blocks:
            return _crc32_by_zlib(data)
        left = np.empty(16, np.uint8)
        library.fold(data.ctypes.data, blocks, left.ctypes.data)
        return zlib.crc32(data[blocks * _BLOCK :].data, zlib.crc32(left.data, _FROM_ZERO))

    return crc32
