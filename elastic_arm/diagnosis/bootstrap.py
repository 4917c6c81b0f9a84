"""The block bootstrap: how far a mean over a recording may vary, where neighbouring samples are not independent.

A recording is cut into blocks longer than the memory of its residuals, and blocks are drawn with replacement (Künsch
1989, The jackknife and the bootstrap for general stationary observations).
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.settings import ResamplingSettings

Array = NDArray[np.float64]

KEPT = 1000  # blocks up to which weights are kept for the next hypothesis; bounds the memory (32 MB each)


def block_counts(blocks: int, draws: int, seed: int) -> NDArray[np.int64]:
    """Return how often (draws, blocks) each block is drawn.

    Parameters
    ----------
    blocks
        Number of blocks of the recording.
    draws
        Number of resamples.
    seed
        Of the generator that draws them.
    """
    return np.random.default_rng(seed).multinomial(blocks, np.full(blocks, 1.0 / blocks), draws)


def block_weights(blocks: int, draws: int, seed: int) -> Array:
    """Return the weights (draws, blocks) of the blocks in the mean of each resample, not to be written to.

    Parameters
    ----------
    blocks
        Number of blocks of the recording.
    draws
        Number of resamples.
    seed
        Of the generator that draws them.
    """
    return _kept_weights(blocks, draws, seed) if blocks <= KEPT else _weights(blocks, draws, seed)


def _weights(blocks: int, draws: int, seed: int) -> Array:
    found = block_counts(blocks, draws, seed) / blocks
    found.setflags(write=False)
    return found


_kept_weights = functools.lru_cache(maxsize=4)(_weights)


def interval(sample: Array, level: float) -> tuple[float, float]:
    """Return the interval that holds the share `level` of a sample (draws,)."""
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(sample, [tail, 100.0 - tail])
    return float(low), float(high)


def lower_bound(values: Array, settings: ResamplingSettings, seed: int) -> float:
    """Return the lower end of the interval of the mean of values of blocks (blocks,).

    Parameters
    ----------
    values
        One a block.
    settings
        Number of resamples, level of the interval.
    seed
        Of the generator that draws the resamples.
    """
    return interval(block_weights(len(values), settings.draws, seed) @ values, settings.interval)[0]
