"""The band of the residuals: one zero-phase low pass for every term, and a lower sample rate."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import firwin, kaiserord, oaconvolve, upfirdn

from elastic_arm.arrays import Array

COLUMNS = 8  # filtered at once: what the caches hold
ALIKE = 0.01  # difference of sample rates that counts as none


@dataclass(frozen=True)
class Band:
    """A low pass with its decimation."""

    cutoff: float  # upper edge, Hz
    rate: float  # samples per second before
    step: int = field(init=False)
    taps: Array = field(init=False, repr=False)
    _responses: dict[int, Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        # 2.5 kept samples a second for each Hz of the band, and 40 at least: fewer make filters of
        # narrow bands long
        step = max(1, int(self.rate / max(2.5 * self.cutoff, 40.0)))
        # What folds back lands between the band's edge and the new Nyquist frequency, where nobody
        # looks.
        stop = min(self.rate / step - self.cutoff, 2.0 * self.cutoff)
        nyquist = self.rate / 2
        # 70.0 dB; what lies above the band would fold into it
        count, beta = kaiserord(70.0, (min(stop, nyquist) - self.cutoff) / nyquist)
        taps = firwin(
            count | 1,
            (self.cutoff + min(stop, 0.98 * nyquist)) / 2,
            window=("kaiser", beta),
            fs=self.rate,
        )
        object.__setattr__(self, "step", step)
        object.__setattr__(self, "taps", taps)

    @property
    def kept_rate(self) -> float:
        """Samples per second after."""
        return self.rate / self.step

    def at(self, rate: float) -> Self:
        """Return the same band of a recording of another rate.

        Clocks whose rates differ by a little have one rate.
        """
        return self if abs(rate / self.rate - 1.0) < ALIKE else type(self)(self.cutoff, rate)

    def apply(self, values: Array) -> Array:
        """Filter and thin columns (N, k) -> (N', k).

        Ends that would need samples from outside are left out.
        """
        length = len(self.taps)
        if len(values) < length:
            return np.empty((0, *values.shape[1:]))
        first = -(-(length - 1) // self.step)
        # 4 thinning from which products of matrices are faster than a polyphase filter
        if self.step < 4:
            full = upfirdn(self.taps, values, up=1, down=self.step, axis=0)
            return full[first : first + self._kept(len(values))]
        kept = self._kept(len(values))
        begin = first * self.step - (length - 1)
        # 60 taps for each sample of thinning from which spectra of the whole are faster than such
        # products
        if length >= 60 * self.step:
            return self._by_spectra(values[begin:], kept)
        thin = np.empty((kept, values.shape[1]))
        for k in range(0, values.shape[1], COLUMNS):
            thin[:, k : k + COLUMNS] = self._products(values[begin:, k : k + COLUMNS], kept)
        return thin

    def _products(self, values: Array, kept: int) -> Array:
        """Filter and thin columns (N, k) -> (kept, k) from the first sample on, by one product of
        matrices.

        The taps are cut into blocks of `step`: each kept sample is a sum of products of blocks of
        taps and of samples.
        """
        blocks = -(-len(self.taps) // self.step)
        taps = np.zeros(blocks * self.step)
        taps[: len(self.taps)] = self.taps  # symmetric
        k = values.shape[1]
        rows = kept + blocks - 1
        samples = np.zeros((k, rows * self.step))
        used = min(len(values), rows * self.step)
        samples[:, :used] = values[:used].T
        parts = (taps.reshape(blocks, -1) @ samples.reshape(k * rows, -1).T).reshape(
            blocks, k, rows
        )
        thin = parts[0, :, :kept].copy()
        for block in range(1, blocks):
            thin += parts[block, :, block : block + kept]
        return thin.T

    def _by_spectra(self, values: Array, kept: int) -> Array:
        """Filter columns (N, k) by spectra of all of them, and thin -> (kept, k) from the first
        whole sample on.

        What wraps around, as products of spectra are circular, spoils only samples before that one.
        """
        length = next_fast_len(len(values), True)
        if length not in self._responses:
            self._responses[length] = rfft(self.taps, length)
        spectra = rfft(np.ascontiguousarray(values.T), length) * self._responses[length]
        return irfft(spectra, length, overwrite_x=True)[:, len(self.taps) - 1 :: self.step][
            :, :kept
        ].T

    def times(self, t: Array) -> Array:
        """Return the instants (N',) that :meth:`apply` keeps of t (N,)."""
        length = len(self.taps)
        first = -(-(length - 1) // self.step) * self.step - (length - 1) // 2
        return t[first :: self.step][: self._kept(len(t))]

    def reached(self, piece: slice) -> slice:
        """Return the rows of :meth:`apply` on which a piece of samples acts.

        Their end may lie beyond all rows.
        """
        length = len(self.taps)
        first = self._first
        start = -(-(piece.start - first - length + 1) // self.step)
        return slice(max(0, start), max(0, (piece.stop - 1 - first) // self.step + 1))

    def samples(self, rows: slice) -> slice:
        """Return the samples of which :meth:`apply` makes certain rows.

        Their end may lie beyond all samples.
        """
        return slice(
            rows.start * self.step, (rows.stop - 1) * self.step + self._first + len(self.taps)
        )

    @property
    def _first(self) -> int:
        """First sample that acts on the first row."""
        length = len(self.taps)
        return -(-(length - 1) // self.step) * self.step - (length - 1)

    def _kept(self, count: int) -> int:
        length = len(self.taps)
        first = -(-(length - 1) // self.step) * self.step
        return max(0, (count - 1 - first) // self.step + 1)

    def gain(self, f: Array) -> Array:
        """Response at f (F,) Hz."""
        n = np.arange(len(self.taps)) - (len(self.taps) - 1) / 2
        return np.cos(2 * np.pi * np.outer(f, n) / self.rate) @ self.taps


@dataclass(frozen=True)
class LowPass:
    """A zero-phase low pass without decimation, for a narrower part of a :class:`Band`."""

    cutoff: float  # upper edge, Hz; beyond twice as much nothing is left
    rate: float  # samples per second
    taps: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        nyquist = self.rate / 2
        stop = min(2.0 * self.cutoff, 0.999 * nyquist)
        # 60.0 dB; noise above the narrow band is stronger, but nothing folds into it
        count, beta = kaiserord(60.0, (stop - self.cutoff) / nyquist)
        taps = firwin(count | 1, (self.cutoff + stop) / 2, window=("kaiser", beta), fs=self.rate)
        object.__setattr__(self, "taps", taps)

    @property
    def margin(self) -> int:
        """Samples lost at each end."""
        return (len(self.taps) - 1) // 2

    def apply(self, values: Array) -> Array:
        """Filter columns (N, k) -> (N - 2 margin, k)."""
        if len(values) < len(self.taps):
            return np.empty((0, *values.shape[1:]))
        return oaconvolve(values, self.taps[:, None], mode="valid", axes=0)

    def gain(self, f: Array) -> Array:
        """Response at f (F,) Hz."""
        n = np.arange(len(self.taps)) - self.margin
        return np.cos(2 * np.pi * np.outer(f, n) / self.rate) @ self.taps
