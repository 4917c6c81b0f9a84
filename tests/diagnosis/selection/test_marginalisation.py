"""Nuisance parameters in closed form, held against the Gaussian distribution that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from elastic_arm.diagnosis.selection.marginalisation import Marginalisation, NuisanceColumns

ROWS, K = 60, 3
RNG = np.random.default_rng(5)
N = tuple(RNG.standard_normal((ROWS, K)) * [3.0, 0.3, 1e-3] for _ in range(2))
X = tuple(RNG.standard_normal((ROWS, 3)) for _ in range(2))
CENTRE = np.array([0.5, -1.0, 2.0])


def marginalisation() -> tuple[Marginalisation, list[np.ndarray]]:
    """Columns of two data sets, the first the residual, and their Gram matrices."""
    found = Marginalisation(NuisanceColumns((N[0], N[1]), (), CENTRE, np.full(K, np.inf), ("a", "b", "c")))
    for which in (0, 1):
        found.add(which, X[which])
    first, second = (x.T @ x for x in X)
    return found, [gram - held for gram, held in zip((first, second, first + second), found.held(0), strict=True)]


def log_likelihood(rows: np.ndarray, nuisance: np.ndarray, beta: np.ndarray) -> float:
    """Of residuals less columns with coefficients, the nuisance parameters integrated out."""
    left = rows[:, 0] - rows[:, 1:] @ beta
    covariance = np.eye(len(rows)) + nuisance @ nuisance.T
    return float(multivariate_normal.logpdf(left, nuisance @ CENTRE, covariance))


@pytest.mark.parametrize("which", [0, 1, 2])
def test_likelihoods_of_hypotheses_differ_as_with_the_nuisance_integrated_out(which: int) -> None:
    """The marginalised Gram matrix gives differences of exact marginal log-likelihoods, on either set and on both."""
    gram = marginalisation()[1][which]
    rows, nuisance = (X[which], N[which]) if which < 2 else (np.vstack(X), np.vstack(N))
    values = []
    for beta in (np.zeros(2), np.array([0.7, -0.4])):
        values.append((log_likelihood(rows, nuisance, beta), beta @ gram[1:, 0] - 0.5 * beta @ gram[1:, 1:] @ beta))
    assert values[1][0] - values[0][0] == pytest.approx(values[1][1] - values[0][1], rel=1e-9)


def test_rows_have_the_products_of_the_marginalised_gram_matrix() -> None:
    """What a nonlinear fit works on is the same likelihood."""
    found, grams = marginalisation()
    rows = np.hstack([found.rows(X[0][:, :1], residual=True), found.rows(X[0][:, 1:])])
    assert rows.T @ rows == pytest.approx(grams[0] + _prior_of_residual(), rel=1e-9, abs=1e-9)


def _prior_of_residual() -> np.ndarray:
    """The squares of the prior means, which no comparison sees: they are in the residual's own product alone."""
    found = np.zeros((3, 3))
    found[0, 0] = CENTRE @ CENTRE
    return found


def test_the_posterior_is_that_of_ridge_regression() -> None:
    """Means and standard deviations beside free columns are those of least squares with one row a prior."""
    found, _ = marginalisation()
    raw = sum(x.T @ x for x in X)
    tall = np.vstack([np.hstack([np.vstack(N), np.vstack(X)[:, 1:]]), np.hstack([np.eye(K), np.zeros((K, 2))])])
    target = np.append(np.vstack(X)[:, 0], CENTRE)
    solution = np.linalg.lstsq(tall, target, rcond=None)[0]
    means, stds = found.joint_posterior(raw, np.array([1, 2]), np.array([], dtype=int), 1.0)
    assert means == pytest.approx(solution[:K], rel=1e-7)
    assert stds == pytest.approx(np.sqrt(np.diag(np.linalg.inv(tall.T @ tall))[:K]), rel=1e-7)


def test_an_impossible_drive_is_refused_at_the_joints_of_the_causes_alone() -> None:
    """A hypothesis that needs a drive without torque is not possible where its own joints need it."""
    limits = np.array([1.0, np.inf, np.inf])
    columns = NuisanceColumns((N[0], N[1]), (), np.zeros(K), limits, ("joint_1", "joint_2", "joint_3"))
    values = np.array([2.0, 50.0, 50.0])
    assert not columns.possible(values, {"joint_1"})
    assert columns.possible(values, {"joint_2", None})
