"""The size of the gap and its reduction: power over the noise of the sensors by joint, side and
octave.

    e = max(P - noise, 0)    over the octaves in which P exceeds the noise by more than chance
    shrink = 1 - sum e(after) / sum e(before)

A slow effect is hidden by the noise of a wide band, but not by that of its own octave. No band has
to be chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import periodogram
from scipy.stats import chi2

from elastic_arm.arrays import Array, Mask, rms
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.evidence.grams import OCTAVES

CHANCE = 1e-5  # probability that noise in an octave counts as a gap
# relative error of the noise power; spectra of quantised encoders are off by a seventh
KNOWN = 0.2


@dataclass(frozen=True)
class Gap:
    """Powers of residuals by row and octave (R, O), Nm²."""

    # power, noise: of the residuals, and of the sensors' noise in them
    power: Array
    noise: Array
    count: Array  # numbers of independent values
    # rmse, peak: (R,) over the whole band, Nm
    rmse: Array
    peak: Array

    @staticmethod
    def of(data: WhitenedData, residuals: Sequence[Array]) -> Gap:
        """Measure residuals (N', R) of each stretch of recordings."""
        octaves = len(OCTAVES) + 1
        rows = data.layout.rows
        power = np.zeros((rows, octaves))
        noise = np.zeros((rows, octaves))
        count = np.zeros((rows, octaves))
        for own, part, pure, left in zip(
            residuals, data.parts, data.pure, data.shares(), strict=True
        ):
            rate = part.stretch.band.kept_rate
            share = len(own) / rate / data.seconds
            told = left.mean(axis=0)
            f, density = periodogram(own, rate, window="hann", detrend=False, axis=0)
            octave = np.searchsorted(OCTAVES, f, side="right")
            step = f[1] - f[0]
            spectra = [np.interp(f, pure.f, np.real(pure.covariance[:, r, r])) for r in range(rows)]
            sensors = np.stack(spectra, axis=1) * (2.0 / pure.rate)
            for o in range(octaves):
                # Above the cutoff, the filter of the band removes a part.
                there = (octave == o) & (f <= data.band.cutoff)
                power[:, o] += share * density[there].sum(axis=0) * step
                noise[:, o] += share * told * sensors[there].sum(axis=0) * step
                # A Hann window correlates neighbouring frequencies.
                count[:, o] += told * 2.0 * there.sum() / 1.5
        values = np.concatenate(list(residuals))
        return Gap(
            power,
            noise,
            np.maximum(count, 1.0),
            rms(values),
            np.abs(values).max(axis=0),
        )

    @property
    def significant(self) -> Mask:
        """The octaves (R, O) with significantly more power than noise."""
        return self.power > self.noise * (KNOWN + chi2.isf(CHANCE, self.count) / self.count)

    @property
    def excess(self) -> Array:
        """Power over the noise (R, O), Nm²."""
        return np.maximum(self.power - self.noise, 0.0)

    @property
    def of_sensors(self) -> Array:
        """The noise of the sensors (R,) Nm²; infinite in a row without values, as of a joint at
        rest."""
        noise = self.noise.sum(axis=1)
        return np.where(noise > 0.0, noise, np.inf)

    def error_of_change(self, change: Gap, where: Mask) -> Array:
        """Return the standard deviation (R,) of a change of power in some octaves, Nm².

            |r + d|² - |r|² = |d|² + 2 Re r* d

        r is the residual and d an independent change of it. With m independent values, the second
        term has the variance 4 |r|² |d|² / m.
        """
        variance = np.where(where, 4.0 * self.power * change.power / self.count, 0.0)
        return np.sqrt(variance.sum(axis=1))

    def place(self, where: Mask) -> Array:
        """Return the excess (R,) in some octaves."""
        return np.where(where, self.excess, 0.0).sum(axis=1)


@dataclass(frozen=True)
class Shrink:
    """The reduction of a gap: share, 95 % interval, and the share of each row's own gap (NaN if it
    has none)."""

    share: float | None
    interval: tuple[float, float] | None
    by_row: Array


def shrink(before: Gap, after: Gap) -> Shrink:
    """Return the reduction from one gap to another; an empty one if there is no gap before."""
    where = before.significant
    first = before.place(where)
    left = after.place(where)
    with np.errstate(invalid="ignore", divide="ignore"):
        by_row = np.where(first > 0.0, 1.0 - left / first, np.nan)
    total = float(first.sum())
    if total == 0.0:
        return Shrink(None, None, by_row)
    error = np.where(
        where, np.hypot(after.power * np.sqrt(2.0 / after.count), 0.5 * KNOWN * after.noise), 0.0
    )
    std = float(np.sqrt(np.sum(error**2))) / total
    share = 1.0 - float(left.sum()) / total
    return Shrink(share, (share - 2.0 * std, min(1.0, share + 2.0 * std)), by_row)
