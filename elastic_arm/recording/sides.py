"""The samples of an arm: one side of its joints, or both sides on one time base; and the names of
joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.errors import RecordingError

Stamps = NDArray[np.int64]

CHANNELS = ("position", "velocity", "effort", "acceleration", "pwm", "supply")
# Shares of full duty that a servo reports; a little more than 1 as registers round.
MOST_DUTY = 1.05
# Channels of :class:`Samples`, by the symbols of (1): side and channel of a recording.
SAMPLED = {
    "q": ("link", "position"), "dq": ("link", "velocity"), "tau_J": ("link", "effort"),
    "theta": ("motor", "position"), "dtheta": ("motor", "velocity"), "tau_m": ("motor", "effort"),
}  # fmt: skip

_LATEST = 2.0**63  # ns

# Samples were taken regularly, whatever their stamps; or at their stamps.
ClockMode = Literal["regular", "stamps"]

# Channels with the index of a joint that lacks it.
Lacking = frozenset[tuple[str, int]]


@dataclass(frozen=True)
class Side:
    """The samples of one side of all joints.

    Parameters
    ----------
    stamp_ns
        (N,) int64, nanoseconds, strictly increasing.
    position, velocity, effort, acceleration
        (N, n) rad, rad/s, Nm, rad/s²; None where not recorded. Torques and motor angles are reduced
        to the harmonic-drive output. Joints without the channel have NaN throughout.
    pwm
        (N, n) share of full duty that a servo applied to its motor, -1 to 1; None where not
        recorded.
    supply
        (N, n) voltage of the supply at a servo, V; None where not recorded.
    """

    stamp_ns: Stamps
    position: Array | None = None
    velocity: Array | None = None
    effort: Array | None = None
    acceleration: Array | None = None
    pwm: Array | None = None
    supply: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stamp_ns", _checked_stamps(self.stamp_ns))
        for name, values in self.channels().items():
            values = _real(name, values)
            object.__setattr__(self, name, values)
            if values.ndim != 2 or len(values) != len(self.stamp_ns):
                raise RecordingError(
                    f"{name} has shape {values.shape} for {len(self.stamp_ns)} stamps",
                    "Give one row per stamp and one column per joint.",
                )

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def holding(self) -> Side:
        """Return a copy without channels that no joint has."""
        there = {
            name: values for name, values in self.channels().items() if joints_with(values).any()
        }
        return Side(self.stamp_ns, **there)

    def channels(self) -> dict[str, Array]:
        """Return the channels that were recorded, by name."""
        return {name: values for name in CHANNELS if (values := getattr(self, name)) is not None}

    def spread(self, places: Sequence[int], n: int) -> Side:
        """Return the side as one of n joints of which these are some; the others contain NaN."""
        wide = {}
        for name, values in self.channels().items():
            wide[name] = np.full((len(self), n), np.nan)
            wide[name][:, places] = values
        return Side(self.stamp_ns, **wide)

    def filled(self, other: Side) -> Side:
        """Return this side with further channels and joints of `other`, at the same stamps."""
        mine = self.channels()
        both = {
            name: np.fmax(mine.get(name, values), values)
            for name, values in other.channels().items()
        }
        return Side(self.stamp_ns, **{**mine, **both})

    def at(self, index: slice | Indices | Mask) -> Side:
        """Return the samples chosen by a slice, indices or a mask."""
        return Side(
            self.stamp_ns[index],
            **{name: values[index] for name, values in self.channels().items()},
        )


def joined_sides(parts: Sequence[Side]) -> Side:
    """Join parts of one side, with the channels that all parts have.

    Late samples are left out.
    """
    stamps = np.concatenate([part.stamp_ns for part in parts])
    later = stamps > np.maximum.accumulate(np.concatenate([stamps[:1] - 1, stamps[:-1]]))
    channels: dict[str, Array] = {}
    for name in CHANNELS:
        values = [part.channels()[name] for part in parts if name in part.channels()]
        if len(values) == len(parts):
            channels[name] = np.concatenate(values)
    return Side(stamps, **channels).at(later)


def _real(name: str, values: object) -> Array:
    """Return numbers as an array of floats, with NaN for masked ones."""
    try:
        masked = isinstance(values, np.ma.MaskedArray)
        found = np.ma.filled(values.astype(np.float64), np.nan) if masked else np.asarray(values)  # type: ignore[attr-defined]
        if found.dtype.kind != "c":
            return found.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        pass
    raise RecordingError(
        f"{name} contains values that are not real numbers", "Give an array of floats, (N, n)."
    )


def _checked_stamps(values: object) -> Stamps:
    """Return stamps as (N,) int64; :class:`Recording` checks whether they increase."""
    try:
        found = np.asarray(values)
    except ValueError:  # rows of unequal length
        found = np.empty((0, 0))
    whole = found.dtype.kind == "i" or not found.size
    # NaN is not
    whole = whole or (found.dtype.kind in "uf" and bool(np.all(np.abs(found) < _LATEST)))
    if found.ndim != 1 or not whole:
        raise RecordingError(
            "stamp_ns contains values that are not a row of nanoseconds",
            "Give an array of int64, (N,).",
        )
    stamps = found.astype(np.int64, copy=False)
    if found.dtype.kind == "f" and np.any(stamps != found):
        raise RecordingError(
            "stamp_ns contains fractions, as times in seconds do",
            "Give whole nanoseconds: np.round(1e9 * t).astype(int).",
        )
    return stamps


def joints_with(values: Array) -> Mask:
    """Return which joints (n,) have a channel (N, n); others contain NaN throughout."""
    if len(values) and not np.isnan(values[0]).any():
        return np.ones(values.shape[1], np.bool_)
    return np.asarray(~np.isnan(values).all(axis=0))


def short_names(names: Sequence[str]) -> list[str]:
    """Return names without their longest common prefix that ends with a mark such as `_`.

    Each keeps at least one letter.
    """
    begin = 0
    for mark in re.finditer(r"[_./-]", min(names, key=len, default="")):
        end = mark.end()
        common = len({name[:end] for name in names}) == 1
        if common and all(re.search("[a-zA-Z]", name[end:]) for name in names):
            begin = end
    return [name[begin:] for name in names]


def matched_names(wanted: Sequence[str], recorded: Sequence[str]) -> list[str] | None:
    """Return the recorded names of the wanted joints; None if one is missing.

    Names that differ only by a prefix common to one arm (`fer_`, `panda_`) denote the same joint,
    unless two arms have them.
    """
    if set(wanted) <= set(recorded):
        return list(wanted)
    short = short_names(wanted)
    begins = {name.removesuffix(short[0]) for name in recorded if name.endswith(short[0])}
    found = []
    for begin in begins:
        names = [begin + name for name in short]
        if begin[-1:] in "_./-" and set(names) <= set(recorded):
            found.append(names)
    return found[0] if len(found) == 1 else None


def listed(joints: Sequence[str], chosen: Any) -> str:
    """Return the names of the chosen joints (n,), given as a mask, or "all joints"."""
    return "all joints" if np.all(chosen) else ", ".join(np.array(joints)[chosen])


def span_of(values: Array) -> str:
    """Return the smallest and the largest number as text.

    One number if they are equal, empty without numbers.
    """
    if not np.size(values):
        return ""
    # Three digits, and 1000 rather than 1e+03.
    low = f"{float(f'{np.min(values):.3g}'):g}"
    high = f"{float(f'{np.max(values):.3g}'):g}"
    return low if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class Samples:
    """All channels of (1) on one time base, (N, n) each, None where not recorded."""

    t: Array  # (N,) seconds from the first sample
    q: Array | None
    dq: Array | None
    tau_J: Array | None
    theta: Array | None
    dtheta: Array | None
    tau_m: Array | None
    stamp_ns: Stamps  # (N,) the stamps of `t`
    notes: tuple[str, ...] = ()  # what was done to bring the channels together
    # what stamps mean where the user knows it; None where the motion decides
    clock: ClockMode | None = None
    # q, theta, tau_J, tau_m, r, each with the index of a joint that lacks it while others have it:
    # there the angle is that of the joint's other side, and the torque and r are zero
    lacking: Lacking = frozenset()
    # (N, n) rad, command as the drives take it, or share of full duty; None unless tau_m is what
    # controllers make of it
    r: Array | None = None
    # (M,) s, on the axis of t, at which torques were read where that is not at all of t
    read: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def recorded(self) -> dict[str, Array]:
        """Return the measured channels that are there, by name."""
        return {name: values for name in SAMPLED if (values := getattr(self, name)) is not None}

    def without_torque(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return which joints lack a torque on either side while others have one."""
        there = [channel for channel in ("tau_J", "tau_m") if getattr(self, channel) is not None]
        bare = [all((channel, j) in self.lacking for channel in there) for j in range(len(joints))]
        return tuple(joint for joint, none in zip(joints, bare, strict=True) if there and none)
