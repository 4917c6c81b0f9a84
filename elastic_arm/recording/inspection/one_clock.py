"""Align sides whose clocks are far apart: TAI and UTC, two time zones, or two computers.

Commands, motors and links perform the same motion. If their times hardly overlap, the motions are
aligned: the shift at which they correlate best is the difference between the clocks.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import fftconvolve

from elastic_arm.arrays import Mask
from elastic_arm.recording.inspection.report import FEWEST, Finding, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, joints_with

# of the shorter side, that the other one covers: below, the two are hardly of one recording
_COMMON = 0.5
_ALIKE = (
    0.8  # correlation of two motions that are one; a drive's lag and sag leave more. Convention
)
_GRID = 5000  # instants of the longer side that are compared
_WHOLE = 0.25  # s: what is that near to whole seconds is whole seconds and the delay of a drive
_WORDS = {"reference": "the commands", "link": "the link side", "motor": "the motor side"}


def by_one_clock(recording: Recording, found: list[Finding]) -> Recording:
    """Shift sides whose times hardly overlap to the time at which their motion agrees."""
    sides = {name: side for name, side in recording.sides().items() if side.position is not None}
    long = {name: side for name, side in sides.items() if len(side) >= FEWEST // 4}
    base = next((name for name in ("link", "motor") if name in long), None)
    if base is None:
        return recording
    moved: dict[str, Any] = {}
    for name, side in long.items():
        if name == base or _common(side, long[base]) >= _COMMON:
            continue
        shift = _shift_ns(long[base], side)
        if shift is None:
            words = (
                f"{_WORDS[name]} and {_WORDS[base]} have hardly any time and no motion in common"
            )
            found.append(warning("clocks_apart", words, "are they from one recording?"))
            continue
        moved[name] = replace(side, stamp_ns=side.stamp_ns + shift)
        way = "behind" if shift > 0 else "ahead of"
        words = (
            f"the clock of {_WORDS[name]} is {abs(shift) * 1e-9:.6g} s {way} that of {_WORDS[base]}"
        )
        remedy = (
            "they are aligned by their motion; a smaller delay between the two remains"
            " undetected (37 s: TAI and UTC)"
        )
        found.append(warning("clocks_apart", words, remedy))
    return replace(recording, **moved) if moved else recording


def _common(one: Side, other: Side) -> float:
    """Return the share of the shorter of two sides that lies within the other."""
    begin = max(one.stamp_ns[0], other.stamp_ns[0])
    end = min(one.stamp_ns[-1], other.stamp_ns[-1])
    shorter = min(side.stamp_ns[-1] - side.stamp_ns[0] for side in (one, other))
    return float(end - begin) / max(float(shorter), 1.0)


def _shift_ns(base: Side, side: Side) -> int | None:
    """Return the shift from the clock of one side to that of another, ns; None if they do not
    perform the same motion."""
    assert base.position is not None and side.position is not None
    joints = joints_with(base.position) & joints_with(side.position)
    lasting = max(int(one.stamp_ns[-1] - one.stamp_ns[0]) for one in (base, side)) * 1e-9
    step = lasting / _GRID
    first = _even(base, step, joints)
    second = _even(side, step, joints)
    if not first.size or not second.size:
        return None
    both = sum(fftconvolve(a, b[::-1]) for a, b in zip(first.T, second.T, strict=True))
    # Of each shift the squares of what lies over each other.
    ones = [np.ones(len(first)), np.ones(len(second))]
    squares = [
        fftconvolve(np.sum(first**2, axis=1), ones[1]),
        fftconvolve(ones[0], np.sum(second[::-1] ** 2, axis=1)),
    ]
    count = fftconvolve(*ones)
    alike = both / np.sqrt(np.maximum(squares[0] * squares[1], 1e-300))
    alike[count < _COMMON * min(len(first), len(second))] = -np.inf
    best = int(np.argmax(alike))
    if alike[best] < _ALIKE:
        return None
    ahead = (best - len(second) + 1) * step + (base.stamp_ns[0] - side.stamp_ns[0]) * 1e-9
    whole = round(ahead)
    return round(1e9 * (whole if abs(ahead - whole) < _WHOLE else ahead))


def _even(side: Side, step: float, joints: Mask) -> Array:
    """Return positions (N, m) of the joints at equidistant times, without their means."""
    assert side.position is not None
    t = (side.stamp_ns - side.stamp_ns[0]) * 1e-9
    at = np.arange(0.0, float(t[-1]), step)
    columns = [np.interp(at, t, column) for column in side.position[:, joints].T]
    values = np.stack(columns, axis=1) if columns and len(at) else np.empty((0, 0))
    return np.asarray(values - values.mean(axis=0)) if values.size else values
