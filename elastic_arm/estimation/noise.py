"""Process intensity and encoder noise, estimated from the recording by maximum likelihood.

The motion of a joint is modelled as an integrated Wiener process: its fourth derivative is white.
Position and velocity channels measure it with white noise. The likelihood of the intensities
follows from the innovations of the steady-state Kalman filter; the corresponding smoother is
:class:`elastic_arm.estimation.smoother.Smoother`.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded when they are used

from elastic_arm.arrays import Array
from elastic_arm.errors import IdentificationError
from elastic_arm.recording.inspection.torque_spectrum import without_line

ORDER = 4
# Samples until the filter has settled, whose innovations do not count.
SETTLING = 8 * ORDER
# Above an eighth of the sample rate the sampled process is no longer like the continuous one of the
# design.
HIGHEST_CUTOFF = np.pi / 4
# A filter slower than this would cut into the motion of an arm.
LOWEST_CUTOFF_HZ = 4.0
# Longest piece of a recording from which the noise is estimated, in samples.
LONGEST_PIECE = 4096
# And from which its spectrum is taken.
LONGEST_SPECTRUM = 65536
# The filter's cutoff over the highest frequency at which the motion stands out of the noise: its
# response is then within 1e-3 of one wherever there is motion.
CUTOFF_OVER_BAND = 2.5
# A wider filter does no harm while the noise of the acceleration stays below this share of the
# acceleration.
QUIET = 1e-5
# Spectra are taken over windows of this many seconds; their side lobes lie 1e-15 below the motion.
SPECTRUM_SECONDS = 4.0
KAISER_BETA = 26.0
LEAST_STEP = 1e-3  # of an encoder's noise: two samples that differ by less hold one code
CHANCE = 0.01  # with which the averaged power of noise alone passes for signal at any frequency
# how much more power an encoder's steps have at some frequencies than white noise of their size
ROUGH = 1.5
WIENER_SECONDS = (
    2.0  # of the windows for the spectrum of a signal to be filtered, and of its filter
)
# Where no motion is, as shares of the sample rate.
WHITE = (0.35, 0.49)


@dataclass(frozen=True)
class SideNoise:
    """Noise of one side's encoders and the bandwidth of its motion."""

    cutoff: float  # where the motion's spectrum crosses the noise's, rad/s
    position_std: Array  # (n,) rad
    velocity_std: Array | None  # (n,) rad/s, or None where no velocity was recorded
    # white_position, white_velocity: (n,) rad, rad/s: as much of the two as is white, up to the
    # highest frequencies. What else stands in the two is motion that the model of it cannot follow,
    # no noise.
    white_position: Array
    white_velocity: Array | None
    # (n,) each: of noise of the position, over its std's, that is white, and that is slow
    slow: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class StateNoise:
    """What the encoders' noise leaves in a smoothed motion."""

    # link, motor: (n, 3, 3) covariance of position, velocity and acceleration of each joint, rad,
    # rad/s, rad/s²; None for a side that was not recorded
    link: Array | None
    motor: Array | None


def estimate_noise(position: Array, velocity: Array | None, rate: float) -> SideNoise:
    """Estimate noise and bandwidth of one side of all joints.

    position, velocity: (N, n) rad, rad/s on a regular grid.

    Cutoff and the ratio of the two noises are common to the joints of a side (they share encoders
    of a kind), the noise level is each joint's own and concentrated out of the likelihood.
    """
    if len(position) <= SETTLING:
        raise IdentificationError(
            f"{len(position)} consecutive samples are not sufficient",
            "Record several seconds of motion.",
        )
    piece = _liveliest(position, LONGEST_PIECE)
    y = position[piece] - position[piece].mean(axis=0)
    v = None if velocity is None else velocity[piece] / rate
    observed = np.stack([y.T] if v is None else [y.T, v.T])
    cutoff, ratio = _most_likely(observed, v, rate)
    variance = _concentrated(observed, cutoff, ratio)[1]
    std = np.sqrt(variance)
    wide = _liveliest(position, LONGEST_SPECTRUM)
    position = position[wide]
    velocity = None if velocity is None else velocity[wide]
    spectrum = _spectrum(position, rate)
    band = spectrum.band(std)
    white = np.minimum(std, spectrum.white_std())
    velocity_std = white_velocity = None
    if ratio is not None and velocity is not None:
        velocity_std = std * ratio * rate
        of_velocity = _spectrum(velocity, rate)
        band = max(band, of_velocity.band(velocity_std))
        white_velocity = np.minimum(velocity_std, of_velocity.white_std())
    slowest = max(2 * np.pi * LOWEST_CUTOFF_HZ, _quiet(position, std, rate))
    cutoff = min(max(2 * np.pi * CUTOFF_OVER_BAND * band, slowest), _crossing(cutoff, ratio) * rate)
    slow = spectrum.slow(std, cutoff / (2 * np.pi))
    return SideNoise(cutoff, std, velocity_std, white, white_velocity, slow)


