"""The noise of torque channels, from their spectra above the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array, median_step, rms
from elastic_arm.estimation.resampling import Grid, read_at
from elastic_arm.recording.inspection.torque_spectrum import TorqueSpectrum

NARROWEST_BAND = 1.0  # Hz; the motion of an arm is slower than that nowhere
# Of a torque's rms: noise of one that was low-passed, within its band, and of a drive by which a
# torque is made, where nothing shows it; convention.
ORDINARY_NOISE = 0.005
NOISE_ALONE = 0.2  # of the sample rate; above, torque channels hold noise alone


@dataclass(frozen=True)
class Readings:
    """Readings of torques that are held between them."""

    times: Array  # s
    rate: float  # readings per second
    every: float  # samples of the other channels from one to the next

    @staticmethod
    def of(times: Array, rate: float) -> Readings:
        """Return the readings at `times`, s, beside channels of `rate` samples per second."""
        every = median_step(times) * rate
        return Readings(times, rate / every, every)


def torque_level(
    grids: Sequence[Grid],
    channel: str,
    spectrum: TorqueSpectrum | None,
    readings: Readings | None,
    singly: bool,
    *,
    made: Array,
) -> Array | None:
    """Return the standard deviation (n,) Nm of a torque channel's noise; None where not recorded.

    spectrum: of the channel, if it is long enough to have one; singly: readings are compared one by
    one, as they do not follow the motion; made: (n,) whether controllers make the torque of
    commands. What the noise of encoders makes of it is known by the controllers then, and the rest
    is the drive's.
    """
    longest = max(grids, key=len)
    torque = getattr(longest, channel)
    if torque is None:
        return None
    ordinary = ORDINARY_NOISE * np.std(torque, axis=0)
    if readings is None:
        level = torque_noise(grids, channel)
        measured = _with_low_pass(level, torque, spectrum, longest.rate)
        return None if measured is None else np.where(made, ordinary, measured)
    if singly:
        return ordinary * readings.every**0.5
    # They reach above the motion.
    level = torque_noise([grid[read_at(grid.t, readings.times)] for grid in grids], channel)
    return None if level is None else level * readings.every**0.5


def torque_noise(grids: Sequence[Grid], channel: str) -> Array | None:
    """Return the standard deviation (n,) of a torque channel's white noise.

    It is that of the spectrum above the motion. The median over frequency leaves single lines
    (ripple, mains) aside.
    """
    if getattr(grids[0], channel) is None:
        return None
    levels = []
    for grid in grids:
        values = getattr(grid, channel)
        taper = np.hanning(len(values) - 4)[:, None]
        # Fourth differences keep the motion's spectrum from leaking upward; their response is
        # divided out.
        transform = np.fft.rfft(np.diff(values, 4, axis=0) * taper, axis=0)
        spectrum = np.abs(transform) ** 2 / np.sum(taper**2)
        f = np.fft.rfftfreq(len(taper))
        above = f > NOISE_ALONE
        response = np.abs(2 * np.sin(np.pi * f[above]))[:, None] ** 8
        levels.append(np.median(spectrum[above] / response, axis=0) / np.log(2.0))
    weights = [len(grid) for grid in grids]
    return np.sqrt(np.average(levels, axis=0, weights=weights))


def _with_low_pass(
    level: Array | None, torque: Array, spectrum: TorqueSpectrum | None, rate: float
) -> Array | None:
    """Return the noise (n,) of a channel; where it was low-passed, at least an ordinary sensor's.

    level: (n,) Nm a sample, from frequencies at which a torque that was low-passed holds nothing;
    torque: (N, n) Nm.
    """
    if level is None or spectrum is None or not spectrum.low_passed.any():
        return level
    knee = np.minimum(np.maximum(spectrum.knee, NARROWEST_BAND), rate / 2)
    ordinary = ORDINARY_NOISE * rms(torque) * np.sqrt(0.5 * rate / knee)
    return np.where(spectrum.low_passed, np.maximum(level, ordinary), level)
