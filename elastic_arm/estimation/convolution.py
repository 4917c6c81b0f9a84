"""Convolution of long signals with short responses, several responses to one signal at the price of one spectrum.

And circular convolution of signals of any length, by transforms of lengths that are fast.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

Array = NDArray[np.float64]

# Blocks this many times as long as the response waste little on overlap and stay in the cache.
BLOCK_OVER_RESPONSE = 6
SHORTEST_BLOCK = 4096
COLUMNS = 16  # filtered at once: what the caches hold
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


def filtered_circularly(values: Array, gains: NDArray[np.complexfloating]) -> Array:
    """Convolve columns circularly with the responses of one row to another.

    Parameters
    ----------
    values
        (N, R, k), columns of R rows at N samples.
    gains
        From :func:`circular_gains` of (F, R, R), lower triangular: no row acts on those before it.

    Returns
    -------
    (N, R, k).
    """
    out = np.zeros(values.shape)
    length = _circular_length(len(values))
    # Most columns show in few of the rows.
    for acting, columns in _alike(np.asarray(values.any(axis=0))):
        rows = acting if isinstance(columns, slice) else acting[:, None]
        spectrum = rfft(values[:, rows, columns], length, axis=0)
        filtered = irfft(gains[:, acting[0] :, acting] @ spectrum, length, axis=0)
        out[:, acting[0] :, columns] = filtered[: len(values)]
    return out


def circular_gains(gains: NDArray[np.complexfloating], samples: int) -> NDArray[np.complexfloating]:
    """Return gains at the frequencies of longer transforms that make the same circular convolution.

    A transform of a length with a large prime factor takes several times as long as one of twice that length without.
    Over twice the length the response is laid out once for each lag, so that nothing wraps around.

    Parameters
    ----------
    gains
        (F, …) at the frequencies of `numpy.fft.rfft` of these samples.
    samples
        Their number.
    """
    length = _circular_length(samples)
    if length == samples:
        return gains
    response = irfft(gains, samples, axis=0)
    lags = np.zeros((length, *gains.shape[1:]))
    lags[:samples] = response
    lags[length - samples + 1 :] = response[1:]
    return np.asarray(rfft(lags, axis=0))


def _circular_length(samples: int) -> int:
    """Return how long the transforms are that convolve circularly over a number of samples."""
    fast = int(next_fast_len(samples, True))
    return samples if fast == samples else int(next_fast_len(2 * samples - 1, True))


def _alike(acting: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp] | slice]]:
    """Yield rows and some of the columns that act in just these rows (R, k)."""
    groups: dict[bytes, list[int]] = {}
    for column, rows in enumerate(np.ascontiguousarray(acting.T)):
        if rows.any():
            groups.setdefault(rows.tobytes(), []).append(column)
    for columns in groups.values():
        rows = np.flatnonzero(acting[:, columns[0]])
        for first in range(0, len(columns), COLUMNS):
            some = columns[first : first + COLUMNS]
            # A slice is written to several times as fast as listed columns are.
            yield rows, slice(some[0], some[-1] + 1) if some[-1] - some[0] < len(some) else np.array(some)


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
