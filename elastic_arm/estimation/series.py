"""Derivatives of periodic motion: analytic derivatives of a Fourier series fitted to positions and velocities.

Where the motion repeats, all repetitions speak of the same few coefficients, and accelerations come out far better
than any smoother can make them. What the series cannot hold (transients, anything that does not repeat) is lost from
the motion but not from the torques, so a series is only taken where nothing stands out of the encoders' noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.noise import StateNoise
from elastic_arm.estimation.resampling import Grid
from elastic_arm.estimation.smoother import instantaneous

Array = NDArray[np.float64]

MOST_HARMONICS = 120
FASTEST_HZ = 40.0
# Enough to find the period and the number of harmonics.
ENOUGH_SAMPLES = 4000
# A harmonic counts when its power stands this far above the floor.
ABOVE_FLOOR = 12.0
# A series is accepted when it leaves no more than this times the noise of the encoders.
ACCEPTED = 1.3
# Of a period, over whose means it is judged from when on a motion repeats.
BLOCKS = 100
# A motion is seen to repeat when its period is no longer than this share of the recording.
LONGEST_PERIOD = 0.7


@dataclass(frozen=True)
class FourierFit:
    """A Fourier series of all joints of one side.

    Parameters
    ----------
    omega
        Fundamental, rad/s.
    mean
        (n,) rad.
    sine, cosine
        (H, n) rad, of sin(k omega t) and cos(k omega t), k = 1..H.
    residual_std
        (n,) rad, what the fit leaves of the positions.
    samples
        Number of samples that were fitted.
    velocity_weight
        Position noise over velocity noise, s; 0 without velocities.
    """

    omega: float
    mean: Array
    sine: Array
    cosine: Array
    residual_std: Array
    samples: int = 0
    velocity_weight: float = 0.0

    @staticmethod
    def of(
        t: Array, position: Array, velocity: Array | None, omega: float, velocity_weight: float, harmonics: int
    ) -> FourierFit:
        """Fit positions and velocities together.

        Parameters
        ----------
        t
            (N,) s.
        position, velocity
            (N, n) rad, rad/s; velocity may be None.
        omega
            Fundamental, rad/s.
        velocity_weight
            Position noise over velocity noise, s.
        harmonics
            How many.
        """
        coefficients = _solve(t, position, velocity, omega, harmonics, velocity_weight)
        fit = FourierFit(
            omega,
            coefficients[0],
            coefficients[1 : harmonics + 1],
            coefficients[harmonics + 1 :],
            np.zeros(position.shape[1]),
        )
        freedom = np.sqrt(max(len(t) - len(coefficients), 1))
        left = np.linalg.norm(position - fit(t)[0], axis=0) / freedom
        return replace(fit, residual_std=left, samples=len(t), velocity_weight=velocity_weight)

    def variances(self) -> Array:
        """Return the variances of mean, sines and cosines, (1 + 2 H, n)."""
        w = self.omega * np.arange(1, len(self.sine) + 1)
        harmonic = 2.0 / (1.0 + (w * self.velocity_weight) ** 2)
        return np.outer(np.concatenate([[1.0], harmonic, harmonic]), self.residual_std**2 / self.samples)

    def state_covariances(self) -> Array:
        """Return covariances (n, 3, 3) of position, velocity and acceleration, the same at all times."""
        w = self.omega * np.concatenate([[0.0], np.arange(1, len(self.sine) + 1)])
        variances = self.variances()[: len(w)]  # those of the cosines are the sines'
        position, velocity, acceleration = (w**power @ variances for power in (0, 2, 4))
        none = np.zeros_like(position)
        rows = [position, none, -velocity], [none, velocity, none], [-velocity, none, acceleration]
        return np.array(rows).transpose(2, 0, 1)

    def bases(self, t: Array) -> tuple[Array, Array, Array]:
        """Return what mean, sines and cosines add to position, velocity and acceleration, (N, 1 + 2 H) each."""
        w = self.omega * np.arange(1, len(self.sine) + 1)
        basis = _basis(t, self.omega, len(w))
        s, c = basis[:, 1 : len(w) + 1], basis[:, len(w) + 1 :]
        none = np.zeros((len(t), 1))
        return basis, np.hstack([none, c * w, -s * w]), np.hstack([none, -s * w**2, -c * w**2])

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Evaluate position, velocity and acceleration, (N, n) each."""
        w = self.omega * np.arange(1, len(self.sine) + 1)
        phase = np.outer(t, w)
        s, c = np.sin(phase), np.cos(phase)
        w, a, b = w[:, None], self.sine, self.cosine
        return self.mean + s @ a + c @ b, c @ (w * a) - s @ (w * b), -s @ (w**2 * a) - c @ (w**2 * b)


