"""Triangular factors of rows."""

import numpy as np
from scipy.linalg.lapack import dgeqrt

from elastic_arm.arrays import Array

# Rows that are brought to triangular form at a time: so many stay in the caches.
AT_ONCE = 1024
# Columns that LAPACK eliminates together.
TOGETHER = 16


def triangular(rows: Array) -> Array:
    """Return the triangular factors (..., k, k) of rows (..., N, k).

    Columns without an entry are left out of the work: most equations hold few parameters.
    """
    if rows.ndim > 2:
        return np.stack([triangular(one) for one in rows])
    live = np.flatnonzero(rows.any(axis=0))
    found = np.zeros((rows.shape[1],) * 2)
    if len(live):
        columns = rows.T[live].T
        reflected, *_ = dgeqrt(min(TOGETHER, *columns.shape), columns, overwrite_a=True)
        factor = np.triu(reflected[: len(live)])
        found[np.ix_(live[: len(factor)], live)] = factor
    return found