def _most_likely(observed: Array, v: Array | None, rate: float) -> tuple[float, float | None]:
    """Return the most likely cutoff, rad a sample, and ratio of the noises.

    observed: (1 or 2, n, N) angles, and rates v (N, n) times the sample interval; the ratio is None
    without rates.
    """
    lowest = np.log(2 * np.pi * LOWEST_CUTOFF_HZ / rate)
    highest = max(np.log(HIGHEST_CUTOFF), lowest)
    count = observed.shape[-1]

    def cost(z: Array, part: slice = slice(None)) -> float:
        inside = np.clip(z[0], lowest, highest)
        outside = float(inside - z[0]) ** 2
        fit, _ = _concentrated(observed[..., part], float(np.exp(inside)), _ratio(z, v))
        return float(fit.sum()) + count * outside

    few = slice(0, max(count // 4, 256))
    ratios = (0.0,) if v is None else np.linspace(np.log(1e-3), np.log(30.0), 6)
    grid = itertools.product(np.linspace(lowest, highest, 6), ratios)
    start = np.array(min(grid, key=lambda z: cost(np.array(z), few)))
    simplex = start + np.array([[0.0, 0.0], [0.4, 0.0], [0.0, 0.8]])
    options = {"initial_simplex": simplex, "xatol": 0.05, "fatol": 1}
    z = scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options).x
    return float(np.exp(np.clip(z[0], lowest, highest))), _ratio(z, v)


class Telegraph(NamedTuple):
    """Noise of encoders that round an angle that nearly stands.

        power(f) = a + c / (f² + f0²)        over white noise of the encoder's standard deviation

    While an angle moves, rounding makes white noise, of power a. Where it stands, the reading goes
    to and fro between two steps: the noise is as strong, and slow. Its power, the integral of the
    second term, is that of the white noise times the share of the time in which the angle stands.
    """

    a: Array  # (n,) power of the white part
    c: Array  # (n,) Hz², strength of the slow part
    f0: Array  # (n,) Hz, below which the slow part is flat

    @staticmethod
    def of(position: Array, step: Array, side: SideNoise, rate: float) -> Telegraph:
        """Return the noise of encoders.

        It is white where steps are finer than the noise, or where the angle never stands.

        position: (N, n) rad on a regular grid; step: (n,) rad, 0 where they are finer than their
        noise.
        """
        # What stands moves by less than two steps in a period of the motion's highest frequency.
        later = max(1, round(2 * np.pi * rate / side.cutoff))
        stands = np.mean(np.abs(position[later:] - position[:-later]) < 1.5 * step, axis=0)
        a, c = np.where((step > 0.0) & (stands > 0.0), side.slow, [[1.0], [0.0]])
        # Between motion and noise the spectrum may show the slow part alone.
        rounding = step**2 / (12.0 * np.maximum(side.position_std, np.finfo(float).tiny) ** 2)
        a = np.maximum(a, np.minimum(rounding, 1.0) * (1.0 - stands))
        return Telegraph(a, c, np.pi * c / (rate * np.maximum(a * stands, 1.0 / len(position))))

    def power(self, f: Array) -> Array:
        """Return the power (F, n) of the noise at f (F,) Hz over that of its white part."""
        return self.a + self.c / (f[:, None] ** 2 + self.f0**2 + np.finfo(float).tiny)


def _quiet(position: Array, std: Array, rate: float) -> float:
    """Return the cutoff, rad/s, up to which the noise of the acceleration stays a small share of
    the acceleration.

    White noise of density std²/rate through w² up to the cutoff w_c has the variance std² w_c⁵ / (5
    pi rate).
    """
    w = 2 * np.pi * np.fft.rfftfreq(len(position), 1.0 / rate)
    # The acceleration of the slow part alone: above 10 Hz the noise of the positions would speak.
    w = w[w < 63.0]
    tapered = np.hanning(len(position)) * (position - position.mean(axis=0)).T
    spectrum = np.fft.rfft(tapered)[:, : len(w)]
    acceleration = np.sqrt(np.sum(np.abs(spectrum * w**2) ** 2, axis=1)) / len(position)
    cutoff = (np.sqrt(5 * np.pi * rate) * QUIET * acceleration / np.maximum(std, 1e-300)) ** 0.4
    return float(min(np.min(cutoff), HIGHEST_CUTOFF * rate))


@dataclass(frozen=True)
class _Spectrum:
    """Power densities (F, n) of a channel's joints at frequencies (F,), Hz, averaged over some
    windows."""

    rate: float
    frequency: Array
    power: Array
    windows: int

    def band(self, std: Array) -> float:
        """Return the highest frequency, Hz, at which some joint stands out of white noise of `std`
        (n,)."""
        # Overlapping windows are not independent: count two of three.
        freedom = 2 * max(1, round(self.windows / 1.5))
        threshold = scipy.stats.chi2.ppf(1.0 - 1e-3 / self.power.size, freedom) / freedom
        out = np.any(self.power > threshold * 2.0 * std**2 / self.rate, axis=1)
        return float(self.frequency[np.max(np.flatnonzero(out), initial=0)])

    def slow(self, std: Array, above: float) -> tuple[Array, Array]:
        """Return the powers a, c (n,) of noise with the spectrum a + c / f², over white noise of
        `std` (n,).

        Of medians over third octaves from where the motion ends: structures ring at some
        frequencies, and rounding of a steady motion has lines.
        """
        highest = WHITE[0] * self.rate
        thirds = round(3 * np.log2(highest / above))
        edges = np.geomspace(above, highest, max(2, thirds + 1))
        power = self.power * self.rate / (2.0 * std**2)
        f = self.frequency
        inside = [(f >= low) & (f < high) for low, high in pairwise(edges)]
        inside = [own for own in inside if own.any()]
        if above > edges[-1] or len(inside) < 2:
            return np.ones(len(std)), np.zeros(len(std))
        medians = np.array([np.median(power[own], axis=0) for own in inside])
        medians = np.maximum(medians, np.finfo(float).eps)
        squares = np.array([np.median(f[own]) for own in inside]) ** 2
        shapes = np.stack([np.ones(len(squares)), squares.min() / squares], axis=1)
        found = [
            scipy.optimize.nnls(shapes / own[:, None], np.ones(len(own)))[0] for own in medians.T
        ]
        white, slow = np.transpose(found)
        return white, slow * squares.min()

    def white_std(self) -> Array:
        """Return the std (n,) of white noise that is as strong as the highest frequencies are."""
        inside = (self.frequency > WHITE[0] * self.rate) & (self.frequency < WHITE[1] * self.rate)
        return np.sqrt(np.mean(self.power[inside], axis=0) * self.rate / 2.0)


def _spectrum(values: Array, rate: float) -> _Spectrum:
    length = min(len(values), round(SPECTRUM_SECONDS * rate))
    # Windows of one joint lie together: through all joints at once they would be taken number by
    # number.
    columns = np.ascontiguousarray(values.T)
    frequency, power = scipy.signal.welch(columns, rate, ("kaiser", KAISER_BETA), length)
    return _Spectrum(rate, frequency, power.T, max(1, 2 * (len(values) // length) - 1))


def _ratio(z: Array, v: Array | None) -> float | None:
    """Velocity noise (rad per sample) over position noise (rad)."""
    return None if v is None else float(np.exp(np.clip(z[1], np.log(1e-4), np.log(1e3))))


def _crossing(cutoff: float, ratio: float | None) -> float:
    """Return the frequency at which motion and noise are equal: cutoff^8 (1 + w²/ratio²) = w^8."""
    if ratio is None:
        return cutoff
    w = cutoff
    for _ in range(60):
        w = cutoff * (1.0 + (w / ratio) ** 2) ** (1 / (2 * ORDER))
    return min(w, HIGHEST_CUTOFF)


def _liveliest(position: Array, longest: int) -> slice:
    """Return the piece of the recording, of at most `longest` samples, in which the joints move
    most."""
    n_samples = len(position)
    if n_samples <= longest:
        return slice(0, n_samples)
    starts = np.arange(0, n_samples - longest + 1, max(longest // 4, n_samples // 256))
    pieces = starts[:, None] + np.arange(0, longest, 16)
    travel = sum(np.var(column[pieces], axis=1) for column in position.T)
    s = int(starts[int(np.argmax(travel))])
    return slice(s, s + longest)


def _concentrated(observed: Array, cutoff: float, ratio: float | None) -> tuple[Array, Array]:
    """Return -2 log likelihood, with the noise level concentrated out, and that level's square, per
    joint (n,).

    observed: (channels, n, N) position and, if recorded, velocity over the rate; cutoff, ratio: of
    the filter, rad per sample; noise of the velocity over that of the position.
    """
    gain, predict, s = _steady_state(cutoff, ratio)
    innovations = _innovations(observed, predict, gain, _observation(cutoff, ratio))[..., SETTLING:]
    channels, _, samples = innovations.shape
    whitened = np.linalg.inv(np.linalg.cholesky(s)) @ innovations.reshape(channels, -1)
    variance = np.mean(whitened.reshape(innovations.shape) ** 2, axis=(0, 2)) + np.finfo(float).tiny
    return samples * (np.linalg.slogdet(s)[1] + channels * np.log(variance)), variance


def _observation(cutoff: float, ratio: float | None) -> Array:
    c = np.zeros((1 if ratio is None else 2, ORDER))
    c[0, 0] = 1.0
    if ratio is not None:
        c[1, 1] = cutoff
    return c


@functools.lru_cache(maxsize=256)
def _steady_state(cutoff: float, ratio: float | None) -> tuple[Array, Array, Array]:
    """Return gain K, transition F and innovation covariance for unit position noise.

    The states are scaled by powers of the cutoff (rad per sample), which keeps the Riccati equation
    well conditioned.
    """
    i = np.arange(ORDER)
    up = i[None, :] - i[:, None]
    transition = np.where(
        up >= 0, cutoff ** np.maximum(up, 0) / scipy.special.factorial(np.maximum(up, 0)), 0.0
    )
    down = ORDER - 1 - i
    scale = cutoff ** (down + 1) / scipy.special.factorial(down)
    process = np.outer(scale, scale) / (down[:, None] + down[None, :] + 1)
    c = _observation(cutoff, ratio)
    noise = np.diag([1.0] if ratio is None else [1.0, ratio**2])
    p = scipy.linalg.solve_discrete_are(transition.T, c.T, process, noise)
    s = c @ p @ c.T + noise
    return np.linalg.solve(s, c @ p).T, transition, s


def _innovations(y: Array, transition: Array, gain: Array, c: Array) -> Array:
    """Run the steady-state filter over all samples, in modal form: one first-order recursion a
    mode."""
    values, vectors = np.linalg.eig(transition - transition @ gain @ c)
    inverse = np.linalg.inv(vectors)
    channels, joints, samples = y.shape
    first = np.zeros((len(transition), joints))
    first[0] = y[0, :, 0]
    if channels == 2:
        first[1] = y[1, :, 0] / c[1, 1]
    # Modes come as conjugate pairs: one of a pair is run, and the real part of its share counts
    # twice.
    run = np.flatnonzero(values.imag >= 0.0)
    shares = (c @ vectors)[:, run] * np.where(values[run].imag > 0.0, 2.0, 1.0)
    modal = ((inverse @ transition @ gain)[run] @ y.reshape(channels, -1)).reshape(
        len(run), joints, samples
    )
    starts = inverse[run] @ first
    for mode, value, start in zip(modal, values[run], starts, strict=True):
        driven = scipy.signal.lfilter(
            [1.0], [1.0, -value], mode[:, :-1], axis=1, zi=value * start[:, None]
        )[0]
        mode[:, 0] = start
        mode[:, 1:] = driven
    predicted = (shares @ modal.reshape(len(run), -1)).real
    return y - predicted.reshape(y.shape)


def encoder_steps(position: Array | None, noise: Array | None) -> Array:
    """Return the steps (n,) rad of one side's encoders; zero where they are finer than their noise.

    position: (N, n) rad, as recorded; None where the side was not; noise: (n,) rad, standard
    deviation of a sample.
    """
    if position is None or noise is None:
        return np.zeros(1)
    different = np.abs(np.diff(position, axis=0))
    # Codes apart by rounding are the same one.
    step = np.where(different > LEAST_STEP * noise, different, np.inf).min(axis=0)
    same = (different <= LEAST_STEP * noise).any(axis=0)
    return np.where(same & (step > noise) & np.isfinite(step), step, 0.0)


def noise_filter(values: Array, rate: float, f: Array, noise: Array) -> Callable[[Array], Array]:
    """Return a filter without lag, (N,) -> (N,), that removes noise above the signal.

    Each frequency is reduced to its share of signal, or to the largest share above it: what moves
    slowly, in a few lines, is not thinned out between them.

    values, rate, f, noise: as of :func:`wiener_filter`. Nothing is taken off a signal that
    outweighs its noise up to the highest `f`.
    """
    window = min(len(values), round(WIENER_SECONDS * rate))
    at, power = scipy.signal.welch(values, rate, nperseg=window)
    # 2.0 Hz over which the spectrum of a signal is averaged beside that of its noise
    known = at <= f[-1]
    bins = max(1, round(2.0 / at[1]))
    mean = scipy.ndimage.uniform_filter1d(power, bins)[known]
    expected = np.interp(at[known], f, noise) * 2.0 / rate
    upper = slice(-max(1, len(mean) // 4), None)
    level = float(np.median(mean[upper] / np.maximum(expected[upper], 1e-300)))
    # What is a little more than the noise expected, up to the highest frequency, is noise, too.
    expected *= level if 1.0 < level < ROUGH else 1.0
    share = 1.0 - expected / np.maximum(mean, 1e-300)
    # 1.5 bins that the window of a spectrum correlates: its equivalent noise bandwidth (Harris
    # 1978)
    averaged = max(1.0, (2 * len(values) // window - 1) * bins / 1.5)
    least = 1.0 - 1.0 / float(
        scipy.stats.gamma.isf(CHANCE / len(mean), averaged, scale=1.0 / averaged)
    )
    gain = np.maximum.accumulate(np.where(share > least, share, 0.0)[::-1])[::-1]
    if gain[-1] > 0.0:
        return lambda one: one

    def filtered(one: Array) -> Array:
        padded = np.pad(one, window, mode="reflect", reflect_type="odd")
        response = np.interp(np.fft.rfftfreq(len(padded), 1.0 / rate), at[known], gain, right=0.0)
        return np.fft.irfft(np.fft.rfft(padded) * response, len(padded))[window:-window]

    return filtered


def wiener_filter(values: Array, rate: float, f: Array, noise: Array) -> Callable[[float], Array]:
    """Return `least` -> a signal in noise (N,) with each frequency reduced to its share of signal.

    Frequencies with less power than `least` times the noise are taken off. The coefficient of a
    regression on the result is not biased by the noise (regression calibration; Carroll et al.,
    Measurement Error in Nonlinear Models, 2006, section 4).

    values: (N,) of any unit; f: (F,) Hz, ascending; what lies above is taken off; noise: (F,) in
    it, in units squared; 1 is white noise of one unit a sample.
    """
    half = min(len(values), round(WIENER_SECONDS * rate)) // 2
    at, power = scipy.signal.welch(values, rate, nperseg=2 * half, detrend=without_line)
    expected = np.interp(at, f, noise) * 2.0 / rate
    share = np.clip(1.0 - expected / np.maximum(power, 1e-300), 0.0, 1.0)
    known = at <= f[-1]

    def filtered(least: float) -> Array:
        return reduced_to(
            values, rate, at[known], np.where(power < least * expected, 0.0, share)[known]
        )

    return filtered


def reduced_to(values: Array, rate: float, f: Array, share: Array) -> Array:
    """Return a signal (N,) with each frequency reduced to a share of it, without lag.

    values: (N,) of any unit; f, share: (F,) Hz, ascending, and the shares there; what lies above is
    taken off.
    """
    half = min(len(values), round(WIENER_SECONDS * rate)) // 2
    at = np.fft.rfftfreq(2 * half, 1.0 / rate)
    taps = np.fft.fftshift(np.fft.irfft(np.interp(at, f, share, right=0.0)))
    taps = np.append(taps, taps[0]) * np.hanning(2 * half + 1)
    return scipy.signal.oaconvolve(np.pad(values, half, mode="edge"), taps, mode="valid")
