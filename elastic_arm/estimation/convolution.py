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


def convolve(signals: Sequence[Array], responses: Array, every: int = 1) -> Array:
    """Convolve signals with responses and add up, keeping what needs no sample from outside (overlap-save).

    Parameters
    ----------
    signals
        I arrays (N,).
    responses
        (O, I, K): the response of output o to signal i, its centre in the middle.
    every
        One of so many samples is kept, the first one first.

    Returns
    -------
    (O, M): M = N - K + 1 samples, or one of `every` of them.
    """
    outputs, _, taps = responses.shape
    samples = len(signals[0])
    kept = -(-(samples - taps + 1) // every)
    # What is kept of a block comes first in it, after the samples that the response spoils: a multiple of `every`.
    spoilt = -(-(taps - 1) // every)
    size = every * next_fast_len(
        -(-min(max(BLOCK_OVER_RESPONSE * taps, SHORTEST_BLOCK), samples + taps) // every), True
    )
    step = size // every - spoilt
    blocks = -(-kept // step)
    workers = _workers() if samples >= THREADS_FROM else 1
    early = spoilt * every - (taps - 1)
    spectra = [rfft(_windows(signal, early, blocks, step * every, size), workers=workers) for signal in signals]
    gains = rfft(responses, size)
    result = np.empty((outputs, kept))
    for o in range(outputs):
        total = sum(spectrum * gain for spectrum, gain in zip(spectra, gains[o], strict=True))
        thinned = irfft(_folded(total, size, every), size // every, workers=workers, overwrite_x=True)
        result[o] = thinned[:, spoilt:].reshape(-1)[:kept]
    return result


def _folded(spectrum: Array, size: int, every: int) -> Array:
    """Return the spectra of one of `every` samples: every other part of the whole spectrum falls onto the first."""
    if every == 1:
        return spectrum
    short = size // every
    width, half = short // 2 + 1, size // 2
    folded = spectrum[:, :width].copy()
    for alias in range(1, every):
        first = alias * short
        # Beyond the middle a spectrum of real numbers is the mirror image of its first half.
        below = min(max(half + 1 - first, 0), width)
        folded[:, :below] += spectrum[:, first : first + below]
        mirrored = spectrum[:, size - first - width + 1 : size - first - below + 1]
        folded[:, below:] += mirrored[:, ::-1].conj()
    folded /= every
    return folded


def _workers() -> int:
    """Return how many threads transforms may take."""
    wanted = os.environ.get("OMP_NUM_THREADS", "")
    return min(int(wanted) if wanted.isdigit() and int(wanted) else 2, 2, os.cpu_count() or 1)


def _windows(signal: Array, early: int, blocks: int, step: int, size: int) -> Array:
    """Return windows (blocks, size), the first of which begins with `early` zeros."""
    padded = np.zeros((blocks - 1) * step + size)
    inside = signal[: len(padded) - early]
    padded[early : early + len(inside)] = inside
    return np.lib.stride_tricks.sliding_window_view(padded, size)[::step]
