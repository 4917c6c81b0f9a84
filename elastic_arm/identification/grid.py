"""Samples brought to a regular time grid: holes, gaps and jittered stamps.

A smoother with steady-state gains needs regular samples. Short holes are bridged, long ones part the recording into
pieces. Stamps that jitter are either the truth (the sensor was read at those times) or only late words about samples
taken regularly; the smoothness of the motion tells which.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import IdentificationError
from elastic_arm.recording import Samples

Array = NDArray[np.float64]
CHANNELS = ("q", "dq", "tau_J", "theta", "dtheta", "tau_m")

# Up to this many missing samples in a row are interpolated; the smoother would hardly notice them.
LONGEST_HOLE = 4
# Two stamps further apart than this, in sample intervals, have a sample missing between them.
MISSING = 1.6
# Deviations of the stamps below this share of an interval change nothing.
NO_JITTER = 1e-3
POINTS = 6
# An arm whose joints all travel less than this, rad, stands still.
STILL = 1e-3
Mode = Literal["regular", "stamps"]


@dataclass(frozen=True)
class Grid:
    """Channels on a regular time grid, without a hole.

    Parameters
    ----------
    t
        (N,) s.
    rate
        Samples per second.
    q, dq, tau_J, theta, dtheta, tau_m
        (N, n) or None.
    """

    t: Array
    rate: float
    q: Array | None = None
    dq: Array | None = None
    tau_J: Array | None = None
    theta: Array | None = None
    dtheta: Array | None = None
    tau_m: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, part: slice) -> Grid:
        return Grid(self.t[part], self.rate, **{name: values[part] for name, values in self.channels().items()})

    def channels(self) -> dict[str, Array]:
        """Return the channels that are there, by name."""
        return {name: values for name in CHANNELS if (values := getattr(self, name)) is not None}

    def moves(self) -> bool:
        """Say whether any joint does, by the motor's angles where there are some."""
        position = self.theta if self.theta is not None else self.q
        return position is not None and bool(np.any(np.ptp(position, axis=0) >= STILL))


@dataclass(frozen=True)
class Clock:
    """How stamps become a grid.

    Parameters
    ----------
    rate
        Samples per second.
    mode
        "regular": samples were taken regularly, whatever their stamps say; "stamps": at their stamps.
    """

    rate: float
    mode: Mode = "regular"

    @staticmethod
    def of(samples: Samples) -> Clock:
        """Find rate and mode from the recording.

        Raises
        ------
        IdentificationError
            If there are too few samples, or time does not advance.
        """
        if len(samples) < 2 * POINTS:
            raise IdentificationError(f"{len(samples)} samples are too few", "Record some seconds of motion.")
        step = np.diff(samples.t)
        if not np.all(step > 0):
            at = int(np.argmax(step <= 0))
            raise IdentificationError(
                f"time stands still or runs back at {samples.t[at]:.4f} s", "Repair it with `elastic-arm bag check`."
            )
        k = np.concatenate([[0], np.cumsum(_increments(step * (1.0 / np.median(step))))])
        rate = float((k[-1] - k[0]) / (samples.t[-1] - samples.t[0]))
        return Clock(rate, _mode(samples, k, rate))

    def place(self, samples: Samples) -> list[Grid]:
        """Return the regular pieces of the samples."""
        channels = {name: values for name in CHANNELS if (values := getattr(samples, name)) is not None}
        steps = _increments(np.diff(samples.t) * self.rate)
        cuts = np.flatnonzero(steps > LONGEST_HOLE + 1) + 1
        pieces = []
        for part in np.split(np.arange(len(samples)), cuts):
            if len(part) >= 2 * POINTS:
                piece = slice(part[0], part[-1] + 1)
                cut = {name: values[piece] for name, values in channels.items()}
                pieces.append(self._piece(samples.t[piece], cut))
        return pieces

    def _piece(self, t: Array, channels: dict[str, Array]) -> Grid:
        if self.mode == "stamps":
            k = np.arange(int(np.floor((t[-1] - t[0]) * self.rate)) + 1)
            wanted = t[0] + k / self.rate
            return Grid(wanted, self.rate, **{name: interpolate(t, v, wanted) for name, v in channels.items()})
        k = np.concatenate([[0], np.cumsum(_increments(np.diff(t) * self.rate))])
        if k[-1] == len(t) - 1:
            return Grid(t, self.rate, **channels)
        every = np.arange(k[-1] + 1)
        missing = np.setdiff1d(every, k)
        filled = {}
        for name, values in channels.items():
            whole = np.empty((len(every), values.shape[1]))
            whole[k] = values
            whole[missing] = interpolate(k.astype(float), values, missing.astype(float))
            filled[name] = whole
        return Grid(np.interp(every, k, t), self.rate, **filled)


def interpolate(known: Array, values: Array, wanted: Array) -> Array:
    """Interpolate columns (N, n), known at increasing times, by the polynomial through the six nearest points."""
    first = np.clip(np.searchsorted(known, wanted) - POINTS // 2, 0, len(known) - POINTS)
    index = first[:, None] + np.arange(POINTS)
    node = known[index]
    weights = np.ones_like(node)
    for j in range(POINTS):
        for i in range(POINTS):
            if i != j:
                weights[:, j] *= (wanted - node[:, i]) / (node[:, j] - node[:, i])
    return np.einsum("kj,kjn->kn", weights, values[index])


def part(samples: Samples, piece: slice | NDArray[Any]) -> Samples:
    """Return some of the samples."""
    kept: dict[str, Any] = {
        f.name: None if (v := getattr(samples, f.name)) is None else v[piece]
        for f in fields(Samples)
        if f.name != "notes"
    }
    return Samples(**kept)


def joined(first: Samples, second: Samples) -> Samples:
    """Return samples with later ones after them; both hold the same channels."""
    kept: dict[str, Any] = {}
    for name in (f.name for f in fields(Samples) if f.name != "notes"):
        a, b = getattr(first, name), getattr(second, name)
        if (a is None) != (b is None):
            raise IdentificationError(
                f"{name} is in one part of the samples and not in the other", "Identify recordings with equal channels."
            )
        kept[name] = None if a is None else np.concatenate([a, b])
    return Samples(**kept)


def _increments(steps: Array) -> NDArray[np.int64]:
    """Return how many grid steps lie between samples."""
    return np.where(steps < MISSING, 1, np.rint(steps)).astype(np.int64)


def _mode(samples: Samples, k: NDArray[np.int64], rate: float) -> Mode:
    position = samples.q if samples.q is not None else samples.theta
    if position is None:
        raise IdentificationError("no positions were recorded", "Record /joint_states or /motor_states.")
    deviation = samples.t - np.polyval(np.polyfit(k, samples.t, 1), k)
    if np.std(np.diff(deviation)) * rate < NO_JITTER:
        return "regular"
    piece = slice(0, min(len(k), 20000))
    regular = _roughness(position[piece])
    t = samples.t[piece]
    wanted = t[0] + np.arange(POINTS, len(t) - POINTS) / rate
    stamped = _roughness(interpolate(t, position[piece], wanted[wanted < t[-1]]))
    # Where the encoders' noise hides the difference, it does not matter either.
    return "stamps" if stamped < 0.8 * regular else "regular"


def _roughness(position: Array) -> float:
    """Return a robust size of what a smooth motion does not have: its sixth differences."""
    rough = np.abs(np.diff(position, 6, axis=0))
    scale = np.std(position, axis=0)
    return float(np.median(rough / np.where(scale > 0, scale, 1.0)))
