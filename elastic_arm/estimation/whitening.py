"""Residuals and columns of one data set, plain and whitened.

Whitened rows have white noise of variance one, whatever the channels' noise and however the equations share it. So half
their sum of squares is a likelihood, and what is left of it after a fit says by itself whether the fit is complete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.estimation.band import Band, LowPass
from elastic_arm.estimation.effect_columns import Feature, Signals
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.residuals import Layout, NoiseModel, Stretch, noise_model, residuals

Array = NDArray[np.float64]

EDGE = 10  # rows at the ends of a stretch that the whitening, being circular, spoils
BLOCK = 0.5  # s; longer than the arm's memory in the residuals
SLOWEST = 5e-4  # rad/s: slower than this a joint counts as standing, whatever the noise
STANDING = 3.0  # standard deviations of velocity noise below which a joint counts as standing


@dataclass(frozen=True)
class Part:
    """One stretch with what is needed to make columns for it."""

    stretch: Stretch
    signals: Signals
    noise: NoiseModel


class WhitenedData:
    """All stretches of one or several recordings.

    Parameters
    ----------
    model
        The nominal model.
    observations
        Of the recordings.
    layout, band
        Usable equations, and where they are looked at.
    """

    def __init__(self, model: Model, observations: Sequence[Observation], layout: Layout, band: Band) -> None:
        self.layout, self.band = layout, band
        self.parts: list[Part] = []
        self.pure: list[NoiseModel] = []
        for observation in observations:
            noise = noise_model(model, observation, layout, band)
            pure = noise_model(model, observation, layout, band, floor=0.0)
            standstill = _standstill(observation, noise.f, model.n)
            for stretch in residuals(model, observation, layout, band):
                elastic, cutoff = model.robot.elastic, observation.cutoff
                signals = Signals.of(stretch.quiet, standstill, elastic=elastic, cutoff=cutoff)
                self.parts.append(Part(stretch, signals, noise))
                self.pure.append(pure)
        self.y = [part.stretch.values for part in self.parts]
        self.white = self.whiten([y[:, :, None] for y in self.y])[:, 0]
        self.blocks = self._blocks()

    @property
    def seconds(self) -> float:
        """Duration of the rows."""
        return sum(len(y) for y in self.y) / self.band.kept_rate

    def noise_std(self, low_pass: LowPass) -> Array:
        """Standard deviation (R,) of each residual's noise behind a low pass, over all stretches."""
        weights = [len(y) for y in self.y]
        return np.sqrt(np.average([noise.std(low_pass) ** 2 for noise in self.pure], axis=0, weights=weights))

    def plain(self, feature: Feature, searched: Sequence[float] = ()) -> list[Array]:
        """Return a feature's columns (N', R, count) in the band, one array a stretch."""
        columns = []
        for part in self.parts:
            full = feature.columns(part.signals, searched)
            rows = np.tensordot(full, self.layout.transform, axes=(1, 1)).transpose(0, 2, 1)
            N, R, k = rows.shape
            flat = rows.reshape(N, R * k)
            used = np.flatnonzero(flat.any(axis=0))
            thin = np.zeros((len(part.stretch.t), R * k))
            thin[:, used] = self.band.apply(np.ascontiguousarray(flat[:, used]))[part.stretch.kept]
            columns.append(thin.reshape(-1, R, k))
        return columns

    def whiten(self, columns: Sequence[Array]) -> Array:
        """Whiten columns (N', R, k) of all stretches and stack them: (rows, k)."""
        return np.concatenate(
            [self._whiten(values, part.noise) for values, part in zip(columns, self.parts, strict=True)]
        )

    def _whiten(self, values: Array, noise: NoiseModel) -> Array:
        band = self.band
        spectrum = np.fft.rfft(values, axis=0) * np.sqrt(band.step)
        f = np.fft.rfftfreq(len(values), 1 / band.kept_rate)
        inside = f <= band.cutoff
        out = np.zeros_like(spectrum)
        out[inside] = noise.whitener(f[inside]) @ spectrum[inside]
        rows = np.fft.irfft(out, len(values), axis=0)[EDGE:-EDGE]
        return rows.reshape(-1, values.shape[2])

    def _blocks(self) -> NDArray[np.intp]:
        """Number of the block (rows,) to which each whitened row belongs."""
        length = max(1, round(BLOCK * self.band.kept_rate))
        labels, first = [], 0
        for y in self.y:
            count = max(0, len(y) - 2 * EDGE)
            label = first + np.arange(count) // length
            first = int(label[-1]) + 1 if count else first
            labels.append(np.repeat(label, self.layout.rows))
        return np.concatenate(labels)

    @property
    def freedom(self) -> float:
        """Number of independent rows: the band leaves out part of the kept spectrum."""
        return len(self.white) * min(1.0, 2 * self.band.cutoff / self.band.kept_rate)


def _standstill(observation: Observation, f: Array, n: int) -> tuple[Array, Array]:
    speeds = []
    for side in ("link", "motor"):
        w = 2 * np.pi * f[:, None]
        density = w**2 * observation.position_spectrum(side, f)
        std = np.sqrt(density.sum(axis=0) * (f[1] - f[0]) * 2 / observation.rate)
        speeds.append(np.maximum(STANDING * std, SLOWEST) * np.ones(n))
    return speeds[0], speeds[1]
