"""Convolution of long signals with short responses, with one spectrum per signal for all responses,
and circular convolution of band-limited signals, which have few harmonics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.codegen.parallel import threads

# Blocks this many times as long as the response waste little on overlap and stay in the cache.
BLOCK_OVER_RESPONSE = 6
SHORTEST_BLOCK = 4096
COLUMNS = 16  # filtered at once: what the caches hold
# rows in which a column acts, up to which sums of spectra are faster than products of matrices
FEW = 4
# Threads pay from this many samples on.
THREADS_FROM = 30_000
MOST_THREADS = 2


def convolve(signals: Sequence[Array], responses: Array, every: int = 1) -> Array:
    """Convolve signals with responses and add up (overlap-save).

    Samples that would need others from outside are left out.

    Where one of `every` samples is kept, a signal is taken for so many, of every so-manieth sample
    each, and so is a response: transforms are shorter, and what is not kept is never made
    (polyphase decomposition; P. P. Vaidyanathan, Multirate Systems and Filter Banks, 1993).

    signals: I arrays (N, m): columns with the same responses; responses: (O, I, K): the response of
    output o to signal i, its centre in the middle; every: one of so many samples is kept, the first
    one first.

    Returns (O, M, m): M = N - K + 1 samples, or one of `every` of them.
    """
    outputs, _, taps = responses.shape
    samples, columns = signals[0].shape
    kept = -(-(samples - taps + 1) // every)
    # What is kept of a block comes last in it, after the samples that the response spoils.
    spoilt = -(-(taps - 1) // every)
    longest = -(-min(max(BLOCK_OVER_RESPONSE * taps, SHORTEST_BLOCK), samples + taps) // every)
    blocks = -(-kept // (longest - spoilt))
    size = next_fast_len(spoilt + -(-kept // blocks), True)
    workers = min(threads(), MOST_THREADS) if samples >= THREADS_FROM else 1
    early = spoilt * every - (taps - 1)
    spectra = [
        rfft(_phases(signal, early, (blocks, spoilt, size), every), workers=workers)
        for signal in signals
    ]
    gains = rfft(_phases_of(responses, every), size)
    result = np.empty((outputs, kept, columns))
    for o in range(outputs):
        parts = (
            (spectrum[p], gain[p])
            for spectrum, gain in zip(spectra, gains[o], strict=True)
            for p in range(every)
        )
        total = np.multiply(*next(parts))
        for spectrum, gain in parts:
            total += spectrum * gain
        filtered = irfft(total, size, workers=workers, overwrite_x=True)[..., spoilt:]
        result[o] = filtered.reshape(columns, -1)[:, :kept].T
    return result


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Samples of a band as the coefficients of their harmonics, which are fewer than the samples.

    Real and imaginary parts of the harmonics 0 to H - 1, in units in which products of two signals
    are those of their samples (Parseval). Where samples at the ends do not count, as a circular
    filter spoils them, products are those of (1 - E'E)^(1/2) c, E giving these samples by
    coefficients c: c less a part in few directions.
    """

    samples: int  # N
    edge: int  # samples that do not count at either end
    scale: Array  # (H,) factor on the coefficients of `numpy.fft.rfft`
    ends: Array  # (2 H, r) directions that show in the samples that do not count, orthonormal
    left: Array  # (r,) share of each that is left without these

    @staticmethod
    @lru_cache(maxsize=32)
    def of(samples: int, count: int, edge: int) -> Harmonics:
        """Return the first harmonics of a number of samples; made once."""
        k = np.arange(count)
        # Mean and Nyquist frequency have one sign only.
        scale = np.sqrt(np.where(2 * k % samples == 0, 1.0, 2.0) / samples)
        dropped = np.r_[:edge, samples - edge : samples]
        phase = 2 * np.pi / samples * np.outer(dropped, k)
        shown = np.stack([np.cos(phase) * scale, -np.sin(phase) * scale], axis=2).reshape(
            len(dropped), -1
        )
        _, size, ends = np.linalg.svd(shown, full_matrices=False)
        # 1e-14 of a direction's squares, if all of it is in samples that do not count; numerical
        left = np.sqrt(np.maximum(1.0 - size**2, 1e-14))
        return Harmonics(samples, edge, scale, np.ascontiguousarray(ends.T), left)

    @property
    def size(self) -> int:
        """Number of coordinates of a signal, 2 H."""
        return len(self.ends)

    def coordinates(self, spectra: NDArray[np.complexfloating]) -> Array:
        """Return the coordinates (..., 2 H) of spectra (..., H), times `scale` already."""
        own = np.ascontiguousarray(spectra).view(float)
        return own - ((own @ self.ends) * (1.0 - self.left)) @ self.ends.T


