"""Resampling to a regular time grid: holes, gaps and jittered stamps.

A smoother with steady-state gains needs regular samples. Short holes are interpolated, and long
ones split the recording. Jittered stamps are either true (the sensor was read at these times), or
delayed stamps of regular samples; the smoothness of the motion decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from elastic_arm.arrays import Array, Indices
from elastic_arm.errors import IdentificationError
from elastic_arm.recording import Samples
from elastic_arm.recording.inspection.report import UNIT, wrong_rate
from elastic_arm.recording.inspection.stuck_channels import STILL
from elastic_arm.recording.sides import ClockMode as Mode
from elastic_arm.recording.sides import Lacking
from elastic_arm.recording.timebase.clocks import (
    MISSING,
    bunched,
    evidence,
    increments,
    is_even,
    numbered,
    unbroken,
    wanders,
)

CHANNELS = ("q", "dq", "tau_J", "theta", "dtheta", "tau_m", "r")
_OF_ALL = ("notes", "clock", "lacking", "read")  # what samples have once for all of them

# Up to this many missing samples in a row are interpolated; the smoother would hardly notice them.
LONGEST_HOLE = 4
# Or up to so many seconds of them: half a period of 40 Hz, up to which residuals are looked at.
LONGEST_HOLE_SECONDS = 0.0125
POINTS = 6
# A piece of fewer samples is left out, and as many on either side carry the motion across a long
# hole.
SHORTEST = 2 * POINTS
# Samples beyond a point that it takes to interpolate there, and one for rounding.
AROUND = SHORTEST + 1


@dataclass(frozen=True)
class Grid:
    """Channels on a regular time grid, without a hole."""

    t: Array  # (N,) s
    rate: float  # samples per second
    # q, dq, tau_J, theta, dtheta, tau_m, r: (N, n) or None
    q: Array | None = None
    dq: Array | None = None
    tau_J: Array | None = None
    theta: Array | None = None
    dtheta: Array | None = None
    tau_m: Array | None = None
    # channels with the index of a joint that lacks them, see :class:`elastic_arm.recording.Samples`
    lacking: Lacking = frozenset()
    r: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, part: slice | Indices) -> Grid:
        kept: dict[str, Any] = {name: values[part] for name, values in self.channels().items()}
        return replace(self, t=self.t[part], **kept)

    @staticmethod
    def joined(parts: Sequence[Grid]) -> Grid:
        """Put parts with the same channels, each the continuation of the one before, together."""
        if len(parts) == 1:
            return parts[0]
        names = parts[0].channels()
        together: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in names
        }
        return replace(parts[0], t=np.concatenate([part.t for part in parts]), **together)

    def channels(self) -> dict[str, Array]:
        """Return the channels that are there, by name."""
        return {name: values for name in CHANNELS if (values := getattr(self, name)) is not None}

    def moves(self) -> bool:
        """Return whether any joint does, by the motor's angles where there are some."""
        position = self.theta if self.theta is not None else self.q
        return position is not None and any(np.ptp(column) >= STILL for column in position.T)


@dataclass(frozen=True)
class Clock:
    """How stamps become a grid."""

    rate: float  # samples per second
    # "regular": samples were taken regularly, whatever their stamps are; "stamps": at their stamps
    mode: Mode = "regular"
    note: str = field(default="", compare=False)  # why, in words; empty where stamps are regular
    missing: float = (
        MISSING  # intervals between two stamps from which a sample is missing between them
    )

    @staticmethod
    def of(samples: Samples, source: str = "the recording") -> Clock:
        """Find the rate, and the mode of the clock unless `samples.clock` gives it.

        Raises an IdentificationError if there are too few samples, time does not advance, or no arm
        is recorded at such a rate.
        """
        if len(samples) < 2 * POINTS:
            raise IdentificationError(
                f"{len(samples)} samples are not sufficient", "Record several seconds of motion."
            )
        step = np.diff(samples.t)
        if not np.all(step > 0):
            at = int(np.argmax(step <= 0))
            raise IdentificationError(
                f"time does not increase at {samples.t[at]:.4f} s",
                "Repair it with `elastic-arm bag check`.",
            )
        k, rate, missing, jitter = numbered(samples.t)
        wrong = wrong_rate(rate)
        if wrong is not None:
            raise IdentificationError(f"{source}: {wrong}", UNIT)
        if samples.clock is not None:
            return Clock(
                rate, samples.clock, f"clock as requested: {_MEANING[samples.clock]}", missing
            )
        mode, note = _mode(samples, k, rate, jitter)
        if mode == "stamps" and wanders(jitter, rate):
            # Whatever is missing: points as dense as the samples, and alike in recordings of one
            # source.
            rate = 1.0 / bunched(samples.t)
        return Clock(rate, mode, note, missing)

    @property
    def longest_hole(self) -> int:
        """Samples missing in a row of which nothing is lost that an arm does."""
        return max(LONGEST_HOLE, int(LONGEST_HOLE_SECONDS * self.rate))

    def place(self, samples: Samples, longest: int | None = None) -> list[Grid]:
        """Return the regular pieces of the samples; up to `longest` missing ones are bridged."""
        return [
            segment.grid
            for segment in Placing(self, longest).add(samples, last=True)
            if segment.grid is not None
        ]


