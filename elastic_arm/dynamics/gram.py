"""Information matrices of a regressor, row by row, beyond the working precision, without ever
storing the regressor.

Squaring a regressor squares its condition number; products to some 77 bits of the columns' norms,
added up in twice the working precision, make up for that: the result is as good as that of an
orthogonal triangularisation. Each equation (row r of Phi) keeps its own matrix [Phi_r, y_r]T
[Phi_r, y_r], so that it can be weighted by its own noise afterwards, and only the columns that are
not structurally null enter.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from elastic_arm.codegen.kernels import Kernel
from elastic_arm.dynamics.double_double import Pair, add

_CHUNK = 1024
# Samples whose regressor is stored at a time where there is no compiler.
_STORED = 8 * _CHUNK
# Slices of 21 bits: products of two, summed over a chunk of 2^10, fit a double's 53 bits without
# rounding.
_SLICE_BITS = 21
_SLICES = 4


class Information:
    """Sum over samples of [Phi_r, y_r]T [Phi_r, y_r] for every row r of a regressor.

    kernel: whose first output is Phi (rows, P); further outputs are ignored; rounded: whether
    entries may be rounded to 51 bits below the largest of their column. That changes Phi by no more
    than its own rounding, and is nearly twice as fast where the processor has 52-bit
    multiplications; it is no sum of *these* products to 77 bits any more, but the exact one of a
    matrix that close.

    Attributes
    ----------
    rows, columns
        Number of equations and P.
    samples
        Added so far.
    """

    def __init__(self, kernel: Kernel, *, rounded: bool = False) -> None:
        out = kernel.program.outputs[0]
        self.rows, self.columns = out.shape
        self.samples = 0
        self._kernel = kernel
        self._rounded = rounded
        row, column = np.divmod(out.places, self.columns)
        self._support = [np.append(column[row == r], self.columns) for r in range(self.rows)]
        self._places = np.concatenate(
            [_places(r, support) for r, support in enumerate(self._support)], axis=1
        )
        self._hi, self._lo = np.zeros((2, self._places.shape[1]))

    def add(self, *arrays: np.ndarray, y: np.ndarray) -> None:
        """Add samples.

        Raises a ValueError if shapes or numbers of samples disagree.
        """
        ready, samples = self._kernel.check(arrays)
        measured = np.ascontiguousarray(y, dtype=float)
        if measured.shape != (samples, self.rows):
            raise ValueError(f"y has shape {measured.shape}, but must be {(samples, self.rows)}")
        lanes = self._kernel.row_products(ready, measured, len(self._hi), rounded=self._rounded)
        parts = (
            self._sum_numpy(arrays, measured)
            if lanes is None
            else [_sum_lanes(functools.reduce(add, lanes))]
        )
        self._hi, self._lo = functools.reduce(add, parts, (self._hi, self._lo))
        self.samples += samples

    def merge(self, other: Information) -> None:
        """Add what another accumulation of the same regressor has summed."""
        if not np.array_equal(other._places, self._places):
            raise ValueError("the two accumulations belong to different regressors")
        self._hi, self._lo = add((self._hi, self._lo), (other._hi, other._lo))
        self.samples += other.samples

    def reset(self) -> None:
        """Forget all samples."""
        self._hi, self._lo = np.zeros_like(self._hi), np.zeros_like(self._lo)
        self.samples = 0

    def grams(self) -> Pair:
        """Return hi, lo (rows, P + 1, P + 1): the matrices are hi + lo.

        |lo| is below a unit of hi; y comes last.
        """
        hi, lo = np.zeros((2, self.rows, self.columns + 1, self.columns + 1))
        row, i, j = self._places
        for target, packed in ((hi, self._hi), (lo, self._lo)):
            target[row, i, j] = target[row, j, i] = packed
        return hi, lo

    def _sum_numpy(self, arrays: Sequence[np.ndarray], y: np.ndarray) -> list[Pair]:
        shared = [name in self._kernel.shared for name, _ in self._kernel.program.inputs]
        sums = []
        for start in range(0, len(y), _STORED):
            part = slice(start, start + _STORED)
            result = self._kernel(
                *(a if s else a[part] for a, s in zip(arrays, shared, strict=True))
            )
            Phi = result[0] if isinstance(result, tuple) else result
            Phi = Phi.reshape(-1, self.rows, self.columns)
            hi = []
            lo = []
            for r, support in enumerate(self._support):
                whole, rest = gram(np.column_stack([Phi[:, r, support[:-1]], y[part, r]]))
                index = np.tril_indices(len(support))
                hi.append(whole[index])
                lo.append(rest[index])
            sums.append((np.concatenate(hi), np.concatenate(lo)))
        return sums


def _places(row: int, support: np.ndarray) -> np.ndarray:
    """Return row, i, j (3, entries) of the lower triangle of a row's matrix, as it is packed."""
    a, b = _triangle(len(support))
    return np.stack([np.full(len(a), row), support[a], support[b]])


@functools.cache
def _triangle(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of a lower triangle."""
    a, b = np.tril_indices(size)
    return a, b


def gram(matrix: np.ndarray) -> Pair:
    """Return hi, lo with hi + lo = AT A of `matrix` A (N, k).

    To more than 80 bits of the columns' norms.

    Every column is cut into slices whose products sum without rounding, which ordinary matrix
    products then do (K. Ozaki, T. Ogita, S. Oishi, S. M. Rump, Error-free transformations of matrix
    multiplication, 2012).
    """
    k = matrix.shape[1]
    hi = np.zeros((k, k))
    lo = np.zeros((k, k))
    for start in range(0, len(matrix), _CHUNK):
        slices = _cut(matrix[start : start + _CHUNK])
        for i in reversed(range(_SLICES)):
            for j in range(min(_SLICES, _SLICES + 1 - i)):
                hi, lo = add((hi, lo), (slices[i].T @ slices[j], np.zeros((k, k))))
    return hi, lo


def _cut(matrix: np.ndarray) -> list[np.ndarray]:
    """Cut columns into slices, each a multiple of its own power of two with at most 21 bits; they
    sum to the matrix."""
    scale = np.ldexp(1.0, np.frexp(np.abs(matrix).max(axis=0, initial=0.0))[1])
    slices = []
    rest = matrix
    for k in range(_SLICES):
        unit = scale * 2.0 ** (-_SLICE_BITS * (k + 1))
        part = np.rint(rest / unit) * unit
        slices.append(part)
        rest = rest - part
    return slices


def _sum_lanes(part: Pair) -> Pair:
    """Add up the lanes of hi, lo (entries, lanes)."""
    hi, lo = part
    while hi.shape[1] > 1:
        half = hi.shape[1] // 2
        hi, lo = add((hi[:, :half], lo[:, :half]), (hi[:, half:], lo[:, half:]))
    return hi[:, 0], lo[:, 0]