class CircularGains(NamedTuple):
    """Spectra of responses of one row to another, up to the edge of a band."""

    harmonics: Harmonics  # of what they leave
    by_frequency: NDArray[np.complexfloating]  # (H, R, R)
    by_row: NDArray[np.complexfloating]  # the same, (R, R, H)
    first: Indices  # (R,) the first row in which each shows


def frequencies(harmonics: Harmonics, rate: float) -> Array:
    """Return the frequencies (H,) of harmonics of samples at a rate, Hz."""
    return np.arange(harmonics.size // 2) * rate / harmonics.samples


def filtered_circularly(values: Array, gains: CircularGains) -> Array:
    """Convolve columns circularly with the responses of one row to another.

    values: (N, R, k), columns of R rows at N samples.

    Returns (k, R, 2 H) coordinates of the harmonics.
    """
    harmonics = gains.harmonics
    out = np.zeros((values.shape[2], values.shape[1], harmonics.size))
    # Most columns show in few of the rows.
    for acting, columns in _alike(np.asarray(values.any(axis=0))):
        own = values.T[columns].take(acting, axis=1)
        first = int(gains.first[acting].min())
        spectrum = rfft(own)[:, :, : harmonics.size // 2]
        if len(acting) > FEW:
            products = gains.by_frequency[:, first:, acting] @ np.ascontiguousarray(
                spectrum.transpose(2, 1, 0)
            )
            total = np.ascontiguousarray(products.transpose(2, 1, 0))
        else:
            total = gains.by_row[first:, acting[0]] * spectrum[:, :1]
            for k, row in enumerate(acting[1:], 1):
                total += gains.by_row[first:, row] * spectrum[:, k : k + 1]
        out[columns, first:] = harmonics.coordinates(total)
    return out


def circular_gains(gains: NDArray[np.complexfloating], samples: int, edge: int) -> CircularGains:
    """Return gains as :func:`filtered_circularly` takes them.

    gains: (H, R, R) at the first frequencies of `numpy.fft.rfft` of these samples, beyond which
    there is nothing.
    """
    harmonics = Harmonics.of(samples, len(gains), edge)
    scaled = gains * harmonics.scale[:, None, None]
    return CircularGains(
        harmonics,
        scaled,
        np.ascontiguousarray(scaled.transpose(1, 2, 0)),
        scaled.any(axis=0).argmax(axis=0),
    )


def _alike(
    acting: Mask,
) -> Iterator[tuple[Indices, Indices | slice]]:
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
            yield (
                rows,
                slice(some[0], some[-1] + 1) if some[-1] - some[0] < len(some) else np.array(some),
            )


def _phases(signal: Array, early: int, windows: tuple[int, int, int], every: int) -> Array:
    """Return windows (every, m, blocks, size) of what each phase of a signal (N, m) has.

    Phase p has the samples p before each of the `every`-th ones, the first of which is `early`
    before the signal's.

    windows: their number, by how much each overlaps the one before, and their size.
    """
    blocks, overlap, size = windows
    length = (blocks - 1) * (size - overlap) + size
    phases = np.zeros((every, signal.shape[1], length))
    for p, phase in enumerate(phases):
        missing = -(-(p + early) // every)  # samples before the signal's first
        inside = signal[missing * every - p - early :: every][: length - missing]
        phase[:, missing : missing + len(inside)] = inside.T
    return np.lib.stride_tricks.sliding_window_view(phases, size, axis=2)[:, :, :: size - overlap]


def _phases_of(responses: Array, every: int) -> Array:
    """Return the phases (O, I, every, R) of responses (O, I, K)."""
    outputs, inputs, taps = responses.shape
    padded = np.pad(responses, ((0, 0), (0, 0), (0, -taps % every)))
    return padded.reshape(outputs, inputs, -1, every).swapaxes(2, 3)