def fourier_motion(
    grid: Grid, link_std: Array | None, motor_std: Array | None, period: float | None = None
) -> tuple[Motion, FourierFit | None, FourierFit | None]:
    """Return the motion of a periodic recording from fitted series, with the torques as measured, and the series.

    Parameters
    ----------
    grid
        One regular piece.
    link_std, motor_std
        (n,) position noise of the encoders, against which the fit is judged; None where a side is missing.
    period
        Seconds; found from the motion when None.

    Raises
    ------
    IdentificationError
        If the motion does not repeat, or repeats but holds more than a series can, or `period` is none of it.
    """
    position = _positions(grid)
    period = find_period(position, grid.rate) if period is None else period
    if not 2.0 / grid.rate <= period <= len(grid) / grid.rate:
        raise IdentificationError(
            f"a period of {period:g} s does not fit into {len(grid) / grid.rate:.3g} s at {grid.rate:.4g} Hz",
            "Give the period of the motion, which must have been recorded once at least.",
        )
    omega = 2 * np.pi / period
    for _ in range(2):  # a period that is a few samples off hides the end of a start
        start = _settled(position, round(2 * np.pi / omega * grid.rate))
        t = grid.t[start:] - grid.t[start]
        omega = _refined(t, position[start:], omega)
    recorded: dict[str, tuple[Array, Array | None, float]] = {
        name: (x[start:], None if dx is None else dx[start:], _weight(x[start:], dx, start))
        for name, x, dx in (("q", grid.q, grid.dq), ("theta", grid.theta, grid.dtheta))
        if x is not None
    }
    # The same ones of both sides: what one of them lacked would be deflection.
    harmonics = max(_harmonics(t, x, dx, omega, weight) for x, dx, weight in recorded.values())
    stds = {"q": link_std, "theta": motor_std}
    sides: dict[str, Any] = {}
    series: dict[str, FourierFit] = {}
    for name, (x, dx, weight) in recorded.items():
        fit, std = FourierFit.of(t, x, dx, omega, weight, harmonics), stds[name]
        if std is not None and np.any(fit.residual_std > ACCEPTED * std + 1e-9 * np.std(x, axis=0)):
            raise IdentificationError(
                f"the motion of {name} holds more than a series of period {2 * np.pi / omega:.3f} s",
                "Use the smoother.",
            )
        series[name] = fit
        sides[name], sides["d" + name], sides["dd" + name] = fit(t)
    torques: dict[str, Any] = {
        name: instantaneous(v)[start:] for name in ("tau_J", "tau_m") if (v := getattr(grid, name)) is not None
    }
    link, motor = series.get("q"), series.get("theta")
    noise = StateNoise(*(None if side is None else side.state_covariances() for side in (link, motor)))
    return Motion(grid.t[start:], **sides, **torques, noise=noise, lacking=grid.lacking), link, motor


def period_of(grid: Grid) -> float:
    """Find the period of a piece's motion, s; see :func:`find_period` for errors."""
    return find_period(_positions(grid), grid.rate)


def repeats(grid: Grid, period: float) -> bool:
    """Return whether a piece is long enough to show a motion of `period`, s, again."""
    return period <= LONGEST_PERIOD * len(grid) / grid.rate


def find_period(position: Array, rate: float) -> float:
    """Find the period of a motion from its autocorrelation.

    Raises
    ------
    IdentificationError
        If the motion does not repeat within the recording.
    """
    n_samples = len(position)
    columns = np.ascontiguousarray(position.T)  # NumPy is slow along the first axis of a narrow array
    x = (columns - columns.mean(axis=1)[:, None]) / np.maximum(columns.std(axis=1), 1e-12)[:, None]
    spectrum = np.abs(np.fft.rfft(x, 2 * n_samples, axis=1)) ** 2
    # Over the powers of what overlaps: where the motion repeats, this is one, whatever part of a period the ends cut.
    power = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=0))])
    overlap = power[-1] - power[:n_samples] + power[n_samples:0:-1]
    together = 2.0 * np.fft.irfft(spectrum.sum(axis=0))[:n_samples] / np.maximum(overlap, 1e-300)
    late = together[: int(LONGEST_PERIOD * n_samples)]
    below = np.flatnonzero(late < 0.5)
    if len(below):
        after = int(below[0])
        best = after + int(np.argmax(late[after:]))
        peaks = np.flatnonzero((late[after:-1] > 0.98 * late[best]) & (late[after:-1] >= late[after + 1 :]))
        if late[best] > 0.8 and len(peaks):
            return float(after + peaks[0]) / rate
    raise IdentificationError("the motion does not repeat", "Use the smoother, or record two periods.")


def _positions(grid: Grid) -> Array:
    position = grid.q if grid.q is not None else grid.theta
    if position is None:
        raise IdentificationError("no positions were recorded", "Record /joint_states or /motor_states.")
    return position


