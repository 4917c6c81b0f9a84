"""Compare two recordings of the same commands channel by channel, without a model."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Array, rms
from elastic_arm.errors import RecordingError
from elastic_arm.recording.recording import Recording

STEPS = 5  # Gauss-Newton, each some ten times closer
SHORTEST = 1.0  # s that two recordings have to share
ALIKE = 0.5  # correlation of the two motions, below which they are of other commands; convention


@dataclass(frozen=True)
class ChannelDifference:
    """The difference of one channel between two recordings, (n,) each."""

    channel: str  # Its name in equation (1): q, dq, tau_J, theta, dtheta, tau_m
    rms: Array  # Of real minus simulated: rad, rad/s or Nm
    largest: Array
    mean: Array
    share: Array  # Root mean square over the standard deviation of the real channel
    # s by which the real channel is later than the simulated one, beyond what is common to all; NaN
    # where it stands
    lag: Array
    apart: Array  # (N, n) real minus simulated, for figures


@dataclass(frozen=True)
class RecordingDifference:
    """The differences between two recordings of the same commands."""

    joints: tuple[str, ...]  # Names
    offset: float  # s to add to times of the real recording for those of the simulated one
    # "reference", or the channel that was brought to cover where no reference was recorded
    aligned_by: str
    t: Array  # (N,) s of the real recording that both hold
    channels: tuple[ChannelDifference, ...]  # What both hold

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        names = ("rms", "largest", "mean", "share", "lag")
        channels: dict[str, dict[str, dict[str, float | None]]] = {}
        for one in self.channels:
            by_joint = channels.setdefault(one.channel, {})
            for k, joint in enumerate(self.joints):
                by_joint[joint] = {name: _number(getattr(one, name)[k]) for name in names}
        return {
            "offset_s": float(f"{self.offset:.6g}"),
            "aligned_by": self.aligned_by,
            "seconds": float(f"{np.ptp(self.t):.6g}"),
            "channels": channels,
        }


def differences(real: Recording, simulated: Recording) -> RecordingDifference:
    """Compare two recordings of the same commands."""
    simulated = simulated.select(real.joints)
    name, ours, theirs = _commands(real, simulated)
    offset = _offset(*ours, *theirs, name)
    a = real.samples()
    b = simulated.samples()
    t = a.t + (real.start_ns - _origin(real)) * 1e-9
    t_other = b.t + (simulated.start_ns - _origin(simulated)) * 1e-9
    inside = (t + offset >= t_other[0]) & (t + offset <= t_other[-1])
    seconds = float(np.ptp(t[inside])) if inside.any() else 0.0
    if seconds < SHORTEST:
        raise RecordingError(
            f"{_named(real)} and {_named(simulated)} have only {seconds:.2g} s in common",
            "Record the same motion",
        )
    found = []
    theirs_too = b.recorded()
    for channel, own in a.recorded().items():
        if channel in theirs_too:
            other = CubicSpline(t_other, theirs_too[channel])
            found.append(_channel(channel, t[inside], own[inside], other, offset))
    if not found:
        raise RecordingError(
            f"{_named(real)} and {_named(simulated)} have no channel in common",
            "Record the same topics",
        )
    return RecordingDifference(real.joints, offset, name, t[inside], tuple(found))


def _channel(
    name: str, t: Array, values: Array, other: CubicSpline, offset: float
) -> ChannelDifference:
    apart = values - other(t + offset)
    rate = other(t + offset, 1)
    spread = values.std(axis=0)
    power = np.sum(rate**2, axis=0)
    size = rms(apart)
    with np.errstate(divide="ignore", invalid="ignore"):
        lag = np.where(power > 0.0, -np.sum(apart * rate, axis=0) / power, np.nan)
        share = np.where(spread > 0.0, size / spread, np.nan)
    largest = np.abs(apart).max(axis=0)
    return ChannelDifference(name, size, largest, apart.mean(axis=0), share, lag, apart)


def _origin(recording: Recording) -> int:
    return min(int(side.stamp_ns[0]) for side in recording.sides().values())


def _commands(
    real: Recording, simulated: Recording
) -> tuple[str, tuple[Array, Array], tuple[Array, Array]]:
    """Return the motions by which the two are aligned: times (N,) s from each origin, and positions
    (N, n)."""
    for name in ("reference", "motor", "link"):
        sides = [recording.sides().get(name) for recording in (real, simulated)]
        pairs: list[tuple[Array, Array]] = [
            (np.asarray((side.stamp_ns - _origin(recording)) * 1e-9), side.position)
            for side, recording in zip(sides, (real, simulated), strict=True)
            if side is not None and side.position is not None
        ]
        if len(pairs) == 2:
            return name, pairs[0], pairs[1]
    raise RecordingError(
        f"{_named(real)} and {_named(simulated)} have neither reference nor positions in common",
        "Record the same topics",
    )


def _offset(t: Array, values: Array, t_other: Array, other: Array, name: str) -> float:
    """Return the time in s to add to one recording to align it with the other: first in steps, then
    refined."""
    step = 0.01  # s, at which the two are shifted over each other; steps then mend the time
    rates = [_on_grid(*pair, step) for pair in ((t, values), (t_other, other))]
    count = sum(len(rate) for rate in rates)
    spectra = [np.fft.rfft(rate, count, axis=0) for rate in rates]
    size = np.sqrt(np.sum(rates[0] ** 2) * np.sum(rates[1] ** 2))
    score = np.fft.irfft(np.sum(spectra[0].conj() * spectra[1], axis=1), count) / max(size, 1e-300)
    best = int(np.argmax(score))
    if score[best] < ALIKE:
        raise RecordingError(
            "the two recordings contain different motions: the correlation of their"
            f" {name} velocities is {score[best]:.2f}",
            "Give two recordings of the same commands",
        )
    offset = (best if best < len(rates[1]) else best - count) * step + t_other[0] - t[0]
    spline = CubicSpline(t_other, other)
    for _ in range(STEPS):
        inside = (t + offset >= t_other[0]) & (t + offset <= t_other[-1])
        rate = spline(t[inside] + offset, 1)
        apart = values[inside] - spline(t[inside] + offset)
        apart = apart - apart.mean(axis=0)
        offset += float(np.sum(apart * rate)) / max(float(np.sum(rate**2)), 1e-300)
    return offset


def _on_grid(t: Array, values: Array, step: float) -> Array:
    """Return the velocities (M, n) on a grid; positions would correlate through their mean
    values."""
    grid = np.arange(t[0], t[-1], step)
    return CubicSpline(t, values)(grid, 1)


def _named(recording: Recording) -> str:
    return recording.source or "the recording"


def _number(value: float) -> float | None:
    return float(f"{value:.5g}") if np.isfinite(value) else None
