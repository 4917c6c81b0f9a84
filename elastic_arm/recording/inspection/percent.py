"""Detect positions in per cent of the calibrated range of each joint, LeRobot's default, that were
taken for degrees.

Encoders of one kind have equal steps. In per cent of different ranges the steps differ: from -100
to 100, the step of a 12-bit encoder, 360/4096 degrees, is 200 / range times as large, and therefore
shows the range.
"""

from collections.abc import Iterator

import numpy as np

from elastic_arm.recording.inspection.report import FEWEST, Finding, WrongMotion
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, joints_with

TICK = 360.0 / 4096  # degrees, of the encoders of the servos that are calibrated so
_RANGES = (30.0, 400.0)  # degrees that a joint may be calibrated over
_SAME = 2e-3  # relative; steps of one encoder


def ranges_by_steps(values: Array) -> Array | None:
    """Return the calibrated ranges, degrees (n,), from the steps of values (N, n) in per cent.

    None if the values are degrees. The steps of different kinds of encoders differ by powers of
    two.
    """
    if not len(values) or np.abs(values).max() > 100.0 + 1e-6:
        return None
    steps = np.array([_step(column) for column in values.T])
    if len(steps) < 2 or not steps.all():
        return None
    powers = np.log2(steps / TICK)
    odd = np.abs(powers - np.round(powers)) > np.log2(1.0 + _SAME)
    ranges = 200.0 * TICK / steps
    within = (ranges > _RANGES[0]) & (ranges < _RANGES[1])
    different = np.ptp(steps) > _SAME * steps.max()
    return ranges if odd.sum() > 1 and different and within.all() else None


def _step(column: Array) -> float:
    """Return the step of which all changes of a channel (N,) are multiples; 0 if there is none."""
    apart = np.abs(np.diff(column))
    apart = apart[apart > 1e-9]
    if len(apart) < 20:
        return 0.0
    least = float(apart.min())
    few = apart[apart < 50.0 * least] / least
    # 0.05 of a step: rounding to 32 bits
    whole = np.abs(few - np.round(few)) < 0.05
    return (
        float(np.median(few[whole] * least / np.round(few[whole]))) if whole.mean() > 0.98 else 0.0
    )


def in_percent(recording: Recording) -> Iterator[Finding]:
    """Yield a finding if angles in degrees are probably per cent, with the range of each joint."""
    for name, side in recording.measured().items():
        if side.position is None or len(side) < FEWEST:
            continue
        there = np.flatnonzero(joints_with(side.position))
        ranges = ranges_by_steps(np.rad2deg(side.position[:, there]))
        if ranges is not None:
            shown = ", ".join(
                f"{recording.joints[j]} {size:.0f}" for j, size in zip(there, ranges, strict=True)
            )
            words = (
                f"{name} position is in per cent of each joint's range, not in degrees,"
                " according to the different steps of the encoders"
            )
            remedy = (
                "use the ranges from the calibration file; from steps of 12 bits they are, in"
                f" degrees: {shown} (unit: deg, factor: range / 200, in the map)"
            )
            yield WrongMotion("warning", "percent", f"{words}: {remedy}")