def _settled(position: Array, shift: int) -> int:
    """Return the sample after which the motion repeats with the period of `shift` samples.

    By means over blocks: a start that no sample shows in the encoders' noise bends the series all the same.
    """
    if 2 * shift > len(position):
        return 0
    length = max(1, shift // BLOCKS)
    count = (len(position) - shift) // length
    blocks = (position[shift:] - position[:-shift])[: count * length].reshape(count, length, -1).mean(axis=1)
    change = np.max(np.abs(blocks) / np.maximum(position.std(axis=0), 1e-12), axis=1)
    usual = np.quantile(change[count // 2 :], 0.99)
    return length * (int(np.max(np.flatnonzero(change > 2.0 * usual), initial=-1)) + 1)


def _refined(t: Array, position: Array, omega: float) -> float:
    """Sharpen the fundamental: first by search, then by Gauss-Newton steps with all harmonics."""
    few = slice(None, None, max(1, len(t) // ENOUGH_SAMPLES))
    harmonics = min(12, _most_harmonics(t, omega))
    width = 0.2 * 2 * np.pi / (t[-1] * harmonics)

    def left(w: float) -> float:
        return float(np.linalg.norm(_project(t[few], w, harmonics, position[few])[0]))

    omega = float(scipy.optimize.minimize_scalar(left, bounds=(omega - width, omega + width), method="bounded").x)
    for _ in range(3):
        harmonics = _most_harmonics(t, omega)
        error, motion = _project(t[few], omega, harmonics, position[few])
        # x(t; omega + d) = x + (d / omega) t dx/dt
        stretch = _project(t[few], omega, harmonics, (t[few] - t[-1] / 2)[:, None] * motion)[0]
        omega *= 1.0 + float(np.sum(stretch * error) / np.sum(stretch**2))
    return omega


def _project(t: Array, omega: float, harmonics: int, x: Array) -> tuple[Array, Array]:
    """Return what a series leaves of `x`, and the rate of what it holds."""
    coefficients = _solve(t, x, None, omega, harmonics, 0.0)
    w = omega * np.arange(1, harmonics + 1)[:, None]
    basis = _basis(t, omega, harmonics)
    sine, cosine = coefficients[1 : harmonics + 1], coefficients[harmonics + 1 :]
    rate = basis[:, harmonics + 1 :] @ (w * sine) - basis[:, 1 : harmonics + 1] @ (w * cosine)
    return x - basis @ coefficients, rate


def _weight(position: Array, velocity: Array | None, start: int) -> float:
    """Return the ratio of the channels' noises from their highest frequencies, where motion is absent."""
    if velocity is None:
        return 0.0
    noise = [np.median(np.abs(np.diff(x, 4, axis=0)), axis=0).mean() for x in (position, velocity[start:])]
    return float(noise[0] / max(noise[1], 1e-300))


def _harmonics(t: Array, position: Array, velocity: Array | None, omega: float, velocity_weight: float) -> int:
    """Return the number of the last harmonic that stands out of the noise."""
    most = _most_harmonics(t, omega)
    few = slice(None, None, max(1, len(t) // ENOUGH_SAMPLES))
    rate = None if velocity is None else velocity[few]
    coefficients = _solve(t[few], position[few], rate, omega, most, velocity_weight)
    power = np.sum((coefficients[1 : most + 1] ** 2 + coefficients[most + 1 :] ** 2), axis=1)
    floor = np.median(power[most // 2 :])
    return max(1, int(np.max(np.flatnonzero(power > ABOVE_FLOOR * floor), initial=0)) + 1)


def _most_harmonics(t: Array, omega: float) -> int:
    step = (t[-1] - t[0]) / (len(t) - 1)
    fastest = 2 * np.pi * min(FASTEST_HZ, 0.4 / step)
    return max(1, min(MOST_HARMONICS, int(fastest / omega), len(t) // 4))


def _basis(t: Array, omega: float, harmonics: int) -> Array:
    phase = np.outer(t, omega * np.arange(1, harmonics + 1))
    return np.hstack([np.ones((len(t), 1)), np.sin(phase), np.cos(phase)])


def _solve(t: Array, x: Array, dx: Array | None, omega: float, harmonics: int, velocity_weight: float) -> Array:
    """Return the coefficients (1 + 2 H, n)."""
    basis = _basis(t, omega, harmonics)
    middle = x.mean(axis=0)
    target = x - middle
    if dx is not None and velocity_weight > 0:
        w = omega * np.arange(1, harmonics + 1)
        s, c = basis[:, 1 : harmonics + 1], basis[:, harmonics + 1 :]
        rates = np.hstack([np.zeros((len(t), 1)), c * w, -s * w])
        basis = np.vstack([basis, velocity_weight * rates])
        target = np.vstack([target, velocity_weight * dx])
    # The columns are nearly orthogonal; one refinement gives the normal equations full accuracy.
    gram = basis.T @ basis
    found = np.linalg.solve(gram, basis.T @ target)
    found += np.linalg.solve(gram, basis.T @ (target - basis @ found))
    found[0] += middle
    return found
