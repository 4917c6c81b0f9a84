"""Whether a motion repeats, and after which time: the peak of its autocorrelation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.estimation.resampling import Grid

LONGEST = 0.7  # of the recording: a motion of a longer period is not seen to repeat


def repeats(grid: Grid) -> bool:
    """Return whether the motion of a piece is seen to repeat."""
    position = grid.q if grid.q is not None else grid.theta
    return position is not None and find_period(position, grid.rate) is not None


def find_period(position: NDArray[np.float64], rate: float) -> float | None:
    """Return the period of angles (N, n), s; None where they do not repeat within the recording."""
    n_samples = len(position)
    columns = np.ascontiguousarray(position.T)  # NumPy is slow along the first axis of a narrow array
    x = (columns - columns.mean(axis=1)[:, None]) / np.maximum(columns.std(axis=1), 1e-12)[:, None]
    spectrum = np.abs(np.fft.rfft(x, 2 * n_samples, axis=1)) ** 2
    # Over the powers of what overlaps: where the motion repeats, this is one, whatever part of a period the ends cut.
    power = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=0))])
    overlap = power[-1] - power[:n_samples] + power[n_samples:0:-1]
    together = 2.0 * np.fft.irfft(spectrum.sum(axis=0))[:n_samples] / np.maximum(overlap, 1e-300)
    late = together[: int(LONGEST * n_samples)]
    below = np.flatnonzero(late < 0.5)
    if not len(below):
        return None
    after = int(below[0])
    best = after + int(np.argmax(late[after:]))
    peaks = np.flatnonzero((late[after:-1] > 0.98 * late[best]) & (late[after:-1] >= late[after + 1 :]))
    return float(after + peaks[0]) / rate if late[best] > 0.8 and len(peaks) else None