class Segment(NamedTuple):
    """The next points of a piece, None where there are none; whether the piece ends with them."""

    grid: Grid | None
    ends: bool


class Placing:
    """Places samples as they come: the points do not depend on how the samples are cut.

    A point is made once the samples on both sides of it are there, from samples as they were
    recorded, on a grid that begins with the first sample of its piece.
    """

    def __init__(self, clock: Clock, longest: int | None = None) -> None:
        self.clock = clock
        self._longest = longest or clock.longest_hole
        self._kept: Samples | None = None
        self._begin()

    def add(self, samples: Samples | None, last: bool = False) -> Iterator[Segment]:
        """Take later samples and yield the points that they complete.

        The last samples complete all points.
        """
        held = [each for each in (self._kept, samples) if each is not None]
        if not held:
            return
        whole = held[0] if len(held) == 1 else joined(*held)
        gaps = np.flatnonzero(self._steps(whole.t) > self._longest + 1) + 1
        edges = [0, *gaps.tolist(), len(whole)]
        for first, stop in pairwise(edges):
            ends = last or stop < len(whole)
            piece = whole if stop - first == len(whole) else part(whole, slice(first, stop))
            yield Segment(self._points(piece, ends), ends)
            if ends:
                self._begin()

    def _begin(self) -> None:
        """Begin a new piece."""
        self._kept = None
        self._origin: float | None = None
        self._first = 0  # grid index of the first sample kept, where samples are regular
        self._next = 0  # grid index of the next point

    def _steps(self, t: Array) -> NDArray[np.int64]:
        """Return how many points of the grid lie between the samples."""
        return increments(np.diff(t) * self.clock.rate, self.clock.missing)

    def _points(self, piece: Samples, ends: bool) -> Grid | None:
        if self._origin is None:
            if len(piece) < SHORTEST:
                self._kept = piece
                return None
            self._origin = float(piece.t[0])
        if self.clock.mode == "stamps":
            position = (piece.t - self._origin) * self.clock.rate
        else:
            position = self._first + np.concatenate([[0], np.cumsum(self._steps(piece.t))])
        last = int(np.floor(position[-1 if ends else -AROUND]))
        grid = (
            self._grid(piece, position, np.arange(self._next, last + 1))
            if last >= self._next
            else None
        )
        self._next = max(self._next, last + 1)
        # As many samples stay as the next point needs before it.
        kept = max(int(np.searchsorted(position, self._next)) - AROUND, 0)
        self._first = int(position[kept])
        self._kept = part(piece, slice(kept, None))
        return grid

    def _grid(self, piece: Samples, position: Array, points: NDArray[np.int64]) -> Grid:
        channels = {
            name: values for name in CHANNELS if (values := getattr(piece, name)) is not None
        }
        rate = self.clock.rate
        lacking = piece.lacking
        if self.clock.mode == "stamps":
            t = (self._origin or 0.0) + points / rate
            there = {
                name: interpolate(piece.t, values, t, 1.0 / rate)
                for name, values in channels.items()
            }
            return Grid(t, rate, **there, lacking=lacking)
        begin, end = np.searchsorted(position, points[[0, -1]])
        # The last point is a sample.
        inside = slice(int(begin), int(end) + 1)
        k = position[inside]
        if len(k) == len(points):
            there = {name: values[inside] for name, values in channels.items()}
            return Grid(piece.t[inside], rate, **there, lacking=lacking)
        missing = np.setdiff1d(points, k)
        filled = {}
        for name, values in channels.items():
            column = np.empty((len(points), values.shape[1]))
            column[k - points[0]] = values[inside]
            column[missing - points[0]] = interpolate(
                position.astype(float), values, missing.astype(float), 1.0
            )
            filled[name] = column
        return Grid(np.interp(points, position, piece.t), rate, **filled, lacking=lacking)


def read_at(t: Array, read: Array | None) -> Indices:
    """Return which of the times t (N,) are those at which torques were read.

    All where none are given.
    """
    if read is None:
        return np.arange(len(t))
    k = np.rint((read - t[0]) / (t[1] - t[0])).astype(np.intp)
    return np.unique(k[(k >= 0) & (k < len(t))])


