"""Find torques with less noise than any converter: they were low-passed before they were recorded,
or computed."""

from dataclasses import dataclass

import numpy as np
import scipy

from elastic_arm.arrays import Mask, median_step
from elastic_arm.recording.inspection.report import FEWEST
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, joints_with

# A torque of 16 bits, six standard deviations wide, rounds at -91 dB of its variance: no converter
# gives less noise.
NOISELESS = -95.0
WINDOW = ("kaiser", 24.0)  # side lobes below -180 dB
# dB a decade, from where on a low pass is what makes the spectrum fall: noise is flat, friction
# that jumps gives 20.
STEEP = 80.0
STEPS_PER_DECADE = 50  # of frequencies
SPAN = 10  # frequencies that a slope is taken over


@dataclass(frozen=True, eq=False)
class TorqueSpectrum:
    """The high frequencies of the torques of one side."""

    # (n,) dB of the torque's variance, if it were white: the noise in the upper part of the
    # spectrum
    level: Array
    # (n,) whether it is that of white noise, and yet less than any converter's
    computed: Mask
    low_passed: Mask  # (n,) whether there is none at all
    # (n,) Hz, above which a torque that was low-passed holds nothing; infinite for others
    end: Array
    # (n,) Hz, from which on it falls as steeply as nothing but a low pass does, up to its end;
    # infinite for others
    knee: Array

    @property
    def band(self) -> float:
        """Hz, up to which torques are those of the motion.

        The joints of a side pass one kind of filter.
        """
        # 0.9 of the knee: there a filter of the eighth order has taken 3 dB, at the knee itself 6
        return (
            0.9 * float(np.median(self.knee[self.low_passed]))
            if self.low_passed.any()
            else float("inf")
        )


def torque_spectrum(effort: Array, rate: float) -> TorqueSpectrum:
    """Analyse the high frequencies of torques."""
    effort = np.where(joints_with(effort), effort, 0.0)
    varying = effort.std(axis=0) > 0.0
    rows = min(1024, len(effort) // 2)
    # Windows of one joint lie together: through all joints at once they would be taken number by
    # number.
    columns = np.ascontiguousarray(effort.T)
    frequency, power = scipy.signal.welch(columns, rate, WINDOW, rows, detrend=without_line)
    power = power.T
    white = np.where(varying, effort.var(axis=0), 1.0) / (0.5 * rate)
    level = 10.0 * np.log10(np.maximum(power / white, 1e-30))
    middle = _between(frequency / (0.5 * rate), level, 0.3, 0.5)
    top = _between(frequency / (0.5 * rate), level, 0.7, 0.95)
    quiet = varying & (top < NOISELESS)
    # 10.0 dB: white noise over the upper two thirds of the band
    # -150.0 dB: nothing is left but the rounding of floating-point numbers
    computed = quiet & (middle - top < 10.0) & (top > -150.0)
    # A straight line has no spectrum to speak of.
    low_passed = quiet & ~computed & (level > NOISELESS).any(axis=0)
    end, knee = np.full((2, effort.shape[1]), np.inf)
    for j in np.flatnonzero(low_passed):
        last = int(np.flatnonzero(level[:, j] > NOISELESS)[-1])
        end[j] = frequency[last]
        knee[j] = _knee(frequency[: last + 1], level[: last + 1, j])
    return TorqueSpectrum(top, computed, low_passed, end, knee)


def without_line(pieces: Array) -> Array:
    """Return pieces (…, N) of a signal without their linear trends; SciPy would solve a
    least-squares problem for each."""
    t = np.linspace(-1.0, 1.0, pieces.shape[-1])
    left = pieces - pieces.mean(axis=-1, keepdims=True)
    return left - (left @ t)[..., None] * (t / max(float(t @ t), 1e-300))


def torque_spectra(recording: Recording) -> dict[str, TorqueSpectrum]:
    """Return the spectra of link and motor torques, if they are long enough.

    Torques that were computed from commands, or held, have no spectrum.
    """
    found: dict[str, TorqueSpectrum] = {}
    if recording.made_by or recording.read_ns is not None:
        return found
    for name, side in (("link", recording.link), ("motor", recording.motor)):
        if side is not None and side.effort is not None and len(side) >= FEWEST:
            rate = 1e9 / median_step(side.stamp_ns)
            found[name] = torque_spectrum(side.effort, rate)
    return found


def _knee(frequency: Array, level: Array) -> float:
    """Return the frequency, Hz, above which the level falls steeply to the end of the spectrum."""
    if len(frequency) < 3:
        return float(frequency[-1])
    at = np.arange(np.log10(frequency[1]), np.log10(frequency[-1]), 1.0 / STEPS_PER_DECADE)
    values = np.interp(at, np.log10(frequency[1:]), level[1:])
    if len(at) <= SPAN:
        return float(frequency[-1])
    gentle = np.flatnonzero((values[SPAN:] - values[:-SPAN]) * STEPS_PER_DECADE / SPAN > -STEEP)
    steep = int(gentle[-1]) + 1 if len(gentle) else 0
    # Half of the first steep span is the bend of the filter.
    return float(10.0 ** at[min(steep + SPAN // 2, len(at) - 1)])


def _between(share: Array, level: Array, low: float, high: float) -> Array:
    return np.median(level[(share > low) & (share < high)], axis=0)
