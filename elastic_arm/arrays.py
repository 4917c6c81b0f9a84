"""The types of arrays, whose shapes docstrings state, and what is often asked of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]  # which of several
Indices = NDArray[np.intp]  # places of several


def rms(values: Array, axis: int | None = 0) -> Array:
    """Return root mean squares along an axis, that of the samples; of all numbers for None."""
    return np.sqrt(np.mean(values**2, axis=axis))


def median_step(values: NDArray[Any]) -> float:
    """Return the median difference of numbers (N,) to the ones before: of times the interval."""
    return float(np.median(np.diff(values)))
