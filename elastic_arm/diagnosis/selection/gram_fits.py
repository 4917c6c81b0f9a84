"""Least squares from Gram matrices, in which row and column 0 are those of the residual, and bases of columns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs, dpstrf

from elastic_arm.codegen.parallel import share_out

Array = NDArray[np.float64]
Index = NDArray[np.intp]

RANK = 1e-10  # relative eigenvalue below which a combination of columns is not determined; numerical
# Reciprocal condition from which a Cholesky factorisation gives what the eigenvectors give, and sooner; numerical.
DETERMINED = 1e-7
MANY = 32  # columns from which products of those alone that have begun are faster
ROUNDING = 1e-14  # of coefficients, times the condition of what they solve; numerical
HELD = (
    1e-9  # share of a column's squares beyond others below which these hold it, far below what is determined; numerical
)
NULL = 1e-13  # relative eigenvalue of a combination that is null but for rounding; numerical


def solution(gram: Array, free: NDArray[np.bool_]) -> Array:
    """Least squares for the free columns, the others with coefficient 1; row and column 0 are the residual's."""
    beta = np.ones(len(free))
    if free.any():
        if free.all():
            return _solve(gram[1:, 1:], gram[1:, 0])
        a, fixed = 1 + np.flatnonzero(free), 1 + np.flatnonzero(~free)
        beta[free] = _solve(block(gram, a, a), gram[a, 0] - block(gram, a, fixed).sum(axis=1))
    return beta


def block(gram: Array, rows: Index, columns: Index) -> Array:
    """Return the entries of some rows and columns of a Gram matrix, (p, q).

    Parameters
    ----------
    gram
        Of all columns.
    rows, columns
        (p,) and (q,) numbers.
    """
    return gram[rows[:, None], columns]


def first_row(columns: Array) -> int:
    """Return the number of the first row of whitened columns (rows, k) that is not null: products begin there."""
    return min(first_rows(columns).tolist(), default=0)


def first_rows(columns: Array) -> Index:
    """Return the number of the first row of each whitened column (rows, k) that is not null, (k,)."""
    return np.array([np.argmax(column != 0.0) for column in columns.T], dtype=int)


def products(left: Array, right: Array) -> Array:
    """Return left.T @ right (p, q) of whitened columns (rows, p) and (rows, q), each null before some residual.

    Where many columns begin at different residuals, most of what a single product multiplies is null. From each row at
    which columns begin up to the next one, only those are multiplied that have begun.
    """
    if right.shape[1] < MANY:
        begin = first_row(right)
        return np.asarray(left[begin:].T @ right[begin:])
    begin_left, begin_right = first_rows(left), first_rows(right)
    begins = np.unique(begin_right)

    def product(rows: tuple[int, int]) -> tuple[Index, Index, Array]:
        first, last = rows
        of_left, of_right = np.flatnonzero(begin_left < last), np.flatnonzero(begin_right <= first)
        acting = right[first:last, of_right]
        # A product of a matrix with itself takes half the time.
        others = acting if left is right else left[first:last, of_left]
        return of_right if left is right else of_left, of_right, others.T @ acting

    found = np.zeros((left.shape[1], right.shape[1]))
    for of_left, of_right, part in share_out(product, zip(begins, [*begins[1:], len(right)], strict=True)):
        found[of_left[:, None], of_right] += part
    return found


class FurtherColumns(NamedTuple):
    """Choices of as many further columns each, one choice at a time beside a base.

    Parameters
    ----------
    members
        (M,) numbers of these choices among all.
    columns
        (M, m) their columns.
    fixed
        (m,) which of these have the coefficient 1.
    bounds
        (2, M, m) between which values their coefficients must lie.
    """

    members: Index
    columns: Index
    fixed: NDArray[np.bool_]
    bounds: Array


class EachFit(NamedTuple):
    """Fits of a base together with each of M choices of further columns.

    Parameters
    ----------
    base, further
        (p, M) and (M, m) coefficients.
    base_errors, further_errors
        By how much another way of solving may find others; infinite where it may find any.
    """

    base: Array
    further: Array
    base_errors: Array
    further_errors: Array

    def outside(self, of_base: Array, of_further: Array) -> NDArray[np.bool_]:
        """Return which choices (M,) certainly have a coefficient that is not between its bounds.

        Parameters
        ----------
        of_base
            (2, p), lower and upper.
        of_further
            (2, M, m).
        """
        low, high = of_base[:, :, None]
        base = (self.base + self.base_errors <= low) | (self.base - self.base_errors >= high)
        low, high = of_further
        further = (self.further + self.further_errors <= low) | (self.further - self.further_errors >= high)
        return np.asarray(base.any(axis=0) | further.any(axis=1))


