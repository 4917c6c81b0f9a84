"""The probability that a link with these inertial numbers can exist.

    J(x) = J_0 + sum_k x_k J_k                                pseudo-inertia (4, 4) of the link
    d² = min over J(x') >= 0 of (x' - x)' S^-1 (x' - x)
    ln p(J >= 0) ~ ln 2 Phi(-d)

x and S are the posterior mean and covariance of the link's numbers. A body exists if and only if
its pseudo-inertia is positive semidefinite (Wensing, Kim and Slotine, RA-L 2018). The recordings
determine only combinations of the numbers, so the distance d to the nearest possible body decides,
not x itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from scipy.optimize import least_squares
from scipy.special import log_ndtr

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import pseudo_inertia

ROWS, COLUMNS = np.tril_indices(4)
# (10, 4, 4) derivatives of a lower triangular matrix by its entries
ENTRIES = np.zeros((10, 4, 4))
ENTRIES[np.arange(10), ROWS, COLUMNS] = 1.0
THINNEST = 1e-6  # smallest moment over the largest one of the description; numerical
FIRST = 0.01  # smallest moment over the largest one at the start of the search for the nearest body
SMALLEST = 1e-9  # smallest variance over the largest one; numerical


@dataclass(frozen=True, eq=False)
class Body:
    """The pseudo-inertia of a link as a function of its ten numbers."""

    described: Array  # (4, 4), at the description
    along: Array  # (10, 4, 4), change by a standard deviation of each number's prior

    @classmethod
    def of(cls, described: Array, changed: Array, step: float) -> Self:
        """Return the body from inertial parameters: as described (10,), and with each number
        changed by a step, (10, 10)."""
        first = pseudo_inertia(described)
        along = np.array([(pseudo_inertia(ten) - first) / step for ten in changed])
        size = 1.0 / np.sqrt(np.maximum(np.diag(first), THINNEST * np.diag(first).max()))
        scale = np.outer(size, size)
        return cls(first * scale, along * scale)

    @cached_property
    def _to_numbers(self) -> Array:
        """The derivatives (10, 10) of the numbers by the lower half of the pseudo-inertia."""
        return np.asarray(np.linalg.pinv(self.along[:, ROWS, COLUMNS].T), dtype=float)

    def at(self, x: Array) -> Array:
        """Return the pseudo-inertia (4, 4) at numbers (10,)."""
        return self.described + np.tensordot(x, self.along, 1)

    def log_probability(self, x: Array, S: Array) -> float:
        """Return ln of the probability that numbers with mean x (10,) and covariance S (10, 10)
        belong to a possible body."""
        return float(np.log(2.0) + log_ndtr(-self.distance(x, S)))

    def distance(self, x: Array, S: Array) -> float:
        """Return the distance of numbers (10,) to the nearest body, in deviations of S (10, 10)."""
        values, vectors = np.linalg.eigh(self.at(x))
        if values[0] >= 0.0:
            return 0.0
        e, U = np.linalg.eigh(S)
        weigh = U.T / np.sqrt(np.maximum(e, SMALLEST * e[-1]))[:, None]
        M = weigh @ self._to_numbers
        there = M @ self.described[ROWS, COLUMNS] + weigh @ x

        def factor(entries: Array) -> Array:
            L = np.zeros((4, 4))
            L[ROWS, COLUMNS] = entries
            return L

        def apart(entries: Array) -> Array:
            L = factor(entries)
            return M @ (L @ L.T)[ROWS, COLUMNS] - there

        def slopes(entries: Array) -> Array:
            half = ENTRIES @ factor(entries).T
            changes = half + half.swapaxes(1, 2)
            return M @ changes[:, ROWS, COLUMNS].T

        # A singular body is no start: its square root has no slope there.
        start = (vectors * np.maximum(values, FIRST * max(values[-1], 1.0))) @ vectors.T
        first = np.linalg.cholesky(start)[ROWS, COLUMNS]
        found = least_squares(apart, first, slopes, method="lm", xtol=1e-4, ftol=1e-4)
        return float(np.sqrt(2.0 * found.cost))
