"""The block bootstrap: how far a mean over a recording may vary, where neighbouring samples are not independent.

A recording is cut into blocks longer than the memory of its residuals, and blocks are drawn with replacement (Künsch
1989, The jackknife and the bootstrap for general stationary observations).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.settings import ResamplingSettings

Array = NDArray[np.float64]


def block_counts(blocks: int, draws: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return how often (draws, blocks) each block is drawn.

    Parameters
    ----------
    blocks
        Number of blocks of the recording.
    draws
        Number of resamples.
    rng
        Draws them.
    """
    return rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), draws)


def block_weights(blocks: int, draws: int, rng: np.random.Generator) -> Array:
    """Return the weights (draws, blocks) of the blocks in the mean of each resample.

    Parameters
    ----------
    blocks
        Number of blocks of the recording.
    draws
        Number of resamples.
    rng
        Draws them.
    """
    return block_counts(blocks, draws, rng) / blocks


def interval(sample: Array, level: float) -> tuple[float, float]:
    """Return the interval that holds the share `level` of a sample (draws,)."""
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(sample, [tail, 100.0 - tail])
    return float(low), float(high)


def lower_bound(values: Array, settings: ResamplingSettings, rng: np.random.Generator) -> float:
    """Return the lower end of the interval of the mean of values of blocks (blocks,).

    Parameters
    ----------
    values
        One a block.
    settings
        Number of resamples, level of the interval.
    rng
        Draws the resamples.
    """
    return interval(block_weights(len(values), settings.draws, rng) @ values, settings.interval)[0]
