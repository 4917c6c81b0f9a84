"""Accelerations without finite differences: a steady-state smoother that filters all terms of an
equation alike.

It is the Wiener smoother of an integrated Wiener process (white fourth derivative) measured with
white noise. Its response from position to position is H = 1 / (1 + (w/w_c)^8), without phase. With
a velocity channel, the position is used below the frequency w_x = (velocity noise)/(position noise)
and the velocity above it, such that consistent channels together still have the response H. Every
channel of every joint, and every torque, passes the same H, so that the equations stay valid.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array, rms
from elastic_arm.codegen.parallel import share_out
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.convolution import convolve
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.noise import ORDER, SideNoise, StateNoise, estimate_noise
from elastic_arm.estimation.resampling import Grid, extended

# Order of a steeper smoother, and its highest cutoff in rad a sample: at 0.2 of the sample rate it
# takes 1e-4 of a motion, and its images are 1e-4 of an acceleration.
STEEP = 8
HIGHEST_STEEP_CUTOFF = 2.2
# Steps of a sample interval at which the sign of a velocity is taken before it is smoothed.
FINER = 8
# The taps are cut where they have fallen to this share.
TAIL = 1e-11
# Noise of an acceleration that no arm's motion notices, rad/s²: positions alone serve then.
NEGLIGIBLE = 1e-3
# So many samples in a period of the cutoff show what the smoother lets through, all but 1e-4 of its
# noise.
SAMPLES_A_PERIOD = 6.0
MOST_THINNING = 64
# Long recordings are smoothed in runs of this many samples, which stay in the cache.
RUN = 32768
TOGETHER = 4  # columns filtered at once: what the caches hold
# A smoother loses what lies within its lag of the ends of a piece, and laws that pass it twice lose
# twice that. Where this is more than a share `LOST` of the piece, and the joints move there as fast
# as `MOVING` of their rms speed (at rest they carry any torque up to their dry friction), the piece
# is continued by its mirror image, of which samples may hold the share `FOREIGN`. Conventions.
FOREIGN = 1e-4
LOST = 0.05
MOVING = 0.3


@dataclass(frozen=True)
class Smoother:
    """A fixed-lag smoother with steady-state gains, the same online and offline."""

    rate: float  # samples per second
    cutoff: float  # w_c, rad/s, common to all channels
    # link_crossover, motor_crossover: (n,) w_x of each joint, rad/s; infinite where the positions
    # alone serve
    link_crossover: Array
    motor_crossover: Array
    # link_noise, motor_noise: of the encoders; None where it is not known or there is no such side
    link_noise: SideNoise | None = None
    motor_noise: SideNoise | None = None
    order: int = ORDER  # H falls with the frequency to the power of twice the order

    @staticmethod
    def from_noise(
        rate: float, link: SideNoise | None, motor: SideNoise | None, n: int
    ) -> Smoother:
        """Design the smoother by the estimated noise, with the wider of the two sides' bands.

        link, motor: noise of the encoders; None for a side that was not recorded.
        """
        sides = [side for side in (link, motor) if side is not None]
        if not sides:
            raise IdentificationError(
                "no positions were recorded", "Record /joint_states or /motor_states."
            )
        cutoff = max(side.cutoff for side in sides)
        of_link = _crossover(link, cutoff, rate, n)
        of_motor = _crossover(motor, cutoff, rate, n)
        return Smoother(rate, cutoff, of_link, of_motor, link, motor)

    def steeper(self, cutoff: float) -> Smoother:
        """Return a smoother of a steeper response, of a cutoff (rad/s) or the highest at which it
        leaves motion whole up to a fifth of the sample rate."""
        return replace(self, cutoff=min(cutoff, HIGHEST_STEEP_CUTOFF * self.rate), order=STEEP)

    @functools.cached_property
    def noise(self) -> StateNoise | None:
        """What the encoders' noise leaves in the smoothed motion; None where it is not known."""
        link = self._covariances(self.link_noise, self.link_crossover)
        motor = self._covariances(self.motor_noise, self.motor_crossover)
        return None if link is None and motor is None else StateNoise(link, motor)

    @property
    def lag(self) -> int:
        """Samples between a measurement and the estimate that has seen enough of the future."""
        decay = np.sin(np.pi / (2 * self.order)) * self.cutoff / self.rate
        return int(np.ceil(-np.log(TAIL) / decay))

    @property
    def thinning(self) -> int:
        """Of how many smoothed samples one holds all their information: a power of two."""
        share = min(2 * np.pi * self.rate / (SAMPLES_A_PERIOD * self.cutoff), MOST_THINNING)
        return 2 ** max(0, int(np.log2(share)))

    def __call__(self, grid: Grid, every: int = 1) -> Motion:
        """Smooth a regular piece, and keep one of `every` samples; `lag` samples are lost at each
        end."""
        lag = self.lag
        self._require(len(grid))
        q = self._side(grid.q, grid.dq, self.link_crossover, every)
        theta = self._side(grid.theta, grid.dtheta, self.motor_crossover, every)
        return Motion(
            grid.t[lag:-lag:every],
            q[0],
            q[1],
            q[2],
            theta[0],
            theta[1],
            theta[2],
            None if grid.tau_J is None else self.filter(instantaneous(grid.tau_J), every),
            None if grid.tau_m is None else self.filter(instantaneous(grid.tau_m), every),
            noise=self.noise,
            every=every,
            lacking=grid.lacking,
            r=None if grid.r is None else self.filter(grid.r, every),
        )

    def filter(self, values: Array, every: int = 1) -> Array:
        """Filter columns (N, m) with H and keep one of `every` samples.

        `lag` samples are lost at each end.
        """
        self._require(len(values))
        response = _even_taps(self.cutoff / self.rate, self.lag, self.order)[None, None]
        out = np.zeros((-(-(len(values) - 2 * self.lag) // every), values.shape[1]))
        # Column by column: NumPy is slow along the first axis of a narrow array.
        used = [k for k, column in enumerate(values.T) if column.any()]
        for k in range(0, len(used), TOGETHER):
            columns = used[k : k + TOGETHER]
            out[:, columns] = convolve([values[:, columns]], response, every)[0]
        return out

    def sign(self, t: Array, velocity: Array, standstill: Array) -> Array:
        """Return the sign (N, n) of a velocity as smoothed residuals hold it.

        A jump is between two samples and has no band: the sign is taken at finer steps, and passes
        the smoother there.

        t, velocity: (N,) s and (N, n) rad/s; standstill: (n,) rad/s, below which a velocity has no
        sign.
        """
        fine = np.linspace(t[0], t[-1], (len(t) - 1) * FINER + 1)
        return self.thinned(np.tanh(CubicSpline(t, velocity)(fine) / standstill), FINER)

    def thinned(self, values: Array, finer: int) -> Array:
        """Filter values (N, m) of `finer` times the rate and keep one of `finer`.

        The ends are continued.
        """
        lag = self.lag * finer
        response = _even_taps(self.cutoff / (self.rate * finer), lag, self.order)[None, None]
        continued = np.pad(values, ((lag, lag), (0, 0)), mode="edge")
        return convolve([continued], response, finer)[0]

    def _require(self, samples: int) -> None:
        if samples <= 2 * self.lag:
            raise IdentificationError(
                f"an interval of {samples / self.rate:.2f} s is too short for the smoother,"
                f" which needs more than {2 * self.lag / self.rate:.2f} s",
                "Record longer without gaps.",
            )

    def _side(
        self, position: Array | None, velocity: Array | None, crossover: Array, every: int
    ) -> list[Array | None]:
        if position is None:
            return [None, None, None]
        out = np.empty((3, -(-(len(position) - 2 * self.lag) // every), position.shape[1]))
        middle = np.array([column.mean() for column in position.T])
        crossover = crossover if velocity is not None else np.full_like(crossover, np.inf)
        for w in np.unique(crossover):
            alike = np.flatnonzero(crossover == w)
            signals = [position[:, alike] - middle[alike]]
            if velocity is not None and np.isfinite(w):
                signals.append(velocity[:, alike] / self.rate)
            out[:, :, alike] = convolve(
                signals, np.stack(self._taps(w)[: len(signals)], axis=1), every
            )
        out[0] += middle
        return [out[0], out[1] * self.rate, out[2] * self.rate**2]

    def _covariances(self, noise: SideNoise | None, crossover: Array) -> Array | None:
        """Return covariances (n, 3, 3) of position, velocity and acceleration from a side's white
        noise."""
        if noise is None:
            return None
        unit = self.rate ** np.arange(3.0)
        found = np.empty((len(crossover), 3, 3))
        for i, w in enumerate(crossover):
            position, velocity = self._taps(w)
            found[i] = noise.white_position[i] ** 2 * (position @ position.T)
            if noise.white_velocity is not None and np.isfinite(w):
                found[i] += (noise.white_velocity[i] / self.rate) ** 2 * (velocity @ velocity.T)
        return found * np.outer(unit, unit)

    def _taps(self, crossover: float) -> tuple[Array, Array]:
        """Return taps on position and on velocity (rad per sample), (3, 2 lag + 1) each, for
        derivatives 0, 1, 2."""
        return _taps(self.cutoff / self.rate, crossover / self.rate, self.lag, self.order)


def instantaneous(torque: Array) -> Array:
    """Return torques (N, n) at their stamps from means over the sample intervals centred there.

    The mean over an interval h is f + h² f''/24 + O(h⁴); this takes the second term off.
    """
    inner = (26.0 * torque[1:-1] - torque[:-2] - torque[2:]) / 24.0
    return np.concatenate([torque[:1], inner, torque[-1:]])


def design_smoother(grids: list[Grid], n: int) -> Smoother:
    """Design the smoother for a recording from the noise in its longest piece.

    Raises an IdentificationError if there is none of a few dozen samples.
    """
    if not grids:
        raise IdentificationError(
            "there are gaps after every few samples", "Record several seconds of motion."
        )
    grid = max(grids, key=len)

    def noise(side: tuple[Array | None, Array | None]) -> SideNoise | None:
        position, velocity = side
        return None if position is None else estimate_noise(position, velocity, grid.rate)

    link, motor = share_out(noise, ((grid.q, grid.dq), (grid.theta, grid.dtheta)))
    return Smoother.from_noise(grid.rate, link, motor, n)


def _crossover(side: SideNoise | None, cutoff: float, rate: float, n: int) -> Array:
    if side is None or side.velocity_std is None:
        return np.full(n, np.inf)
    # A slower crossover would lengthen the lag for frequencies at which the positions are good
    # enough.
    slowest = cutoff * np.sin(np.pi / (2 * ORDER))
    ratio = np.maximum(side.velocity_std / np.maximum(side.position_std, 1e-300), slowest)
    # Far beyond the band the velocities would have no say. And where positions are good enough,
    # they had better have none: under a torque held from sample to sample a velocity at the samples
    # is not quite that of the motion in the band, which biases what hangs on the difference of two
    # accelerations.
    acceleration_noise = side.position_std * cutoff**2.5 / np.sqrt(5 * np.pi * rate)
    return np.where((ratio > 100 * cutoff) | (acceleration_noise < NEGLIGIBLE), np.inf, ratio)


def _poles(cutoff: float, order: int) -> NDArray[np.complex128]:
    angle = np.pi * (1 + 2 * np.arange(2 * order)) / (2 * order)
    poles = cutoff * np.exp(1j * angle)
    return poles[poles.real < 0]


def _even_taps(cutoff: float, lag: int, order: int) -> Array:
    """Sample the impulse response of H; time in samples."""
    return _taps(cutoff, np.inf, lag, order)[0][0]


@functools.lru_cache(maxsize=64)
def _taps(cutoff: float, crossover: float, lag: int, order: int) -> tuple[Array, Array]:
    """Sample the impulse responses of the smoother, time in samples."""
    t = np.arange(-lag, lag + 1)
    poles = _poles(cutoff, order)
    # H = 1 / (1 + (w / w_c)^(2 order)); residues of its left half-plane poles give the
    # response in |t|.
    residues = cutoff ** (2 * order) / (2 * order * poles ** (2 * order - 1))
    position = np.zeros((3, len(t)))
    velocity = np.zeros((3, len(t)))
    if np.isinf(crossover):
        for k in range(3):
            position[k] = _response(poles, residues, t, k)
    else:
        # e = H / (w_x² - s²): positions enter through w_x² e, velocities through -s e.
        residues = residues / (crossover**2 - poles**2)
        pole = -crossover
        value = 1.0 / (1.0 + (pole / cutoff) ** (2 * order))
        poles = np.append(poles, pole)
        residues = np.append(residues, value / (2 * crossover))
        for k in range(3):
            position[k] = crossover**2 * _response(poles, residues, t, k)
            velocity[k] = -_response(poles, residues, t, k + 1)
    return _exact_on_cubics(position, velocity, t, cutoff), velocity


def _response(
    poles: NDArray[np.complex128], residues: NDArray[np.complex128], t: NDArray[np.int_], k: int
) -> Array:
    """Return the k-th derivative of the two-sided response sum r exp(p |t|)."""
    values = (residues * poles**k) @ np.exp(np.outer(poles, np.abs(t)))
    parity = np.where(t < 0, (-1.0) ** k, 1.0)
    if k % 2:
        parity = np.where(t == 0, 0.0, parity)
    return np.real(values) * parity


def _exact_on_cubics(position: Array, velocity: Array, t: NDArray[np.int_], cutoff: float) -> Array:
    """Mend what sampling and cutting the taps took: cubic motion comes out exactly.

    The correction is a small polynomial under a bell as wide as the response.
    """
    bell = np.exp(-0.5 * (cutoff * t) ** 2)
    wanted = {0: (1.0, 0.0), 1: (1.0, 0.0), 2: (0.0, 2.0)}
    mended = position.copy()
    for k, targets in wanted.items():
        powers = (0, 2) if k % 2 == 0 else (1, 3)
        # Convolution reads the past with positive taps: y(0) = sum h(n) f(-n).
        monomials = np.array([(-t.astype(float)) ** p for p in powers])
        rates = np.array([p * (-t.astype(float)) ** max(p - 1, 0) for p in powers])
        got = monomials @ position[k] + rates @ velocity[k]
        shapes = bell * monomials
        mended[k] += np.linalg.solve(monomials @ shapes.T, np.array(targets) - got) @ shapes
    return mended


def runs(grid: Grid, lost: int) -> Iterator[Grid]:
    """Cut a regular piece into runs that overlap by what the smoother loses."""
    for start in range(0, max(len(grid) - lost, 1), RUN):
        yield grid[start : start + RUN + lost]


def left_out(grids: Sequence[Grid], used: Sequence[Grid]) -> tuple[str, ...]:
    """Return in words which pieces between gaps are too short for the smoother."""
    kept = sum(map(len, used))
    whole = sum(map(len, grids))
    if len(used) == len(grids):
        return ()
    pieces = f"{len(grids) - len(used)} of {len(grids)} intervals between gaps"
    return (f"{pieces} are too short and excluded, {whole - kept} of {whole} samples",)


def with_ends(grid: Grid, lost: int) -> Grid:
    """Return a piece continued at both ends, if they are a good part of it and the arm moves there.

    lost: samples that the smoother loses at both ends together.
    """
    most = min(lost // 2, len(grid) - 2)
    more = most - int(np.ceil(0.5 * lost * np.log(FOREIGN) / np.log(TAIL)))
    if more <= 0 or lost < LOST * len(grid) or not _moves_at_ends(grid, lost // 2):
        return grid
    return extended(grid, more)


def _moves_at_ends(grid: Grid, count: int) -> bool:
    position = grid.theta if grid.theta is not None else grid.q
    if position is None:
        return False
    speed = np.diff(position, axis=0)
    whole = rms(speed, None)
    ends = rms(np.concatenate([speed[:count], speed[-count:]]), None)
    return bool(ends > MOVING * whole)
