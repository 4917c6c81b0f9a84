"""Bases of columns by those among them that hold the others."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from elastic_arm.diagnosis.selection.gram_fits import independent_columns

TOLERANCE = 1e-6


def test_a_basis_by_independent_columns_holds_what_eigenvectors_of_all_columns_hold():
    """Repeated, null and hardly determined columns add nothing: leverage and fit are those of all columns."""
    rng = np.random.default_rng(0)
    own = rng.normal(size=(200, 12))
    columns = np.hstack([own, own[:, :5] @ rng.normal(size=(5, 7)), np.zeros((200, 1)), own[:, :1]])
    columns[:, 13] += 1e-5 * rng.normal(size=200)
    columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    y, gram = rng.normal(size=200), columns.T @ columns
    values, vectors = np.linalg.eigh(gram)
    basis = columns @ (vectors[:, values > TOLERANCE * values[-1]] / np.sqrt(values[values > TOLERANCE * values[-1]]))
    chosen, triangle, lost = independent_columns(gram, TOLERANCE)
    along = solve_triangular(triangle, columns[:, chosen].T, lower=True)
    leverage = np.square(along).sum(axis=0) - np.square(lost.T @ along).sum(axis=0)
    beta = solve_triangular(triangle, columns[:, chosen].T @ y, lower=True)
    np.testing.assert_allclose(leverage, np.square(basis).sum(axis=1), atol=1e-6)
    np.testing.assert_allclose((beta - lost @ (lost.T @ beta)) @ along, basis @ (basis.T @ y), atol=1e-6)
