"""Least squares from Gram matrices, in which row and column 0 are those of the residual."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

RANK = 1e-10  # relative eigenvalue below which a combination of columns is not determined; numerical


def solution(gram: Array, free: NDArray[np.bool_]) -> Array:
    """Least squares for the free columns, the others with coefficient 1; row and column 0 are the residual's."""
    beta = np.ones(len(free))
    if free.any():
        a, fixed = 1 + np.flatnonzero(free), 1 + np.flatnonzero(~free)
        beta[free] = _solve(gram[np.ix_(a, a)], gram[a, 0] - gram[np.ix_(a, fixed)].sum(axis=1))
    return beta


def bordered(gram: Array, index: Index, free: NDArray[np.bool_], columns: Index, *, fixed: bool) -> tuple[Array, Array]:
    """Fit a base together with each of M further choices, by block elimination: the base is decomposed once.

    Parameters
    ----------
    gram
        Of all columns.
    index, free
        (p,) columns of the base, and which of them have a coefficient to fit; the others have 1.
    columns
        (M, m) of the further choices.
    fixed
        Whether these have the coefficient 1.

    Returns
    -------
    (p, M) coefficients of the base, (M, m) of the further columns.
    """
    own, others = index[free], index[~free]
    beta = np.ones((len(index), len(columns)))
    target = gram[own, 0] - gram[np.ix_(own, others)].sum(axis=1)
    cross = gram[own[:, None, None], columns[None]]
    scale, vectors, values = _decomposed(gram[np.ix_(own, own)])

    def solved(right: Array) -> Array:
        shape = (len(own), *[1] * (right.ndim - 1))
        part = np.tensordot(vectors.T, right / scale.reshape(shape), axes=1) / values.reshape(-1, *shape[1:])
        return np.asarray(np.tensordot(vectors, part, axes=1) / scale.reshape(shape))

    plain, along = solved(target), solved(cross)
    if fixed:
        gamma = np.ones(columns.shape)
    else:
        square = gram[columns[:, :, None], columns[:, None, :]]
        left = square - np.einsum("pMm,pMk->Mmk", cross, along)
        wanted = gram[columns, 0] - gram[columns[:, :, None], others].sum(axis=2) - np.einsum("pMm,p->Mm", cross, plain)
        size = np.sqrt(np.maximum(np.einsum("Mmm->Mm", square), 1e-300))
        spectrum, basis = np.linalg.eigh(left / (size[:, :, None] * size[:, None, :]))
        inverse = np.where(spectrum > RANK, 1.0 / np.where(spectrum > RANK, spectrum, 1.0), 0.0)
        part = np.einsum("Mkj,Mk->Mj", basis, wanted / size) * inverse
        gamma = np.einsum("Mkj,Mj->Mk", basis, part) / size
    beta[free] = plain[:, None] - np.einsum("pMm,Mm->pM", along, gamma)
    return beta, gamma


def _decomposed(gram: Array) -> tuple[Array, Array, Array]:
    """Return scales, eigenvectors and eigenvalues of the part of a Gram matrix that is determined."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = values > RANK * values[-1] if len(values) else np.zeros(0, dtype=bool)
    return scale, vectors[:, keep], values[keep]


def _solve(gram: Array, target: Array) -> Array:
    """Least squares from a Gram matrix, what it does not determine set to nothing."""
    scale, vectors, values = _decomposed(gram)
    return vectors @ ((vectors.T @ (target / scale)) / values) / scale
