"""Numbers in twice the working precision: sums of them, and triangular factors of Gram matrices
made of them.

A Gram matrix squares the condition number; carried beyond the working precision, its Cholesky
factor is as good as that of an orthogonal triangularisation of the rows themselves. Numbers are
pairs hi + lo (T. Dekker, Numerische Mathematik 18 (1971) 224).
"""

import ctypes
import functools
from collections.abc import Callable
from importlib import resources

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.compiler import build
from elastic_arm.errors import KernelError

Pair = tuple[Array, Array]

# A pivot below this share of its column's square is nothing but the rounding of its products
# (2^-76).
NOTHING = 1e-22
_SPLITTER = 2.0**27 + 1.0
# Sums and products stay as they are written, on as many numbers side by side as the processor
# takes.
_FLAGS = ("-ffp-contract=off", "-O3")


def add(a: Pair, b: Pair) -> Pair:
    """Return the sum."""
    total = a[0] + b[0]
    part = total - a[0]
    return _renormalised(total, (a[0] - (total - part)) + (b[0] - part) + (a[1] + b[1]))


def multiply(a: Pair, b: Pair) -> Pair:
    """Return the product."""
    product, error = _exact_product(a[0], b[0])
    return _renormalised(product, error + (a[0] * b[1] + a[1] * b[0]))


def divide(a: Pair, b: Pair) -> Pair:
    """Return the quotient."""
    first = a[0] / b[0]
    product, error = _exact_product(first, b[0])
    rest = (a[0] - product) - error + a[1] - first * b[1]
    return _renormalised(first, rest / b[0])


def cholesky(gram: Pair) -> Array:
    """Return the triangular factor R with R'R = hi + lo, rounded to working precision.

    gram: hi, lo (..., k, k), positive semidefinite.

    Returns (..., k, k) upper triangular; a column that is a combination of those before it has a
    zero pivot and a zero row.
    """
    hi, lo = (np.array(part, dtype=float, order="C") for part in gram)
    compiled = _compiled()
    if compiled is None:
        return _cholesky_by_numpy(hi, lo)
    k = hi.shape[-1]
    R = np.zeros_like(hi)
    compiled(hi.size // max(k * k, 1), k, NOTHING, *(array.ctypes.data for array in (hi, lo, R)))
    return R


@functools.cache
def _compiled() -> Callable[..., None] | None:
    """Return the loop in C, where there is a compiler: NumPy's calls for each column take twenty
    times as long."""
    source = (resources.files("elastic_arm.dynamics") / "cholesky.c").read_text(encoding="utf-8")
    try:
        function = build(source, flags=_FLAGS).cholesky
    except KernelError:
        return None
    function.argtypes = [ctypes.c_long, ctypes.c_int, ctypes.c_double, *[ctypes.c_void_p] * 3]
    function.restype = None
    return function


def _cholesky_by_numpy(hi: Array, lo: Array) -> Array:
    """Return the factors of hi + lo, which are used up."""
    k = hi.shape[-1]
    size = np.einsum("...ii->...i", hi).copy()
    R = np.zeros_like(hi)
    for i in range(k):
        real = hi[..., i, i] > NOTHING * size[..., i]
        pivot = (
            np.where(real, hi[..., i, i], 1.0)[..., None],
            np.where(real, lo[..., i, i], 0.0)[..., None],
        )
        R[..., i, i:] = hi[..., i, i:] * (real[..., None] / np.sqrt(pivot[0]))
        row = hi[..., i, i + 1 :] * real[..., None], lo[..., i, i + 1 :] * real[..., None]
        share = divide(row, pivot)
        products = multiply(
            (-share[0][..., None], -share[1][..., None]),
            (row[0][..., None, :], row[1][..., None, :]),
        )
        rest = add((hi[..., i + 1 :, i + 1 :], lo[..., i + 1 :, i + 1 :]), products)
        hi[..., i + 1 :, i + 1 :], lo[..., i + 1 :, i + 1 :] = rest
    return R


def _exact_product(a: Array, b: Array) -> Pair:
    product = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _split(a: Array) -> Pair:
    scaled = _SPLITTER * a
    high = scaled - (scaled - a)
    return high, a - high


def _renormalised(hi: Array, lo: Array) -> Pair:
    total = hi + lo
    return total, lo - (total - hi)
