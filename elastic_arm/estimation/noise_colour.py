"""The colour of torque sensors' noise: a sum of smooth spectra, fitted by maximum likelihood.

The power density of each torque channel beyond its white level is a sum of shapes with coefficients c_k >= 0,

    P(f) = sum_k c_k h_k(f),        h = 1, 1/f, 1/f² and first-order low passes of several corners,

which spans white noise, pink noise, the random walk of a zero, coloured noise of a time constant and noise that passed
a low pass. The coefficients maximise the Whittle likelihood (Whittle 1953) of what no motion explains in the residuals,
by the multiplicative steps of Itakura-Saito non-negative matrix factorisation (Févotte, Bertin and Durrieu 2009), which
raise the likelihood at every step.

References
----------
- P. Whittle, Estimation and information in stationary time series, Arkiv för Matematik 2, 1953.
- C. Févotte, N. Bertin, J.-L. Durrieu, Nonnegative matrix factorization with the Itakura-Saito divergence, Neural
  Computation 21, 2009.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]

CORNERS = (0.5, 2.0, 5.0, 16.0)  # Hz, of the first-order shapes: sums of them come within 10 % of any smooth spectrum
MOST_OF_KIND = 20.0  # power of a sensor's noise over that usual among its kind; sensors differ by less than ten
FREQUENCIES = 500  # at which powers of shapes are compared
STEPS = 200  # of the likelihood's ascent
CONVERGED = 1e-3  # nats a step
SMALLEST = 1e-3  # of the white noise, at most anywhere: shapes below are left out
FEWEST = 16  # frequencies from which the power of an octave is known
UNKNOWN_SHARE = 0.3  # of the power expected: a row with less is that of exact encoders, and holds rounding
GROUPS_PER_OCTAVE = 6  # of frequencies that are averaged; shapes change little within a group


@dataclass(frozen=True, eq=False)
class Colour:
    """Power density of the torque channels' noise beyond their white level.

    Parameters
    ----------
    coefficients
        Channel ("tau_J", "tau_m") -> (n, shapes), 1 = the density of white noise of 1 Nm a sample.
    lowest
        Hz; below it the density is that at this frequency, as no recording shows more.
    """

    coefficients: Mapping[str, Array]
    lowest: float

    def density(self, channel: str, f: NDArray[np.floating]) -> Array:
        """Return the density (F, n) of a channel at f (F,) Hz; 1 = white noise of 1 Nm a sample."""
        return shapes(np.maximum(f, self.lowest)) @ self.coefficients[channel].T

    def divided(self, gains: Mapping[str, Array]) -> Colour:
        """Return the colour of torques that are divided by gains, "tau_J", "tau_m" -> (n,)."""
        by_channel = {
            name: own / np.square(gains[name])[:, None] if name in gains else own
            for name, own in self.coefficients.items()
        }
        return Colour(by_channel, self.lowest)


def pooled(colours: Sequence[Colour], white: Mapping[str, Array], highest: float) -> list[Colour]:
    """Return colours whose sizes are bounded by those of the same sensor in all recordings and of the arm's others.

    No sensor is given less noise than it has on the average of its recordings, nor less than half of its kind have. Of
    a short recording few frequencies are left beside all that a motion can do, so that the noise of one sensor is
    hardly known. Between sensors it is taken to go with their white noise: those of wrists are finer. What is far
    beyond the noise of its kind is none of a sensor.

    Parameters
    ----------
    colours
        Of the recordings.
    white
        Channel -> (n,) variance of the white noise, Nm².
    highest
        Hz up to which noise is compared.
    """
    lowest = np.array([one.lowest for one in colours])
    power = shapes(np.linspace(lowest.min(), highest, FREQUENCIES)).mean(axis=0)

    def bounds(channel: str, level: Array) -> tuple[Array, Array]:
        own = np.stack([one.coefficients[channel] for one in colours])
        # The lowest frequency goes with the inverse of the duration.
        mean = np.average(own, axis=0, weights=1.0 / lowest)
        # A joint without the channel has no noise.
        recorded = level > 0.0
        relative = np.concatenate(own[:, recorded] / level[recorded, None])
        middle = float(np.median(relative @ power)) if len(relative) else 0.0
        usual = relative.sum(axis=0) * middle / max(float((relative @ power).sum()), 1e-300)
        # White noise has the power one.
        return _larger(mean, level[:, None] * usual, power), MOST_OF_KIND * (1.0 + middle) * level

    def bounded(own: Array, least: Array, most: Array) -> Array:
        larger = _larger(own, least, power)
        return larger * np.minimum(1.0, most / np.maximum(larger @ power, 1e-300))[:, None]

    limits = {channel: bounds(channel, level) for channel, level in white.items()}
    return [
        Colour({name: bounded(own, *limits[name]) for name, own in one.coefficients.items()}, one.lowest)
        for one in colours
    ]


def _larger(coefficients: Array, others: Array, power: Array) -> Array:
    """Return of each sensor the coefficients (n, shapes) with more power; (shapes,) is the power of each shape."""
    return np.where((coefficients @ power < others @ power)[:, None], others, coefficients)


def shapes(f: NDArray[np.floating]) -> Array:
    """Return the shapes (F, shapes) at f (F,) Hz, above zero."""
    low_passes = [1.0 / (1.0 + (f / corner) ** 2) for corner in CORNERS]
    return np.stack([np.ones_like(f), 1.0 / f, 1.0 / f**2, *low_passes], axis=1)


@dataclass(frozen=True, eq=False)
class Periodogram:
    """What no motion explains in the whitened residuals of one stretch.

    Parameters
    ----------
    f
        (F,) Hz, above zero and within the band.
    values
        (F, R) complex; of white noise of variance one, independent with mean square one.
    share
        (F, R) of the information that is left beside all that a motion can do.
    ways
        Channel -> (F, R, n) complex: what white noise of 1 Nm a sample on each sensor of a channel is in them.
    """

    f: NDArray[np.floating]
    values: Complex
    share: Array
    ways: Mapping[str, Complex]


def covariances(f: NDArray[np.floating], ways: Mapping[str, Complex], colour: Colour) -> Complex:
    """Return the covariances (F, R, R) of white noise of variance one and coloured noise of the torque sensors.

    Parameters
    ----------
    f
        (F,) Hz.
    ways
        Channel -> (F, R, n).
    colour
        Of the noise.
    """
    rows = next(iter(ways.values())).shape[1]
    found = np.tile(np.eye(rows, dtype=complex), (len(f), 1, 1))
    for channel, way in ways.items():
        found += (way * colour.density(channel, f)[:, None, :]) @ way.conj().transpose(0, 2, 1)
    return found


@dataclass(frozen=True, eq=False)
class ColourFit:
    """The most likely colour, and how well it describes the noise.

    Parameters
    ----------
    colour
        Of the torque channels.
    gain
        Log-likelihood over that of the white noise, nats; minus infinity where no colour of sensors describes it.
    lack
        Largest ratio of power to power expected, over all rows and octaves that are well known.
    peakedness
        Mean over all rows and frequencies of half the squared ratio of power to that of its neighbours: 1 for noise,
        larger for lines.
    """

    colour: Colour
    gain: float
    lack: float
    peakedness: float


def fit_colour(stretches: list[Periodogram]) -> ColourFit:
    """Return the most likely colour of the torque channels' noise.

    Parameters
    ----------
    stretches
        Of all recordings, made by one arm and its sensors.
    """
    groups = [_grouped(one) for one in stretches]
    sample, weight, f = (np.concatenate([g[k] for g in groups]) for k in range(3))
    channels = list(stretches[0].ways)
    ways = {c: np.concatenate([g[3][c] for g in groups]) for c in channels}
    columns = np.concatenate([ways[c] for c in channels], axis=2)  # (G, R, sources)
    h = shapes(f)  # (G, shapes)
    identity = np.eye(sample.shape[1])
    own = np.real(np.einsum("grs,grs->gs", columns.conj(), columns)).max(axis=0)
    c = np.full((columns.shape[2], h.shape[1]), 1e-2) / (np.maximum(own, 1e-300)[:, None] * h.max(axis=0))

    def model(c: Array) -> Complex:
        power = h @ c.T
        return np.asarray(identity + (columns * power[:, None, :]) @ columns.conj().transpose(0, 2, 1))

    def likelihood(covariance: Complex, inverse: Complex) -> float:
        fit = np.real(np.sum(inverse * sample.transpose(0, 2, 1), axis=(1, 2)))
        return -float(weight @ (np.linalg.slogdet(covariance)[1] + fit))

    covariance = model(np.zeros_like(c))
    white = likelihood(covariance, np.linalg.inv(covariance))
    covariance = model(c)
    inverse = np.linalg.inv(covariance)
    reached = likelihood(covariance, inverse)
    try:
        for _ in range(STEPS):
            back = inverse @ columns
            seen = np.real(np.sum(back.conj() * (sample @ back), axis=1))
            expected = np.real(np.sum(columns.conj() * back, axis=1))
            if expected.min() < 0.0:
                raise np.linalg.LinAlgError("no inverse in 16 digits")
            ratio = ((weight[:, None] * seen).T @ h) / np.maximum((weight[:, None] * expected).T @ h, 1e-300)
            trial = c * ratio
            covariance = model(trial)
            inverse = np.linalg.inv(covariance)
            now = likelihood(covariance, inverse)
            gained, reached, c = now - reached, now, trial
            if abs(gained) < CONVERGED:
                break
    except np.linalg.LinAlgError:
        # Residuals so far above the sensors' white noise are of no sensor's colour.
        c, reached = np.zeros_like(c), -np.inf
    c = np.where(c * own[:, None] * h.max(axis=0) < SMALLEST, 0.0, c)
    n = ways[channels[0]].shape[2]
    coefficients = {name: c[k * n : (k + 1) * n] for k, name in enumerate(channels)}
    # With a quarter of it, the mean of a random walk over the recording has the variance that it should.
    colour = Colour(coefficients, float(min(one.f[0] for one in stretches)) / 4)
    powers = _powers(stretches, colour)
    lack = float(_lacks(stretches, powers).max())
    return ColourFit(colour, reached - white, lack, _peakedness(stretches, powers))


def _grouped(one: Periodogram) -> tuple[Array, Array, Array, dict[str, Complex]]:
    """Average over groups of frequencies: covariances (G, R, R), weights, frequencies, ways."""
    label = np.floor(GROUPS_PER_OCTAVE * np.log2(one.f / one.f[0])).astype(int)
    _, label = np.unique(label, return_inverse=True)
    count = np.bincount(label)
    z = one.values

    def mean(values: NDArray[Any]) -> NDArray[Any]:
        total = np.zeros((len(count), *values.shape[1:]), dtype=values.dtype)
        np.add.at(total, label, values)
        return total / count.reshape(-1, *[1] * (values.ndim - 1))

    covariance = mean(z[:, :, None] * z[:, None, :].conj())
    weight = count * mean(one.share.mean(axis=1))
    return covariance, weight, mean(one.f), {name: mean(way) for name, way in one.ways.items()}


def lacks(stretches: Sequence[Periodogram], colour: Colour) -> Array:
    """Return by row (R,) the largest ratio of power to that expected, over all octaves that are well known.

    Parameters
    ----------
    stretches
        Of all recordings, made by one arm and its sensors.
    colour
        Of the noise beyond its white level.
    """
    return _lacks(stretches, _powers(stretches, colour))


def _lacks(stretches: Sequence[Periodogram], powers: Sequence[Array]) -> Array:
    octaves: dict[int, list[tuple[Array, Array]]] = {}
    for one, power in zip(stretches, powers, strict=True):
        octave = np.floor(np.log2(one.f)).astype(int)
        for k in map(int, np.unique(octave)):
            octaves.setdefault(k, []).append((power[octave == k], one.share[octave == k]))
    rows = stretches[0].values.shape[1]
    found = [np.ones(rows)]
    for parts in octaves.values():
        power, share = (np.concatenate(values) for values in zip(*parts, strict=True))
        if len(power) >= FEWEST:
            found.append(np.average(power, axis=0, weights=share))
    return np.asarray(np.max(found, axis=0))


def _powers(stretches: Sequence[Periodogram], colour: Colour) -> list[Array]:
    """Return the power (F, R) of each stretch over that expected."""
    found = []
    for one in stretches:
        whitener = np.linalg.inv(np.linalg.cholesky(covariances(one.f, one.ways, colour)))
        found.append(np.abs(np.einsum("fij,fj->fi", whitener, one.values)) ** 2)
    return found


def _peakedness(stretches: Sequence[Periodogram], powers: Sequence[Array]) -> float:
    """Return of the worst row the mean of half the squared ratio of power to its mean over all frequencies.

    Each counts by the information that is left there: where a motion can do nearly all, the power is hardly known.
    """
    together, share = np.concatenate(powers), np.concatenate([one.share for one in stretches])
    mean, square = (np.average(power, axis=0, weights=share) for power in (together, together**2))
    used = mean > UNKNOWN_SHARE
    return float(np.max(square[used] / (2 * mean[used] ** 2), initial=1.0))