class BorderedFits:
    """Fits of a base together with further columns, by block elimination: the base is decomposed once.

    Parameters
    ----------
    gram
        Of all columns.
    index, free
        (p,) columns of the base, and which of them have a coefficient to fit; the others have 1.
    """

    def __init__(self, gram: Array, index: Index, free: NDArray[np.bool_]) -> None:
        self._gram, self._free = gram, free
        self._own, self._others = index[free], index[~free]
        scale, vectors, values = _spectrum(block(gram, self._own, self._own))
        kept = _kept(values)
        self._half = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
        self._plain = self._half.T @ (gram[self._own, 0] - block(gram, self._own, self._others).sum(axis=1))
        self._scale = scale
        # Combinations of the base that are null are so beside further columns, too.
        self._null = vectors[:, ~kept] / scale[:, None]
        largest = max(values, default=1.0)
        certain = not np.any(values[~kept] > NULL * largest)
        # The least relative eigenvalue of the rest.
        self._least = min(values[kept], default=1.0) / largest if certain else 0.0

    def with_each(self, columns: Index, fixed: NDArray[np.bool_]) -> EachFit:
        """Fit the base together with each of M choices.

        Parameters
        ----------
        columns
            (M, m) of the further choices.
        fixed
            (m,) which of these have the coefficient 1.
        """
        gram, half = self._gram, self._half
        count, width = columns.shape
        cross = block(gram, self._own, columns.ravel())
        along = (half.T @ cross).reshape(-1, count, width)
        square = gram[columns[:, :, None], columns[:, None, :]]
        squares = np.diagonal(square, axis1=1, axis2=2)
        null, size = squares == 0.0, np.sqrt(np.maximum(squares, 1e-300))
        # What the base leaves of the further columns, and of the residual in them; a null one has the coefficient zero.
        left = square - along.transpose(1, 2, 0) @ along.transpose(1, 0, 2)
        left += np.eye(width) * np.where(null, size**2, 0.0)[:, :, None]
        wanted = gram[columns, 0] - gram[columns[:, :, None], self._others].sum(axis=2)
        wanted -= np.tensordot(self._plain, along, axes=1)
        gamma, least = np.ones((count, width)), np.full(count, self._least)
        if not fixed.all():
            wanted = wanted[:, ~fixed] - left[:, ~fixed][:, :, fixed].sum(axis=2)
            gamma[:, ~fixed], shown = _solve_each(left[:, ~fixed][:, :, ~fixed], wanted, size[:, ~fixed])
            least *= shown
        beta = np.ones((len(self._free), count))
        beta[self._free] = fitted = half @ (self._plain[:, None] - (along * gamma).sum(axis=2))
        largest = np.abs(fitted * self._scale[:, None]).max(axis=0, initial=0.0)
        largest = np.maximum(largest, np.abs(gamma * size).max(axis=1, initial=0.0))
        mixed = np.abs(self._null.T @ cross).reshape(-1, count, width) / size
        unsure = (ROUNDING + mixed.sum(axis=(0, 2))) * largest / np.maximum(least, RANK)
        unsure = np.where(least > RANK, unsure, np.inf)
        error = np.zeros((len(self._free), count))
        error[self._free] = unsure / self._scale[:, None]
        further_error = np.zeros((count, width))
        further_error[:, ~fixed] = np.where(null, 0.0, unsure[:, None] / size)[:, ~fixed]
        return EachFit(beta, gamma, error, further_error)


def _solve_each(left: Array, wanted: Array, size: Array) -> tuple[Array, Array]:
    """Solve M systems (M, m, m) for (M, m), what is not determined in units of `size` (M, m) set to nothing.

    Beside it the least eigenvalue (M,) in these units.
    """
    if left.shape[1] == 1:
        share = left[:, 0, 0] / size[:, 0] ** 2
        shown = share > RANK
        return np.where(shown, wanted[:, 0] / np.where(shown, left[:, 0, 0], 1.0), 0.0)[:, None], share
    spectrum, basis = np.linalg.eigh(left / (size[:, :, None] * size[:, None, :]))
    inverse = np.where(spectrum > RANK, 1.0 / np.where(spectrum > RANK, spectrum, 1.0), 0.0)
    part = inverse[:, :, None] * (basis.transpose(0, 2, 1) @ (wanted / size)[:, :, None])
    return np.asarray((basis @ part)[:, :, 0] / size), spectrum[:, 0]


