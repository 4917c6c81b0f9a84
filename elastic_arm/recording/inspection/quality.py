"""What no later step could use: times that do not advance, rates of no arm, numbers that are none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.sides import Side, Stamps, joints_with

REPAIR = "Make a usable copy with: elastic-arm bag check --repair BAG"
# Samples a second. A fifth of them is the band in which an arm is looked at, and the motion of none ends below 1 Hz;
# no drive is read out faster than the other. Beyond either the times have another unit than they are taken for.
SLOWEST, FASTEST = 5.0, 50_000.0
UNIT = "Are the times in another unit? Give theirs (s, ms, us, ns) in the map, and import the recording again."
ARRIVAL = "Use the times of arrival: --clock arrival, or 'time: arrival' in a channel map."


def checked(side: Side, topic: str, joints: Sequence[str]) -> Side:
    """Return `side` if its times advance and its numbers are finite, or NaN throughout for joints without a channel."""
    check_times(side.stamp_ns, topic)
    faults = []
    for name, values in side.channels().items():
        # One sum finds any NaN or infinity in a pass; only then is it worth looking where.
        with np.errstate(over="ignore"):
            total = values.sum()
        if np.isfinite(total) or np.isfinite(values).all():
            continue
        bad = ~np.isfinite(values)
        bad = bad & joints_with(values) if joints_with(values).any() else bad
        for j in np.flatnonzero(bad.any(axis=0)).tolist():
            row = int(np.argmax(bad[:, j]))
            many = f" and in {bad[:, j].sum() - 1} more samples" if bad[:, j].sum() > 1 else ""
            faults.append(f"{name} of {joints[j]} is {values[row, j]} at {moment(side.stamp_ns, row)}{many}")
    if faults:
        raise RecordingError(f"{topic}: {'; '.join(faults)}", REPAIR)
    return side


def check_times(stamp_ns: Stamps, topic: str) -> None:
    """Raise if there are no stamps, or they are repeated or go backwards."""
    if not len(stamp_ns):
        raise RecordingError(f"{topic} has no messages", "Record again, with the publisher running.")
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return
    check_stamped(stamp_ns, topic)
    step = np.diff(stamp_ns)
    at = int(np.argmax(step <= 0))
    if step[at] == 0:
        raise RecordingError(f"{topic} repeats the stamp of {moment(stamp_ns, at)}", REPAIR)
    problem = f"{topic} jumps back in time by {-step[at] * 1e-9:.6g} s after {moment(stamp_ns, at)}"
    raise RecordingError(problem, REPAIR)


def check_stamped(stamp_ns: Stamps, topic: str) -> None:
    """Raise if all stamps are the same: nobody stamped the messages."""
    if len(stamp_ns) > 1 and (stamp_ns == stamp_ns[0]).all():
        raise RecordingError(f"{topic}: all {len(stamp_ns)} header stamps are equal ({stamp_ns[0]} ns)", ARRIVAL)


def wrong_rate(rate: float) -> str | None:
    """Return in words what is wrong with a sample rate, Hz, that no recording of an arm has; None for others."""
    if SLOWEST <= rate <= FASTEST:
        return None
    much = "few: they do not show" if rate < SLOWEST else "many for"
    return f"{rate:.3g} samples a second, by the stamps, are too {much} the motion of an arm"


def moment(stamp_ns: Stamps, row: int) -> str:
    """Return when a sample was: from the beginning, and as a stamp."""
    seconds, nanoseconds = divmod(int(stamp_ns[row]), 1_000_000_000)
    return f"{(stamp_ns[row] - stamp_ns[0]) * 1e-9:.6f} s (stamp {seconds}.{nanoseconds:09d})"
