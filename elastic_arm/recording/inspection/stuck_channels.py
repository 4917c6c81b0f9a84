"""Channels that do not follow the motion: stuck, held, filled with zeros, at an end of their range,
or frozen."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from elastic_arm.arrays import Indices, Mask, median_step, rms
from elastic_arm.formatting import JointUnits
from elastic_arm.recording.inspection.report import FEWEST, Finding, Severity, about, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, joints_with, span_of
from elastic_arm.robot import Robot

# An arm whose joints all travel less than this, rad, stands still.
STILL = 1e-3
# How far a joint has moved for certain: beyond play, wind-up and the steps of encoders. Convention.
MOVED = {"rad": 0.05, "m": 0.005}
# Channels that need not follow the motion of an arm.
NOT_OF_MOTION = ("acceleration", "supply")
NO_MOTION = "Record an excitation from `elastic-arm excite`"
_ENOUGH = 50_000  # samples of a channel that show how it is updated; bounds the time
_NOTHING = {"effort": 1e-9}  # Nm within which a torque does not change: no sensor resolves it
_CLEAR = 4.0  # times the channel's resolution: a change that no rounding makes
HELD = 0.002  # share of repeated samples; a lost cycle in 500 is ordinary
_MISSED = (
    0.05  # share of repeated samples, beyond which it is no slip now and then of a good recorder
)
_LEVELS = 3  # next to the extreme, that it is compared with
# Times the samples at any of these: a sine without noise is at its peak 2.4 times as often as a
# step below.
_PILED = 5.0
_INNER = (5.0, 95.0)  # per cent of the samples between which a torque is mostly
_AROUND = 5  # samples to either side, within which a joint that turns changes its position
_LONG = 5  # samples in a row that repeat; a lost cycle or two is ordinary
_LISTED = 5  # times that are written out

# Codes, words and remedies.
_SAID = {
    "stuck": (
        "stuck",
        "is constant while the joint moves",
        "the channel is not connected, or not read: results that depend on it are unreliable",
    ),
    "stuck torque": (
        "stuck",
        "is constant while the joint moves",
        (
            "the channel is not connected, or not read: identify and diagnose treat it as not"
            " recorded"
        ),
    ),
    "zeros": (
        "zeros_between",
        "is zero between nonzero values",
        "zeros fill missing values: remove them",
    ),
    "clipped": (
        "clipped",
        "stays at one end of its range while the joint moves",
        (
            "the drive or its channel saturates, and the true torque is larger: record"
            " with less torque"
        ),
    ),
}


def moves(recording: Recording) -> bool:
    """Return whether any joint moves, or contains non-finite numbers; without positions, the joints
    count as moving."""
    positions = [
        side.position for side in recording.measured().values() if side.position is not None
    ]
    if not positions or not all(map(len, positions)):
        return True
    return any(
        not np.ptp(column) < STILL
        for values in positions
        for column in values[:, joints_with(values)].T
    )


def least_travel(recording: Recording, robot: Robot | None) -> Array:
    """Return how far (n,) rad or m each joint has to travel to have moved for certain; without a
    description, all joints turn."""
    units = JointUnits(recording.joints) if robot is None else robot.units
    return np.array([MOVED[units.at(joint, "rad")] for joint in recording.joints])


def channel_findings(recording: Recording, robot: Robot | None = None) -> list[Finding]:
    """Return which channels do not follow the motion.

    All rules look at each channel of each joint once.
    """
    if not moves(recording):
        words = "the recording contains no motion: identify and diagnose cannot use it"
        return [warning("no_motion", f"{words}. {NO_MOTION}")]
    travel = _travels(recording)
    least = least_travel(recording, robot)
    findings = []
    for name, side in recording.measured().items():
        if len(side) < FEWEST:
            continue
        position = position_at(recording, side)
        for channel, values in side.channels().items():
            if channel not in NOT_OF_MOTION:
                others = [far > least for what, far in travel.items() if what != (name, channel)]
                moving = np.any(others, axis=0) if others else np.zeros(recording.n, np.bool_)
                findings += _of_channel(
                    recording, f"{name} {channel}", side, values, position, moving
                )
    return findings


def _of_channel(
    recording: Recording,
    what: str,
    side: Side,
    values: Array,
    position: Array | None,
    moving: Mask,
) -> list[Finding]:
    """Return what one channel of all joints shows; `moving` are the joints that others show to
    move."""
    channel = what.split()[1]
    middle = _middle(side)
    said: dict[str, list[str]] = defaultdict(list)
    periods = np.zeros(recording.n)
    shares = np.zeros(recording.n)
    for j in np.flatnonzero(joints_with(values)).tolist():
        joint = recording.joints[j]
        column = values[:, j]
        if np.ptp(column) <= _NOTHING.get(channel, 0.0):
            if moving[j]:
                kind = "stuck torque" if channel == "effort" else "stuck"
                said[kind].append(f"{joint} at {float(column[0]) + 0.0:.3g}")
            continue
        turning = np.ones(len(side), np.bool_) if position is None else _changing(position[:, j])
        unlike = turning if position is None else _going(position[:, j])
        # which is zero by right where the encoder takes no step
        if channel == "velocity" and position is not None:
            steps = np.diff(position[:, j]) != 0.0
            unlike = unlike & np.append(steps, True) & np.append(True, steps)
        zeros = filled_in(column[middle], unlike[middle])
        if zeros > HELD:
            said["zeros"].append(f"{joint} in {100 * zeros:.2g} % of the samples")
        else:
            shares[j], periods[j] = _held(column[middle], turning[middle])
        ends = _piled(column, turning) if channel == "effort" else {}
        if ends:
            share = 100.0 * sum(ends.values())
            said["clipped"].append(
                f"{joint} for {share:.2g} % ({', '.join(f'{end:.3g}' for end in ends)})"
            )
    found = [
        warning(code, f"{what} {words}: {', '.join(said[kind])}", remedy)
        for kind, (code, words, remedy) in _SAID.items()
        if said[kind]
    ]
    held = (shares > HELD) & (periods <= 1.0)
    words = f"repeats the previous value in {span_of(100 * shares[held])} % of the samples"
    severity: Severity = "warning" if shares[held].max(initial=0.0) > _MISSED else "note"
    return found + about(
        recording.joints, held, "held", what, words, "the joint moves: cycles were missed", severity
    )


def at_updates(recording: Recording, found: list[Finding]) -> Recording:
    """Use held channels only at their updates, with a cubic spline between them."""
    kept: dict[str, Any] = {}
    slowest = 1.0
    read_ns = recording.read_ns
    for name, side in recording.measured().items():
        if len(side) < FEWEST or not np.all(np.diff(side.stamp_ns) > 0):
            continue
        stamps = side.stamp_ns
        middle = _middle(side)
        position = position_at(recording, side.at(middle))
        filled = dict[str, Any]()
        first = 0
        last = len(side)
        for channel, values in side.channels().items():
            if channel == "supply":
                continue
            periods = _periods(values[middle], position)
            held = (periods > 1.0) & np.isfinite(values).all(axis=0)
            if not held.any():
                continue
            column = values.copy()
            for j in np.flatnonzero(held).tolist():
                at = _updates(values[:, j], periods[j])
                through = CubicSpline(stamps[at] - stamps[0], values[at, j])
                column[:, j] = through(stamps - stamps[0])
                first = max(first, int(at[0]))
                last = min(last, int(at[-1]) + 1)
                if channel == "effort" and periods[j] > slowest:
                    slowest = periods[j]
                    read_ns = stamps[at]
            filled[channel] = column
            rate = 1e9 / median_step(stamps)
            rates = f"{span_of(rate / periods[held])} Hz in a recording of {rate:.4g} Hz"
            words = f"is held: it changes every {span_of(periods[held])} samples, {rates}"
            remedy = "only these updates are used, and they may be older than their stamps"
            found += about(recording.joints, held, "held", f"{name} {channel}", words, remedy)
        if filled:
            kept[name] = replace(side, **filled).at(slice(first, last))
    return replace(recording, **kept, read_ns=read_ns) if kept else recording


def _middle(side: Side) -> slice:
    """Return the samples in the middle of a side that show how its channels are updated."""
    return slice(max(0, (len(side) - _ENOUGH) // 2), (len(side) + _ENOUGH) // 2)


def _periods(values: Array, position: Array | None) -> Array:
    """Return the samples per update (n,) of a channel (N, n); 1 for joints that are not held."""
    periods = np.ones(values.shape[1])
    for j in np.flatnonzero(np.isfinite(values).all(axis=0)).tolist():
        column = values[:, j]
        turning = np.ones(len(column), np.bool_)
        going = turning
        if position is not None:
            turning = _changing(position[:, j])
            going = _going(position[:, j])
        share, period = _held(column, turning)
        if share > HELD and filled_in(column, going) <= HELD:
            periods[j] = max(period, 1.0)
    return periods


def _updates(column: Array, period: float) -> Indices:
    """Return the samples at which a channel (N,) has a new value; while the value stays the same,
    one sample per period counts as new."""
    at = np.flatnonzero(np.diff(column)) + 1
    same = [
        np.arange(a, b - period / 2, period)[1:]
        for a, b in pairwise(at.tolist())
        if b - a > 1.5 * period
    ]
    return np.sort(np.concatenate([at, *same]).astype(np.intp))


def _held(column: Array, moving: Mask) -> tuple[float, float]:
    """Return the share of samples that repeat the previous value although the channel changes
    before and after, and the number of samples per update.

    A rounded channel repeats its value by chance as often as it changes by one step; a joint at
    rest also repeats it.
    """
    step = np.diff(column)
    # Differences of rounded numbers, as velocities are, have last digits that are no change.
    step[np.abs(step) < 1e-9 * np.ptp(column)] = 0.0
    changes = np.flatnonzero(step)
    size = np.abs(step[changes])
    if len(changes) < 10:
        return 0.0, 1.0
    smallest = size.min()
    # 0.1 of the usual change
    clear = size > max(_CLEAR * smallest, 0.1 * float(rms(size, None)))
    runs = np.diff(changes)
    between = clear[:-1] & clear[1:] & moving[changes[:-1] + 1]
    # Longer ones are standstills, or the recording froze.
    between &= runs <= _LONG * max(float(np.median(runs[between])) if between.any() else 1.0, 1.0)
    repeats = int((runs[between] - 1).sum())
    # Changes by one step that lie between clear ones.
    chance = int(((size[1:-1] < 1.5 * smallest) & clear[:-2] & clear[2:]).sum())
    if repeats <= chance + 4.0 * np.sqrt(chance + 1.0):
        return 0.0, 1.0
    return repeats / float(runs[between].sum()), float(np.median(runs[between]))


def filled_in(column: Array, moving: Mask) -> float:
    """Return the share of zeros between values of one sign that are further from zero than from
    each other.

    Only zeros during which the joint is `moving` (N,) throughout are counted.
    """
    others = np.flatnonzero(column)
    if len(others) in (0, len(column)):
        return 0.0
    column = column / float(np.abs(column).max())  # products of the largest numbers overflow
    before = column[others[:-1]]
    after = column[others[1:]]
    apart = np.abs(after - before)
    least = _CLEAR * apart[apart > 0.0].min(initial=np.inf)
    away = np.minimum(np.abs(before), np.abs(after)) > apart + least
    # A torque of a joint that comes to rest between is zero by right.
    rests = np.concatenate([[0], np.cumsum(~moving)])
    without_rest = rests[others[1:]] == rests[others[:-1] + 1]
    missing = (np.diff(others) - 1)[away & (before * after > 0.0) & without_rest]
    return float(missing.sum() / len(column))


def _travels(recording: Recording) -> dict[tuple[str, str], Array]:
    """Return how far the joints (n,) move according to each channel: positions, and integrals of
    velocities."""
    found = {}
    for name, side in recording.measured().items():
        if side.position is not None and len(side):
            found[name, "position"] = np.ptp(side.position, axis=0)
        if side.velocity is not None and len(side):
            step = np.diff(side.stamp_ns, append=side.stamp_ns[-1])[:, None] * 1e-9
            # Without the mean: that of a joint at rest is the sensor's zero, which adds up.
            moving = side.velocity - side.velocity.mean(axis=0)
            found[name, "velocity"] = np.ptp(np.cumsum(moving * step, axis=0), axis=0)
    return found


def position_at(recording: Recording, side: Side) -> Array | None:
    """Return positions (N, n) at the samples of a side: its own, or those of the other side."""
    if side.position is not None:
        return side.position
    other = next((one for one in recording.measured().values() if one.position is not None), None)
    if other is None or other.position is None:
        return None
    columns = [np.interp(side.stamp_ns, other.stamp_ns, column) for column in other.position.T]
    return np.column_stack(columns)


def _changing(position: Array) -> Mask:
    """Return where the position of a joint (N,) differs from those some samples earlier and
    later."""
    padded = np.pad(position, _AROUND, mode="edge")
    before = padded[: -2 * _AROUND]
    after = padded[2 * _AROUND :]
    # A joint that has no positions counts as one that moves.
    return (before != after) & ((before != position) | (after != position))


def _going(position: Array) -> Mask:
    """Return where a joint (N,) advances by more than the steps and the noise of its encoder at
    rest."""
    padded = np.pad(position, _AROUND, mode="edge")
    advance = np.abs(padded[2 * _AROUND :] - padded[: -2 * _AROUND])
    step = np.abs(np.diff(position))
    resolution = float(step[step > 0.0].min(initial=np.inf)) if step.any() else 0.0
    noise = 0.0
    if len(position) > 2:
        noise = float(np.median(np.abs(np.diff(position, 2)))) / 0.6745 / np.sqrt(6.0)
    # 6.0 standard deviations of the noise, of what a joint at rest seems to advance
    return np.asarray(advance > 1.5 * resolution + 6.0 * np.sqrt(2.0) * noise)


def _piled(torque: Array, moving: Mask) -> dict[float, float]:
    """Return the ends of the range of a torque (N,) at which its samples accumulate, with their
    shares."""
    values, counts = np.unique(torque[moving], return_counts=True)
    if len(values) < 20:  # 20 values; a channel of fewer has no range to speak of
        return {}
    changes = np.flatnonzero(np.diff(torque, prepend=np.nan, append=np.nan) != 0.0)
    runs = np.diff(changes)
    heights = torque[changes[:-1]]
    inner = runs[(heights > values[0]) & (heights < values[-1])]
    # 95.0 per cent of the runs of equal values, whose length is how long the channel holds one
    hold = float(np.percentile(inner, 95.0)) if len(inner) else 1.0
    found = {}
    for end, beside in ((0, slice(1, 1 + _LEVELS)), (-1, slice(-1 - _LEVELS, -1))):
        # 10 updates of the channel at its extreme; less is chance
        # 2e-3 of the samples; less spoils nothing
        often = counts[end] >= 10 * hold and counts[end] > 2e-3 * len(torque)
        # Zero is the end of a channel that has one sign, or of one that was switched off.
        piled = often and values[end] != 0.0 and counts[end] > _PILED * counts[beside].max()
        if piled and not _impulses(torque, float(values[end])):
            found[float(values[end])] = float(counts[end] / len(torque))
    return found


def _impulses(torque: Array, end: float) -> bool:
    """Return whether a torque (N,) jumps to an end of its range and back; a torque that saturates
    approaches the end gradually."""
    rows = np.flatnonzero(torque[1:-1] == end) + 1
    low, high = np.percentile(torque, _INNER)
    apart = np.minimum(np.abs(torque[rows - 1] - end), np.abs(torque[rows + 1] - end))
    return bool(len(rows) and np.mean(apart > high - low) > 0.5)


def frozen(recording: Recording) -> list[Finding]:
    """Return the intervals in which no channel changes although the arm moves.

    The samples in these intervals repeat an old one.
    """
    link = recording.link
    motor = recording.motor
    if link is not None and motor is not None and np.array_equal(link.stamp_ns, motor.stamp_ns):
        groups = {"all channels": [link, motor]}
    else:
        groups = {
            f"all channels of the {name} side": [side]
            for name, side in recording.measured().items()
        }
    return [
        found
        for what, sides in groups.items()
        for found in _frozen(what, sides, recording.start_ns)
    ]


def _hidden_speeds(t: Array, q: Array, begin: Indices, end: Indices) -> Array:
    """Return the speeds (k, n) of joints while samples are repeated from `begin` to `end` (k,); 0
    for joints at rest.

    A joint at rest continues from its position, slowly at first. A joint that moved on reappears at
    the position that follows from its speed before and after. At the end of a recording, a moving
    joint stops faster than any joint can brake.
    """
    last = len(t) - 1
    first = np.maximum(begin - 2, 0)
    behind = np.minimum(end + 1, last)
    further = np.minimum(behind + 2, last)
    spans = ((begin, first), (further, behind), (behind, begin))
    seconds = [np.maximum(t[late] - t[early], 1e-9)[:, None] for late, early in spans]
    before, after, across = (
        (q[late] - q[early]) / s for (late, early), s in zip(spans, seconds, strict=True)
    )
    one_way = (before * across > 0.0) & (after * across > 0.0)
    usual = 0.5 * np.abs(before + after)
    size = np.abs(across)
    # 3.0: between the speeds before and behind, which a joint that goes on has within this factor
    speeds = np.abs([before, after])
    alike = speeds.max(axis=0) < 3.0 * speeds.min(axis=0)
    # A joint that stood goes a sample's way in the one behind: across the stretch that is far
    # slower.
    went = one_way & alike & (size > 0.5 * usual) & (size < 2.0 * usual)
    sample = median_step(t)
    # 60.0 rad/s² within a sample, from a speed that was not falling
    advance = np.abs(q[begin] - q[np.maximum(begin - 1, 0)])
    stopped = (end == last)[:, None] & (advance > 60.0 * sample**2)
    return np.where(went, across, np.where(stopped, before, 0.0))


def _frozen(what: str, sides: list[Side], start_ns: int) -> list[Finding]:
    """Return the intervals in which no channel of sides with equal stamps changes although a joint
    moved before."""
    columns: list[Array] = []
    for side in sides:
        for values in side.channels().values():
            columns += list(values[:, joints_with(values)].T)
    t: Array = np.asarray((sides[0].stamp_ns - start_ns) * 1e-9, dtype=np.float64)
    moving = [(side.position, side.velocity) for side in sides if side.position is not None]
    if len(t) < FEWEST or not moving:
        return []
    same = np.logical_and.reduce([column[1:] == column[:-1] for column in columns])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    begin = edges[::2]
    end = edges[1::2]
    # Of an arm that stands still every sample is like the first.
    if not len(begin) or same.all():
        return []
    usual = float(np.median(np.diff(np.flatnonzero(~same), prepend=-1)))
    lasting = t[end] - t[begin]
    rates = [_hidden_speeds(t, q, begin, end) if v is None else v[begin] for q, v in moving]
    speed = np.max([np.nan_to_num(np.abs(rate)).max(axis=1) for rate in rates], axis=0)
    # 3.0 times the usual run of repeats, of channels that hold every value for some samples
    long = (end - begin >= _LONG) & (end - begin > 3.0 * usual)
    # 0.1 s of a run over which a joint would have moved on; one that brakes has stopped by then
    # 0.01 rad, beyond the steps of any encoder
    found = np.flatnonzero(long & (speed * np.minimum(lasting, 0.1) > 0.01))
    if not len(found):
        return []
    stretches = [f"{lasting[k]:.2g} s from {t[begin[k]]:.2f} s" for k in found]
    shown = ", ".join(stretches[:_LISTED])
    if len(found) > _LISTED:
        longest = int(np.argmax(lasting[found]))
        shown += f" and {len(found) - _LISTED} more, the longest {stretches[longest]}"
    often = "once" if len(found) == 1 else f"{len(found)} times"
    message = f"{what} are unchanged {often} while the arm moves: {shown}"
    remedy = "the recording froze, and these samples repeat old values: cut them out"
    return [Finding("warning", "frozen", f"{message}: {remedy}", time=float(t[begin[found[0]]]))]