def gained_each(gram: Array, index: Index, columns: Index, beta: Array, gamma: Array) -> Array:
    """Return the log-likelihood (M,) that each choice gains on the data of a Gram matrix, nats.

    Parameters
    ----------
    gram
        Of all columns.
    index
        (p,) columns of the base.
    columns
        (M, m) of the further choices.
    beta, gamma
        (p, M) and (M, m) coefficients.
    """
    cross = block(gram, index, columns.ravel()).reshape(len(index), *columns.shape)
    of_base = gram[index, 0] @ beta - 0.5 * np.sum(beta * (block(gram, index, index) @ beta), axis=0)
    target = gram[columns, 0] - np.sum(beta[:, :, None] * cross, axis=0)
    square = gram[columns[:, :, None], columns[:, None, :]]
    return np.asarray(of_base + np.sum(gamma * (target - 0.5 * (square @ gamma[:, :, None])[:, :, 0]), axis=1))


def _spectrum(gram: Array) -> tuple[Array, Array, Array]:
    """Return scales of the columns of a Gram matrix, and eigenvectors and eigenvalues of the matrix without them."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    return scale, vectors, values


def _kept(values: Array) -> NDArray[np.bool_]:
    """Return which eigenvalues, the largest of which comes last, are those of determined combinations."""
    return values > RANK * values[-1] if len(values) else np.zeros(0, dtype=bool)


def _solve(gram: Array, target: Array) -> Array:
    """Least squares from a Gram matrix, what it does not determine set to nothing."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / (size[:, None] * size)
    factor, failed = dpotrf(scaled, lower=1)
    if not failed and dpocon(factor, np.abs(scaled).sum(axis=0).max(), uplo="L")[0] > DETERMINED:
        return np.asarray(dpotrs(factor, target / size, lower=1)[0] / size)
    scale, vectors, values = _spectrum(gram)
    kept = _kept(values)
    vectors, values = vectors[:, kept], values[kept]
    return vectors @ ((vectors.T @ (target / scale)) / values) / scale


def orthonormal_basis(columns: Array, tolerance: float) -> Array:
    """Return an orthonormal basis (rows, m) of columns (rows, k); those that are null or repeated add nothing to it.

    By products of the columns, twice (Cholesky QR; Yamamoto et al. 2015), which takes a fraction of the time of
    Householder reflections.

    Parameters
    ----------
    columns
        Of any length.
    tolerance
        Singular value of the columns of length one, relative to the largest, below which a combination is not
        determined; 1e-6 or more, as products square it.
    """
    own = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(own.T @ own)
    keep = values > tolerance**2 * values[-1] if len(values) else np.zeros(0, dtype=bool)
    basis = own @ (vectors[:, keep] / np.sqrt(values[keep]))
    # Rounding of the products shows in combinations that are hardly determined: once more.
    return np.asarray(basis @ np.linalg.inv(np.linalg.cholesky(basis.T @ basis)).T)


def independent_columns(gram: Array, tolerance: float) -> tuple[Index, Array, Array]:
    """Return an orthonormal basis of columns by those among them that hold the others.

    By Cholesky factorisation with pivots (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 10.3),
    and eigenvectors of what it leaves, which is smaller than all columns.

    Parameters
    ----------
    gram
        (k, k) of columns of length one.
    tolerance
        Relative eigenvalue of it below which a combination of columns is not determined.

    Returns
    -------
    chosen : (r,)
        Numbers of independent columns, in order.
    triangle : (r, r)
        Cholesky factor of their products: it makes them orthonormal in this order.
    lost : (r, m)
        Orthonormal combinations of these that are not determined.
    """
    _, pivots, rank, _ = dpstrf(gram, tol=HELD, lower=1)
    chosen = np.sort(np.asarray(pivots[:rank], dtype=np.intp) - 1)
    triangle = np.asarray(np.linalg.cholesky(block(gram, chosen, chosen)), dtype=float)
    held = solve_triangular(triangle, gram[chosen], lower=True)
    values, vectors = np.linalg.eigh(held @ held.T)
    return chosen, triangle, np.asarray(vectors[:, values <= tolerance * max(values, default=0.0)], dtype=float)


def regularised(gram: Array, target: Array, rank: float) -> tuple[Array, Array]:
    """Return the solution (k,) of normal equations, and the roots of the diagonal of their inverse.

    Parameters
    ----------
    gram, target
        (k, k) and (k,), with priors.
    rank
        Relative eigenvalue below which a combination of columns is not determined.
    """
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=rank, hermitian=True)
    return inverse @ (target / scale) / scale, np.sqrt(np.maximum(np.diag(inverse), 0.0)) / scale