def interpolate(known: Array, values: Array, wanted: Array, step: float) -> Array:
    """Interpolate columns (N, n) by the polynomial through the six nearest points.

    The times are increasing.

    Across a hole it is that of least squares through more on either side, the more are missing:
    noise does not grow.

    known: (N,) increasing times; values: (N, n) at these times; wanted: (M,) times; step: between
    samples.
    """
    first = np.clip(np.searchsorted(known, wanted) - POINTS // 2, 0, len(known) - POINTS)
    index = first[:, None] + np.arange(POINTS)
    node = known[index]
    weights = np.ones_like(node)
    for j in range(POINTS):
        for i in range(POINTS):
            if i != j:
                weights[:, j] *= (wanted - node[:, i]) / (node[:, j] - node[:, i])
    found = np.einsum("kj,kjn->kn", weights, values[index])
    missing = np.rint(np.diff(known) / step).astype(int) - 1
    for hole in np.flatnonzero(missing > POINTS // 2):
        inside = slice(*np.searchsorted(wanted, known[hole : hole + 2]))
        count = min(missing[hole], SHORTEST)
        near = slice(max(hole + 1 - count, 0), hole + 1 + count)
        middle = known[hole : hole + 2].mean()
        half = np.ptp(known[near]) / 2.0
        there = legvander((known[near] - middle) / half, POINTS - 1)
        at = legvander((wanted[inside] - middle) / half, POINTS - 1)
        found[inside] = at @ np.linalg.lstsq(there, values[near])[0]
    return found


def part(samples: Samples, piece: slice | NDArray[Any]) -> Samples:
    """Return some of the samples."""
    kept: dict[str, Any] = {
        f.name: None if (v := getattr(samples, f.name)) is None else v[piece]
        for f in fields(Samples)
        if f.name not in _OF_ALL
    }
    return Samples(**kept, clock=samples.clock, lacking=samples.lacking, read=samples.read)


def joined(first: Samples, second: Samples) -> Samples:
    """Return samples with later ones after them; both hold the same channels."""
    kept: dict[str, Any] = {}
    for name in (f.name for f in fields(Samples) if f.name not in _OF_ALL):
        a = getattr(first, name)
        b = getattr(second, name)
        if (a is None) != (b is None):
            raise IdentificationError(
                f"{name} is in only one part of the samples",
                "Identify recordings with the same channels.",
            )
        kept[name] = None if a is None else np.concatenate([a, b])
    if first.lacking != second.lacking:
        raise IdentificationError(
            "a joint has a channel in only one part of the samples",
            "Identify recordings with the same channels.",
        )
    return Samples(**kept, clock=first.clock, lacking=first.lacking, read=first.read)


_MEANING: dict[Mode, str] = {
    "stamps": "the stamps are used as sample times",
    "regular": "regular sample times are used instead of the stamps",
}


def _mode(samples: Samples, k: NDArray[np.int64], rate: float, jitter: Array) -> tuple[Mode, str]:
    """Return what the stamps mean, and why."""
    position = samples.q if samples.q is not None else samples.theta
    if position is None:
        raise IdentificationError(
            "no positions were recorded", "Record /joint_states or /motor_states."
        )
    if is_even(jitter, rate):
        return "regular", ""
    found = evidence(samples, k, rate)
    size = f"stamps jitter by {1e3 * np.std(np.diff(jitter)) / np.sqrt(2):.2g} ms"
    if found is not None:
        mode: Mode = "stamps" if found.stamps else "regular"
        share = f"{round(found.share, 2) + 0.0:.2g} ± {max(found.std, 0.01):.1g} of the jitter"
        numbers = f" with {share} as true time" if found.std > 0 else ""
        return mode, f"{size}; {_MEANING[mode]}: {found.words}{numbers} (--clock overrides it)"
    piece = unbroken(k)
    regular = _roughness(position[piece])
    t = samples.t[piece]
    wanted = t[0] + np.arange(POINTS, len(t) - POINTS) / rate
    stamped = _roughness(interpolate(t, position[piece], wanted[wanted < t[-1]], 1.0 / rate))
    mode = "stamps" if stamped < 0.8 * regular else "regular"
    why = (
        f"the motion does not decide: its roughness is {stamped:.2g} with stamps and"
        f" {regular:.2g} without"
    )
    return mode, f"{size}; assumed {mode}: {why} (--clock overrides it)"


def _roughness(position: Array) -> float:
    """Return a robust size of what a smooth motion does not have: its sixth differences; infinite
    without any."""
    rough = np.abs(np.diff(position, 6, axis=0))
    if not len(rough):
        return np.inf
    scale = np.std(position, axis=0)
    return float(np.median(rough / np.where(scale > 0, scale, 1.0)))


def extended(grid: Grid, count: int) -> Grid:
    """Continue a stretch at both ends by its mirror image, so that smoothing keeps its length.

    Angles are mirrored at the point, not at the line. Internal states need the motion from the
    first sample on. The rows made of it are dropped.

    Raises an IdentificationError if the stretch is shorter than that.
    """
    if len(grid) <= count:
        raise IdentificationError(
            f"{len(grid)} samples without a gap at {grid.rate:.3g} Hz are not sufficient"
            f" for the smoother, which needs more than {count}",
            "Record longer, or with more samples per second.",
        )
    channels = {}
    for name, values in grid.channels().items():
        through: Literal["odd", "even"] = "odd" if name in ("q", "theta", "r") else "even"
        channels[name] = np.pad(
            values, ((count, count), (0, 0)), mode="reflect", reflect_type=through
        )
    step = np.arange(1, count + 1) / grid.rate
    t = np.concatenate([grid.t[0] - step[::-1], grid.t, grid.t[-1] + step])
    return Grid(t, grid.rate, **channels, lacking=grid.lacking)
