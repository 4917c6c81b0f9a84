"""Remove standstill from a recording, because it contains no information beyond the adjacent
motion."""

from dataclasses import replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Mask, median_step
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Side, Stamps, joints_with

STANDS = 1e-3  # rad/s; slower than this a joint counts as standing, whatever the noise
# s over which a joint's angle is averaged, before it is said to have moved: medians, as encoders
# have outliers.
AVERAGED = 0.5
# s of standstill before and after motion that are kept: gravity at the pose, and what filters
# reach.
KEPT = 3.0


def without_standstill(recording: Recording) -> Recording:
    """Return a recording without the intervals in which all joints stand still.

    :data:`KEPT` before and after each motion is kept. A note states the removed duration. If the
    arm never moves, nothing is removed.
    """
    spans = moving_spans(recording)
    if not len(spans):
        return recording
    found = within(recording, spans)
    samples = sum(map(len, recording.measured().values()))
    kept = sum(map(len, found.measured().values()))
    rest = recording.duration * (1.0 - kept / max(samples, 1))
    if rest < KEPT:
        return recording
    return replace(
        found, notes=(*recording.notes, standing_note(recording.source, rest, recording.duration))
    )


def standing_note(source: str, rest: float, whole: float) -> str:
    """Return in words how many seconds of a recording are left out."""
    where = source or "the recording"
    return f"{where}: {rest:.0f} of {whole:.0f} s of standstill are excluded"


def moving_spans(recording: Recording) -> Stamps:
    """Return the intervals in which the arm moves, (k, 2) ns, ordered and disjoint, with the kept
    margins."""
    found = [
        _moving(side)
        for side in recording.measured().values()
        if side.position is not None and len(side)
    ]
    return _joined(np.concatenate(found)) if any(map(len, found)) else np.empty((0, 2), np.int64)


def within(recording: Recording, spans: Stamps) -> Recording:
    """Return the part of a recording within ordered, disjoint intervals (k, 2) ns."""
    cut: dict[str, Any] = {
        name: side.at(_within(side.stamp_ns, spans)) for name, side in recording.sides().items()
    }
    return replace(recording, **cut)


def _moving(side: Side) -> Stamps:
    """Return the intervals in which any joint moves, (k, 2) ns, with the kept margins."""
    stamps = side.stamp_ns
    position = side.position
    assert position is not None
    interval = median_step(stamps) if len(stamps) > 1 else 1.0
    length = max(1, round(AVERAGED * 1e9 / max(interval, 1.0)))
    starts = np.arange(0, len(stamps) - length + 1, length)
    if len(starts) < 2:
        return stamps[[0, -1]][None]
    whole = position[: len(starts) * length, joints_with(position)].reshape(len(starts), length, -1)
    # What is no number moves for all that is known.
    steps = ~(np.abs(np.diff(np.median(whole, axis=1), axis=0)) <= STANDS * AVERAGED)
    moved = np.flatnonzero(steps.any(axis=1))
    around = round(KEPT * 1e9)
    last = np.minimum(starts[moved] + 2 * length, len(stamps) - 1)
    return np.stack([stamps[starts[moved]] - around, stamps[last] + around], axis=1)


def _joined(spans: Stamps) -> Stamps:
    """Return intervals (k, 2) in order, with overlapping ones merged."""
    spans = spans[np.argsort(spans[:, 0])]
    ends = np.maximum.accumulate(spans[:, 1])
    first = np.concatenate([[True], spans[1:, 0] > ends[:-1]])[: len(spans)]
    return np.stack([spans[first, 0], ends[np.append(np.flatnonzero(first)[1:] - 1, -1)]], axis=1)


def _within(stamps: Stamps, spans: Stamps) -> Mask:
    """Return which stamps lie in one of the spans (k, 2), which are in order and apart."""
    k = np.searchsorted(spans[:, 0], stamps, side="right") - 1
    return (k >= 0) & (stamps <= spans[np.maximum(k, 0), 1])
