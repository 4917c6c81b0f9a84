"""Whether an arm followed the commands that were recorded with it, how late, and at which rate they
came."""

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.recording.inspection.report import Finding, about, warning
from elastic_arm.recording.inspection.stuck_channels import STILL
from elastic_arm.recording.made_torque import FEWEST
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, joints_with, listed, span_of

LAGS = np.linspace(-0.5, 1.0, 301)  # s that are tried
DIGITS = 1e-6  # of the positions' spread, beside torques
SHIFTED = 3  # samples
MOST = 2000  # samples that are looked at
# Of the positions' spread, left beside the commands: more is of something else, less is the same
# numbers. Conventions.
APART, COPIED = 0.5, 1e-4
# Times its command that an angle is where one of the two has another unit: degrees, turns,
# thousandths, per cent. A weak drive under load falls short by any other factor.
MISTAKEN = (180.0 / np.pi, np.pi / 180.0, 2 * np.pi, 0.5 / np.pi, 1e3, 1e-3, 1e2, 1e-2)
NEAR = 1.15  # times such a factor; a loop's own gain is off by less, and servos of 0.2 are seen


def followed(recording: Recording) -> Iterator[Finding]:
    """Yield what is seen of commands: a note on lag and rate, and warnings where they cannot be
    what was followed."""
    reference = recording.reference
    side = (
        recording.motor
        if recording.motor is not None and recording.motor.position is not None
        else recording.link
    )
    if reference is None or reference.position is None or side is None or side.position is None:
        return
    if min(len(reference), len(side)) < FEWEST:
        return
    given, t = ((one.stamp_ns - reference.stamp_ns[0]) * 1e-9 for one in (reference, side))
    moves = (
        joints_with(reference.position)
        & joints_with(side.position)
        & (np.ptp(side.position, axis=0) > STILL)
    )
    if not moves.any():
        return
    found = np.full((3, recording.n), np.nan)
    for j in np.flatnonzero(moves):
        found[:, j] = _lag(given, reference.position[:, j], t, side.position[:, j])
    lag, gain, left = found
    # Computed torque follows as closely as its model is right; only what was copied has the same
    # digits.
    torques = any(
        one.effort is not None for one in (recording.link, recording.motor) if one is not None
    )
    copied = (
        moves
        & (left < (DIGITS if torques else COPIED))
        & (np.abs(lag) < (SHIFTED + 0.5) * np.median(np.diff(t)))
    )
    apart = moves & (left > APART)
    good = moves & ~apart & ~(left < COPIED)
    rates = [1.0 / float(np.median(np.diff(stamps))) for stamps in (given, t)]
    joints, told = (
        recording.joints,
        "they were computed from the recording; record the commands sent to the drives",
    )
    samples = np.round(lag / float(np.median(np.diff(t))))
    for shift in np.unique(samples[copied]).tolist():
        count = f"{abs(shift):.0f} sample{'s' if abs(shift) > 1.0 else ''}"
        which = "themselves" if not shift else f"of {count} {'later' if shift > 0.0 else 'before'}"
        of_shift = copied & (samples == shift)
        off = (
            f"with deviations of {span_of(100.0 * left[of_shift])} % of their spread, less"
            " than the tracking error of any drive"
        )
        yield from about(
            joints,
            of_shift,
            "copied_command",
            "commands",
            f"are the positions {which}, {off}",
            told,
        )
    if apart.any():
        words = f"{listed(joints, apart)} did not follow the recorded commands"
        yield warning("not_followed", words, "check for exchanged joints or another controller")
    late = f"lag the commands by {span_of(1e3 * lag[good])} ms (delay and drive together)"
    size = f"gain {span_of(gain[good])}, deviations {span_of(100.0 * left[good])} % of their spread"
    rate = f"commands come at {rates[0]:.4g} Hz, positions at {rates[1]:.4g} Hz"
    yield from about(
        joints, good, "commands", "positions", f"{late}, {size}; {rate}", severity="note"
    )
    early = good & (lag < -0.5 / rates[1])
    clocks = "do they have different clocks, or are the commands those of the next step?"
    yield from about(joints, early, "early", "positions", "are ahead of the commands", clocks)
    near = np.abs(np.log(np.abs(gain)[:, None] / np.array(MISTAKEN))).min(axis=1) < np.log(NEAR)
    odd = good & ((gain < 0.0) | near)
    times = f"are {span_of(gain[odd])} times the commands"
    yield from about(joints, odd, "command_unit", "positions", times, "check unit and sign of both")


def _lag(given: Array, command: Array, t: Array, angle: Array) -> tuple[float, float, float]:
    """Return by how much an angle is behind its command, s, by what it is multiplied, and which
    share is left."""
    spline, every = CubicSpline(given, command), max(1, len(t) // MOST)
    # Whole samples, too, by which a log may be shifted to make commands of it.
    lags = np.union1d(LAGS, float(np.median(np.diff(t))) * np.arange(-SHIFTED, SHIFTED + 1))
    inside = (t - lags[-1] >= given[0]) & (t - lags[0] <= given[-1])
    t, angle = t[inside][::every], angle[inside][::every]
    if len(t) < FEWEST or not angle.std():
        return np.nan, np.nan, np.inf
    shifted = spline(t - lags[:, None])
    shifted = shifted - shifted.mean(axis=1, keepdims=True)
    angle = angle - angle.mean()
    gains = (shifted @ angle) / np.maximum(np.sum(shifted**2, axis=1), 1e-300)
    left = np.linalg.norm(angle - gains[:, None] * shifted, axis=1) / np.linalg.norm(angle)
    best = int(np.argmin(left))
    return float(lags[best]), float(gains[best]), float(left[best])
