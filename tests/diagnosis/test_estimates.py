"""Sizes of causes: what the posterior says within the bounds of physics."""

import numpy as np

from elastic_arm.diagnosis.estimates import within


def test_a_size_stays_within_its_bounds_and_takes_others_along() -> None:
    """Mean and covariance are those of the draws of a Gaussian that lie within the bound, to 3 % of
    a deviation."""
    x, S = np.array([-2.4, 1.0]), np.array([[0.25, 0.1], [0.1, 0.09]])
    draws = np.random.default_rng(0).multivariate_normal(x, S, size=400_000)
    draws = draws[draws[:, 0] > -2.0]
    mean, covariance = within(x, S, np.array([-2.0, -np.inf]), np.full(2, np.inf))
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.004)
    assert mean[0] > -2.0
