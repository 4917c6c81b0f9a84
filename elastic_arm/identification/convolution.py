"""Convolution of long signals with short responses, several responses to one signal at the price of one spectrum."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

Array = NDArray[np.float64]

# Blocks this many times as long as the response waste little on overlap and stay in the cache.
BLOCK_OVER_RESPONSE = 6
SHORTEST_BLOCK = 4096
# Threads pay from this many samples on.
THREADS_FROM = 30_000


def convolve(signals: Sequence[Array], responses: Array) -> Array:
    """Convolve signals with responses and add up, keeping what needs no sample from outside (overlap-save).

    Parameters
    ----------
    signals
        I arrays (N,).
    responses
        (O, I, K): the response of output o to signal i, its centre in the middle.

    Returns
    -------
    (O, N - K + 1).
    """
    outputs, _, taps = responses.shape
    samples = len(signals[0])
    size = next_fast_len(min(max(BLOCK_OVER_RESPONSE * taps, SHORTEST_BLOCK), samples + taps), real=True)
    step = size - taps + 1
    kept = samples - taps + 1
    blocks = -(-kept // step)
    workers = min(2, os.cpu_count() or 1) if samples >= THREADS_FROM else 1
    spectra = [rfft(_windows(signal, blocks, step, size), workers=workers) for signal in signals]
    gains = rfft(responses, size)
    result = np.empty((outputs, kept))
    for o in range(outputs):
        total = sum(spectrum * gain for spectrum, gain in zip(spectra, gains[o], strict=True))
        result[o] = irfft(total, size, workers=workers, overwrite_x=True)[:, taps - 1 :].reshape(-1)[:kept]
    return result


def _windows(signal: Array, blocks: int, step: int, size: int) -> Array:
    padded = np.zeros((blocks - 1) * step + size)
    padded[: len(signal)] = signal
    return np.lib.stride_tricks.sliding_window_view(padded, size)[::step]
