"""Find finite numbers that the sensors of a moving arm cannot measure.

Position and velocity describe the same motion. Over an interval from t to t + w

    q(t + w) - q(t) = g integral(v) + tau (v(t + w) - v(t)),

with the gain g = 1 and the lag tau = 0 of the velocity relative to the position. If g or tau
differs, a unit, a sign, a filter or a clock is wrong. If samples were not taken at their stamps,
all joints deviate along their motion by the same time, which sensor noise cannot cause.

Degrees in one of both channels and radians in the other have g = 180 / pi or its inverse, to within
the calibration of a velocity. Against a factor g of any size these two are weighed by Bayes' rule.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from scipy.stats import norm

from elastic_arm.arrays import Mask, median_step, rms
from elastic_arm.recording.inspection.report import (
    FEWEST,
    Finding,
    Severity,
    WrongMotion,
    about,
    warning,
)
from elastic_arm.recording.inspection.torque_spectrum import torque_spectra
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Samples, Side, joints_with, span_of
from elastic_arm.recording.timebase.clocks import evidence, numbered

_ENOUGH = 20_000  # samples of a side that show a wrong unit; bounds the time
_STILL = 1e-3  # rad/s rms below which a joint does not move
_SMOOTH = "smooth_torque"
_GAIN = 0.03  # a unit or a sign is off by more
_FILTERED = 0.2  # of a velocity, that a filter or a calibration takes or adds
_OTHER_UNIT = "other_unit"  # code of degrees in one channel of a side beside radians in the other
_DECADES = 4.0  # within which a factor of any size is taken to lie, up and down; convention
_JITTER = 0.02  # of the interval: stamps that spread more must be those of the motion
_PARTS = 20  # of a recording, whose scatter shows how certain its work is


class _Compared(NamedTuple):
    """Positions q and velocities v (N, n) of one side at times t (N,), and their agreement, (n,)
    each.

    gain and lag (s) of the equation above, the share of the advance that it explains, and the
    standard deviation of the lag; NaN for joints at rest. slow: whether the noise of the velocity
    may be larger than the motion.
    """

    t: Array
    q: Array
    v: Array
    gain: Array
    lag: Array
    share: Array
    doubt: Array
    slow: Mask
    step: float


def implausible(recording: Recording) -> list[Finding]:
    """Return the findings about a recording; none if its numbers are no motion at all.

    For a long recording, velocities and stamps are judged by its middle, because such faults affect
    all parts of it.
    """
    sides = _whole_sides(recording)
    if not sides:
        return []
    findings = _same_arrays(recording)
    for name, joints, motion in _motions(sides):
        findings += _velocities(name, motion, joints)
        findings += _stamps(name, motion)
    return [*findings, *_noiseless(recording), *_backwards(recording)]


def in_degrees(recording: Recording) -> list[str]:
    """Return in words which positions or velocities are in degrees beside radians in the other."""
    found: list[Finding] = []
    for name, joints, motion in _motions(_whole_sides(recording)):
        found += _velocities(name, motion, joints)
    return [one.message for one in found if one.code == _OTHER_UNIT]


def _whole_sides(recording: Recording) -> dict[str, tuple[Side, Sequence[str]]]:
    """Return each side with the joints that have all of its channels; none at all if any is no
    motion."""
    sides = {name: _whole(side, recording.joints) for name, side in recording.measured().items()}
    return sides if all(_is_motion(side) for side, _ in sides.values()) else {}


def _motions(
    sides: Mapping[str, tuple[Side, Sequence[str]]],
) -> Iterator[tuple[str, Sequence[str], _Compared]]:
    """Yield the middle of each side that has positions and velocities, with its joints."""
    for name, (side, joints) in sides.items():
        if len(side) >= FEWEST and side.position is not None and side.velocity is not None:
            begin = max(0, (len(side) - _ENOUGH) // 2)
            yield name, joints, _compared(side.at(slice(begin, begin + _ENOUGH)))


def _whole(side: Side, joints: Sequence[str]) -> tuple[Side, Sequence[str]]:
    """Return the side with only the joints that have all of its channels, and their names."""
    there = np.all([joints_with(values) for values in side.channels().values()], axis=0)
    if there.all():
        return side, joints
    kept = {name: values[:, there] for name, values in side.channels().items()}
    return Side(side.stamp_ns, **kept), [joints[j] for j in np.flatnonzero(there).tolist()]


def smoothed_torques(recording: Recording) -> list[str]:
    """Return in words which torques were low-passed before they were recorded.

    Above the cut-off frequency they contain not even noise.
    """
    return [finding.message for finding in _noiseless(recording) if finding.code == _SMOOTH]


def _compared(side: Side) -> _Compared:
    """Fit the module's equation to every joint."""
    assert side.position is not None and side.velocity is not None
    t = (side.stamp_ns - side.stamp_ns[0]) * 1e-9
    q = side.position
    v = side.velocity
    # 0.02 s: a velocity is compared with the advance of the position over more than encoder steps
    width = min(max(round(0.02 / median_step(t)), 1), len(t) // 20)
    advance, mean, change = _advances(t, q, v, width)
    fits = np.full((4, q.shape[1]), np.nan)
    slow = rms(advance) < _STILL
    # Stamps in a wrong unit make any motion slow, but do not change the velocities. 0.05 rad is a
    # distance that a slow joint has moved nevertheless.
    is_short = np.ptp(q, axis=0) < 0.05
    is_slow_by_velocity = rms(v) < _STILL
    still = slow & (is_short | is_slow_by_velocity)
    for j in np.flatnonzero(~still).tolist():
        columns = np.column_stack([mean[:, j], change[:, j]])
        # The rounding of encoder steps is not a motion that the velocity misses.
        tick = _tick(q[:, j])
        rounding = float(np.sum((tick / (t[width:] - t[:-width])) ** 2)) / 6.0
        fits[:, j] = _agreement(advance[:, j], columns, width, rounding)
    gain, lag, share, doubt = fits
    return _Compared(t, q, v, gain, lag, share, doubt, slow, median_step(t))


def _agreement(
    advance: Array, columns: Array, width: int, rounding: float
) -> tuple[float, float, float, float]:
    """Return gain and lag of one joint, the explained share of its advance, and the standard
    deviation of the lag.

    advance: (N,) rad/s; columns: (N, 2) mean and change of the velocity; rounding: sum of squares
    of the advance by rounded positions.
    """
    gain, lag = fit = np.linalg.lstsq(columns, advance, rcond=None)[0]
    rest = advance - columns @ fit
    square = float(rest @ rest)
    # A velocity that never changes shows no lag.
    doubt = np.inf
    power = float(columns[:, 1] @ columns[:, 1])
    if power > 0.0:
        # Intervals overlap: only one in `width` is independent of the others.
        doubt = float(np.sqrt(square / len(rest) * width / power))
    unexplained = max(square - rounding, 0.0)
    return float(gain), float(lag), float(1.0 - unexplained / (advance @ advance)), doubt


def _tick(positions: Array) -> float:
    """Return the resolution of an encoder, rad; 0 if too few steps show it."""
    steps = np.abs(np.diff(positions))
    return float(steps[steps > 0.0].min()) if np.count_nonzero(steps) > FEWEST // 4 else 0.0


def _is_motion(side: Side) -> bool:
    return side.position is None or is_motion(
        (side.stamp_ns - side.stamp_ns[0]) * 1e-9, side.position
    )


def is_motion(t: Array, position: Array) -> bool:
    """Return whether positions (N, n), rad, at times (N,), s, are the motion of an arm."""
    if len(t) < 2:
        return False
    speed = np.diff(np.unwrap(position, axis=0), axis=0) / np.diff(t)[:, None]
    # 500.0 rad/s rms from sample to sample; beyond, the numbers are no motion of an arm
    return bool((rms(speed) < 500.0).all())


def _advances(t: Array, q: Array, v: Array, width: int) -> tuple[Array, Array, Array]:
    """Return (N - width, n) mean rates of q, means of v and mean rates of v, over intervals of
    `width` samples."""
    span = (t[width:] - t[:-width])[:, None]
    integral = scipy.integrate.cumulative_trapezoid(v, t, axis=0, initial=0.0)
    return tuple((x[width:] - x[:-width]) / span for x in (q, integral, v))  # type: ignore[return-value]


def _velocities(name: str, motion: _Compared, joints: Sequence[str]) -> list[Finding]:
    moving = np.isfinite(motion.share)
    follows = motion.share >= 0.5  # share of a velocity that its position must explain
    strange = moving & ~follows & ~motion.slow
    scaled = moving & follows & (np.abs(motion.gain - 1.0) > _GAIN)
    gains = motion.gain[moving]
    alike = False
    if scaled.any() and scaled[moving].all():
        usual = np.median(gains)
        alike = bool((np.abs(gains - usual) < _GAIN * np.abs(usual)).all())
    # The filter of a servo reduces the gain by less, a wrong unit of velocity changes it by more,
    # and a wrong unit of time changes all joints alike.
    is_far = np.abs(motion.gain - 1.0) > _FILTERED
    far = scaled & (is_far | (alike and len(gains) > 1))
    is_late = np.abs(motion.lag) > np.maximum(motion.step, 5.0 * motion.doubt)
    late = moving & follows & ~motion.slow & is_late
    what = f"{name} velocity"
    remedy = "check units and signs"
    if scaled.any() and alike:
        remedy += f", and the unit of the times: the sample rate is {1 / motion.step:.3g} Hz"
    columns = "check the columns, units and signs"
    derivative = "the derivative of the position"
    findings = about(joints, strange, "velocity", what, f"is not {derivative}", columns)
    positions = far & _is_size(motion.gain, 180.0 / np.pi)
    velocities = far & _is_size(motion.gain, np.pi / 180.0)
    for which, chosen, other, kind in (
        ("position", positions, "velocity", WrongMotion),
        ("velocity", velocities, "position", Finding),
    ):
        words = f"is probably in degrees beside radians in the {other}"
        unit = "their rates differ by 57.3: give its unit (deg) in the map"
        findings += about(joints, chosen, _OTHER_UNIT, f"{name} {which}", words, unit, kind=kind)
    degrees: tuple[tuple[Mask, Severity], ...] = (
        (far & ~positions & ~velocities, "warning"),
        (scaled & ~far, "note"),
    )
    for chosen, severity in degrees:
        times = f"is {span_of(1.0 / motion.gain[chosen])} times {derivative}"
        findings += about(joints, chosen, "velocity", what, times, remedy, severity)
    behind = late & (motion.lag > 0.0)
    for words, chosen in (("behind", behind), ("ahead of", late & ~behind)):
        size = f"is {span_of(1e3 * np.abs(motion.lag[chosen]))} ms {words} the position"
        findings += about(
            joints, chosen, "velocity_lag", what, size, "one of the two was filtered", "note"
        )
    return findings


def _is_size(gain: Array, size: float) -> Mask:
    """Return which gains (n,) are more probably a size than any other number.

    The logarithm of the former has the standard deviation of a calibration, that of the latter a
    uniform distribution.
    """
    off = np.log(np.maximum(gain, 1e-300) / size)
    return norm.pdf(off, scale=_GAIN) > 0.5 / (_DECADES * np.log(10.0))


def _stamps(name: str, motion: _Compared) -> list[Finding]:
    """Compare the stamps with the instants that the motion of all joints implies."""
    good = np.isfinite(motion.share) & (motion.share > 0.9)
    if np.count_nonzero(good) < 2:
        return []
    # 2e-6 of the interval is rounding of stamps to a nanosecond or a float
    is_even = np.abs(np.diff(motion.t) / motion.step - 1.0).max() <= 2e-6
    return _generated_stamps(name, motion, good) if is_even else _arrival_stamps(name, motion)


def _arrival_stamps(name: str, motion: _Compared) -> list[Finding]:
    """Find jittered stamps of regular samples."""
    number, rate, _, jitter = numbered(motion.t)
    usual = np.std(np.diff(jitter)) / np.sqrt(2.0) * rate
    if usual <= _JITTER:
        return []
    stamps = (1e9 * motion.t).astype(np.int64)
    samples = Samples(motion.t, motion.q, motion.v, None, None, None, None, stamps)
    found = evidence(samples, number, rate)
    if found is None or found.stamps:
        return []
    jittered = f"the stamps have jitter of {1e6 * usual / rate:.3g} us (std)"
    message = f"{name} side: {jittered} that the motion does not show"
    return [warning("arrival_stamps", message, "arrival times of regular samples?")]


def _generated_stamps(name: str, motion: _Compared, good: Mask) -> list[Finding]:
    """Find perfectly regular stamps of samples that were not taken regularly.

    Two groups of joints each show how many intervals too late every sample was taken.
    """
    advance, mean, change = _advances(motion.t, motion.q[:, good], motion.v[:, good], 1)
    rest = advance - mean * motion.gain[good] - change * motion.lag[good]
    weights = []
    ahead = []
    for group in (slice(0, None, 2), slice(1, None, 2)):
        speeds = mean[:, group]
        weight = np.sum(speeds**2, axis=1) + 1e-300
        weights.append(weight)
        ahead.append(np.sum(rest[:, group] * speeds, axis=1) / weight)
    sure = np.logical_and(*(weight > np.median(weight) for weight in weights))
    if np.count_nonzero(sure) < FEWEST // 4:
        return []
    one, other = (part[sure] - part[sure].mean() for part in ahead)
    both = max(float(np.mean(one * other)), 0.0)
    # 0.02 of the interval: all joints are too far ahead by more than that
    # 0.3: correlation of both groups
    if both <= max(0.3 * float(one.std() * other.std()), 0.02**2):
        return []
    size = f"{1e6 * np.sqrt(both) * motion.step:.3g} us (std)"
    words = f"all joints together lead or lag the integral of their velocities by {size}"
    # 0.1 of the interval: less, such as rounding or a late cycle now and then, has no consequences
    severity: Severity = "warning" if np.sqrt(both) > 0.1 else "note"
    made_up = f"{name} side: the stamps are perfectly regular and were generated"
    return [Finding(severity, "made_up_stamps", f"{made_up}: {words}")]


def _noiseless(recording: Recording) -> list[Finding]:
    """Find torques with less noise than a 16-bit converter: they were smoothed or computed."""
    said = []
    joints = recording.joints
    for name, found in torque_spectra(recording).items():
        what = f"{name} effort"
        computed = found.computed
        smooth = found.low_passed
        noise = f"has {span_of(found.level[computed])} dB of noise, less than a 16-bit converter"
        falls = f"no noise, and a steep drop at {span_of(found.knee[smooth])} Hz"
        nothing = f"has no content above {span_of(found.end[smooth])} Hz, {falls}"
        said += about(
            joints,
            computed,
            "computed_torque",
            what,
            noise,
            "it is computed, for example by a model, not measured",
        )
        said += about(
            joints, smooth, _SMOOTH, what, nothing, "it was low-passed there, or computed", "note"
        )
    return said


def _backwards(recording: Recording) -> list[Finding]:
    """Find motor torques that remove energy from a joint in addition to its friction: their sign is
    wrong.

    Torque sensors behind a drive measure little friction, and their lag causes work of either sign.
    Gravity and inertia return the energy that they take as the joint moves back and forth, except
    for one way over its range. For joints without a motor angle the link angle serves, because a
    spring returns the energy that it takes.
    """
    motor = recording.motor
    link = recording.link
    if motor is None or motor.effort is None:
        return []
    angle = np.full_like(motor.effort, np.nan) if motor.position is None else motor.position.copy()
    if link is not None and link.position is not None:
        for j in np.flatnonzero(~joints_with(angle)).tolist():
            angle[:, j] = np.interp(motor.stamp_ns, link.stamp_ns, link.position[:, j])
    side, joints = _whole(Side(motor.stamp_ns, angle, effort=motor.effort), recording.joints)
    if (
        side.position is None
        or side.effort is None
        or len(side) < FEWEST
        or not joints
        or not _is_motion(side)
    ):
        return []
    path = np.diff(side.position, axis=0)
    effort = 0.5 * (side.effort[1:] + side.effort[:-1])
    takes_out = np.sum(effort * path, axis=0) < 0.0
    # What follows other joints' speeds is friction and inertia that their motion brings: a coupled
    # axis may brake them. By chance it resembles the joint's own: the whole torque has to take
    # energy out, too.
    for j in range(effort.shape[1]):
        others = np.delete(path, j, axis=1)
        columns = np.hstack([others, np.sign(others), np.gradient(others, axis=0)])
        effort[:, j] -= columns @ np.linalg.lstsq(columns, effort[:, j], rcond=None)[0]
    work = np.array([part.sum(axis=0) for part in np.array_split(effort * path, _PARTS)])
    # 1.5 of the torque's rms times the range: what gravity may have taken at the end
    # 0.05 of the torque's rms times the path, beyond that
    lent = 1.5 * np.ptp(side.position, axis=0) + 0.05 * np.abs(path).sum(axis=0)
    # standard deviations
    certain = work.mean(axis=0) < -3.0 * work.std(axis=0, ddof=1) / np.sqrt(_PARTS)
    found = takes_out & certain & (work.sum(axis=0) < -rms(effort) * lent)
    words = "removes energy from the motion in addition to its friction"
    return about(
        joints,
        found,
        "backward_torque",
        "motor effort",
        words,
        "check its sign and that of the angle",
    )


def _same_arrays(recording: Recording) -> list[Finding]:
    link = recording.link
    motor = recording.motor
    if link is None or motor is None or not np.array_equal(link.stamp_ns, motor.stamp_ns):
        return []
    findings = []
    for channel, words in (
        ("position", "there is only one encoder"),
        ("effort", "there is only one torque"),
    ):
        one = link.channels().get(channel)
        other = motor.channels().get(channel)
        if one is not None and other is not None:
            # 1e-12 is the span of a difference of two channels that are the same numbers, but for
            # an offset
            same = (np.ptp(one - other, axis=0) <= 1e-12) & (np.ptp(one, axis=0) > 0.0)
            what = f"link and motor {channel}"
            findings += about(
                recording.joints, same, f"same_{channel}", what, "are the same numbers", words
            )
    return findings
