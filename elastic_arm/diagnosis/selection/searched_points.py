"""Values of nonlinear parameters whose columns stand for those of all values nearby."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


def monomials(points: Array) -> Array:
    """Return all monomials (M, m) up to the second degree of k numbers (M, k): one, the numbers, their products."""
    first, second = np.triu_indices(points.shape[1])
    return np.hstack([np.ones((len(points), 1)), points, points[:, first] * points[:, second]])


def quadratic_points(k: int) -> Array:
    """Return points (m, k) at which a polynomial of second degree in k numbers is determined."""
    one = np.eye(k)
    pairs = [one[i] + one[j] for i in range(k) for j in range(i)]
    return np.concatenate([np.zeros((1, k)), one, -one, np.reshape(pairs, (-1, k))])


def neighbourhood(feature: Feature, share: float) -> Array:
    """Return points (2 k + 1, k) around the middle of the ranges of k searched numbers."""
    components = [p for p in feature.searched for _ in range(p.size)]
    middle = np.array([(p.low + p.high) / 2 for p in components])
    reach = np.diag([share * (p.high - p.low) / 2 for p in components])
    return np.concatenate([middle[None], middle + reach, middle - reach])
