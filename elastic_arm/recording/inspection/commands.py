"""Check whether an arm followed the recorded commands, with which lag, and at which rate the
commands came."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Mask, median_step
from elastic_arm.recording.inspection.report import Finding, about, warning
from elastic_arm.recording.inspection.stuck_channels import STILL, least_travel
from elastic_arm.recording.made_torque import FEWEST
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, joints_with, listed, span_of
from elastic_arm.robot import Robot

LAGS = np.linspace(-0.5, 1.0, 301)  # s that are tried
DIGITS = 1e-6  # of the positions' spread, beside torques
SHIFTED = 3  # samples
MOST = 2000  # samples that are looked at
# Of the positions' spread, left beside the commands: with more than half of its power a joint does
# something else, and with more than the second where another joint's command is nearer (weak servos
# under load leave 0.54); with less than the third these are the same numbers. Conventions.
APART = np.sqrt(0.5)
LOOSE = 0.5
COPIED = 1e-4
# Times its command that an angle is where one of the two has another unit: degrees, turns,
# thousandths, per cent. A weak drive under load falls short by any other factor.
MISTAKEN = (180.0 / np.pi, np.pi / 180.0, 2 * np.pi, 0.5 / np.pi, 1e3, 1e-3, 1e2, 1e-2)
NEAR = 1.15  # times such a factor; a loop's own gain is off by less, and servos of 0.2 are seen


def followed(recording: Recording, robot: Robot | None = None) -> Iterator[Finding]:
    """Yield the findings about commands: lag, rate, and whether the arm can have followed them."""
    fit = _fitted(recording)
    if fit is None:
        return
    # Computed torque follows as closely as its model is right; only what was copied has the same
    # digits.
    torques = any(side.effort is not None for side in recording.measured().values())
    within = np.abs(fit.lag) < (SHIFTED + 0.5) * fit.step
    copied = fit.told & (fit.left < (DIGITS if torques else COPIED)) & within
    apart = fit.told & ((fit.left > APART) | (fit.left > fit.least_other))
    good = fit.told & ~apart & ~(fit.left < COPIED)
    joints = recording.joints
    yield from _copied(joints, fit, copied)
    if apart.any():
        words = f"{listed(joints, apart)} did not follow the recorded commands"
        remedy = "check for exchanged joints, another controller or torque that was switched off"
        yield warning("not_followed", words, remedy)
    told = (
        "if it was not recorded, leave the command of this joint out of the channel map: the other"
        " joints are used without it"
    )
    words = "is constant while the joint moves"
    # A joint that is held in one place gives way to its load a little.
    untold = fit.moves & ~fit.told & (fit.travel > least_travel(recording, robot))
    yield from about(joints, untold, "constant_command", "command", words, told)
    late = f"lag the commands by {span_of(1e3 * fit.lag[good])} ms (delay and drive together)"
    error = f"deviations {span_of(1e2 * fit.left[good])} % of their spread"
    size = f"gain {span_of(fit.gain[good])}, {error}"
    rates = f"commands come at {1.0 / fit.given_step:.4g} Hz, positions at {1.0 / fit.step:.4g} Hz"
    words = f"{late}, {size}; {rates}"
    yield from about(joints, good, "commands", "positions", words, severity="note")
    # What hardly follows has no certain lag, nor a certain size.
    near = good & (fit.left < LOOSE)
    early = near & (fit.lag < -0.5 * fit.step)
    clocks = "do they have different clocks, or are the commands those of the next step?"
    yield from about(joints, early, "early", "positions", "are ahead of the commands", clocks)
    gain = np.where(near, np.abs(fit.gain), 1.0)
    off_by = np.abs(np.log(gain[:, None] / np.array(MISTAKEN))).min(axis=1)
    odd = near & ((fit.gain < 0.0) | (off_by < np.log(NEAR)))
    times = f"are {span_of(fit.gain[odd])} times the commands"
    units = "check unit and sign of both"
    yield from about(joints, odd, "command_unit", "positions", times, units)


class _Fit(NamedTuple):
    """Angles compared with their commands, (n,) each: angle(t) = gain command(t - lag) + rest."""

    moves: Mask  # joints that do, and have a command
    told: Mask  # those of them whose command changes
    travel: Array  # rad, of the angle
    lag: Array  # s
    gain: Array
    left: Array  # the rest over the angle's spread
    # that of another joint's command, the nearest one, where the own leaves more than `LOOSE`
    least_other: Array
    given_step: float  # s between commands
    step: float  # s between angles


def _fitted(recording: Recording) -> _Fit | None:
    """Compare the angles of motors, or otherwise of links, with the commands; None if either is
    missing."""
    reference = recording.reference
    side = recording.motor
    if side is None or side.position is None:
        side = recording.link
    if reference is None or reference.position is None or side is None or side.position is None:
        return None
    if min(len(reference), len(side)) < FEWEST:
        return None
    there = joints_with(reference.position) & joints_with(side.position)
    moves = there & (np.ptp(side.position, axis=0) > STILL)
    if not moves.any():
        return None
    given = (reference.stamp_ns - reference.stamp_ns[0]) * 1e-9
    t = (side.stamp_ns - reference.stamp_ns[0]) * 1e-9
    lag, gain, left = np.full((3, recording.n), np.nan)
    told = moves & (np.ptp(reference.position, axis=0) > 0.0)
    for j in np.flatnonzero(told):
        lag[j], gain[j], left[j] = _lag(given, reference.position[:, j], t, side.position[:, j])
    least_other = np.full(recording.n, np.inf)
    for j in np.flatnonzero(told & (left > LOOSE)):
        others = [k for k in np.flatnonzero(there) if k != j]
        rests = [_lag(given, reference.position[:, k], t, side.position[:, j])[2] for k in others]
        least_other[j] = min(rests, default=np.inf)
    steps = (median_step(given), median_step(t))
    return _Fit(moves, told, np.ptp(side.position, axis=0), lag, gain, left, least_other, *steps)


def _copied(joints: Sequence[str], fit: _Fit, copied: Mask) -> Iterator[Finding]:
    """Yield which commands are copies of the positions, by the number of samples by which they are
    shifted."""
    told = "they were computed from the recording; record the commands sent to the drives"
    samples = np.round(fit.lag / fit.step)
    for shift in np.unique(samples[copied]).tolist():
        which = "themselves"
        if shift:
            count = f"{abs(shift):.0f} sample{'s' if abs(shift) > 1.0 else ''}"
            which = f"of {count} {'later' if shift > 0.0 else 'before'}"
        of_shift = copied & (samples == shift)
        off = f"with deviations of {span_of(1e2 * fit.left[of_shift])} % of their spread"
        words = f"are the positions {which}, {off}, less than the tracking error of any drive"
        yield from about(joints, of_shift, "copied_command", "commands", words, told)


def _lag(given: Array, command: Array, t: Array, angle: Array) -> tuple[float, float, float]:
    """Return the lag of an angle behind its command, s, its gain, and the share that remains."""
    spline = CubicSpline(given, command)
    every = max(1, len(t) // MOST)
    # Whole samples, too, by which a log may be shifted to make commands of it.
    lags = np.union1d(LAGS, median_step(t) * np.arange(-SHIFTED, SHIFTED + 1))
    inside = (t - lags[-1] >= given[0]) & (t - lags[0] <= given[-1])
    t = t[inside][::every]
    angle = angle[inside][::every]
    if len(t) < FEWEST or not angle.std():
        return np.nan, np.nan, np.inf
    shifted = spline(t - lags[:, None])
    shifted = shifted - shifted.mean(axis=1, keepdims=True)
    angle = angle - angle.mean()
    gains = (shifted @ angle) / np.maximum(np.sum(shifted**2, axis=1), 1e-300)
    left = np.linalg.norm(angle - gains[:, None] * shifted, axis=1) / np.linalg.norm(angle)
    best = int(np.argmin(left))
    return float(lags[best]), float(gains[best]), float(left[best])
