"""Prepare a recording for all computations; the check of a bag reports the same steps.

- Samples of zeros that another publisher sends between those of the arm are removed.

- Outliers (for example damaged words) are removed: samples whose distance from the median of their
neighbours exceeds several times the range of nearly all samples of the channel, and single samples
whose distance from the cubic through four neighbours is many times the usual one and more than an
arm can move within a sample.

- Angles that are given within one turn are unwrapped.

- A recording is split where a joint jumps in a physically impossible way.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from elastic_arm.arrays import Indices, Mask, median_step
from elastic_arm.codegen.parallel import share_out
from elastic_arm.errors import RecordingError
from elastic_arm.recording.inspection.one_clock import by_one_clock
from elastic_arm.recording.inspection.report import Finding, about, moment, note, warning
from elastic_arm.recording.inspection.stuck_channels import (
    HELD,
    at_updates,
    filled_in,
    position_at,
)
from elastic_arm.recording.inspection.two_encoders import with_one_zero
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import MOST_DUTY, Array, Side, joints_with, listed

# rad (or m), rad/s, Nm, rad/s², share of full duty, V. Angles larger than that have lost the digits
# that a motion is computed from; numbers of this size are counts of an encoder, or a channel that
# holds something else.
LARGEST = {
    "position": 1e6, "velocity": 1e6, "effort": 1e9, "acceleration": 1e9, "pwm": MOST_DUTY,
    "supply": 1e4,
}  # fmt: skip
_UNITS = {
    "position": "rad", "velocity": "rad/s", "effort": "Nm", "acceleration": "rad/s²",
    "pwm": "times the full duty", "supply": "V",
}  # fmt: skip
# Nm; the squares of smaller torques are zero, whatever they measure.
SMALLEST_TORQUE = 1e-150
_FEWEST = 50  # samples; of fewer no range is known
_LOOKED_AT = 5000  # samples that the range is taken from
_CENTRAL = (0.5, 99.5)  # per cent of the samples that the range spans
_INNER = (5.0, 95.0)  # of the narrower one that decides what is absurd
_BEYOND = 3.0  # ranges from the neighbours
_ABSURD = 1e2  # inner ranges from the middle; such numbers must not enter the range itself
_LEAST_INNER = 1000.0  # times the least range: an arm may rest nearly all of the time
_NEIGHBOURS = 5  # on either side
_SPIKE = 12.0  # standard deviations of the noise, of the distance from the cubic
_NEARLY_ALL = 98.0  # per cent
_SPIKE_SHARE = 0.01  # of the samples; more are no outliers but the noise
_ROUND = 3  # samples to either side of one, within which a joint turns round there
_STEPS = 4.0  # of the channel's resolution
_ACCELERATION = 30.0  # rad/s^2, to which an arm changes within a sample
_CUBIC = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0
# rad, rad/s, Nm, rad/s^2, share of full duty
_LEAST = {"position": 1e-3, "velocity": 1e-3, "effort": 0.1, "acceleration": 1e-2, "pwm": 1e-2}
_RANGE = 1.1  # turns, with noise at the ends, that an angle spans which is given within one
# Left out behind a jump, a hole that nobody bridges.
_APART = 6  # samples
_APART_SECONDS = 0.02  # s


@dataclass(frozen=True)
class Outliers:
    """The outliers of one channel of one joint: place, samples, the largest value, and the reason
    in words."""

    side: str
    channel: str
    joint: str
    rows: Indices
    largest: float
    why: str

    def words(self) -> str:
        """Return the finding as a clause."""
        count = f"{len(self.rows)} sample{'s' if len(self.rows) > 1 else ''}"
        return (
            f"{count} of the {self.side} {self.channel} of {self.joint} up to {self.largest:.3g},"
            f" {self.why}"
        )


def without_outliers(recording: Recording) -> Recording:
    """Return the recording prepared for computations; its notes list the corrections."""
    whole, found = cleared(recording)
    if not found:
        return whole
    where = recording.source or "the recording"
    return replace(
        whole, notes=(*recording.notes, *(f"{where}: {finding.message}." for finding in found))
    )


def cleared(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return the usable recording and the list of corrections.

    Without corrections, the recording is the same object.
    """
    found: list[Finding] = []
    for step in (by_one_clock, without_zeros, _without_far_samples, _in_one_piece, at_updates):
        recording = step(recording, found)
    _require_possible(recording)
    return with_one_zero(recording, found), found


def without_zeros(recording: Recording, found: list[Finding]) -> Recording:
    """Remove samples of zeros, or of one pose that is sent repeatedly, if most of them cannot
    belong to the motion.

    They cannot if their neighbours are closer to each other than to them, by more than the joints
    move in the surrounding samples.
    """
    kept: dict[str, Any] = {}
    for name, side in recording.measured().items():
        q = side.position
        if name in kept or q is None or len(side) < _FEWEST:
            continue
        sent, what = _sent_again(side, q)
        others = np.delete(np.arange(len(side)), sent)
        if not len(sent) or not len(others):
            continue
        place = np.clip(np.searchsorted(others, sent), 1, len(others) - 1)
        far = q[others[np.clip(place - 2, 0, len(others) - 1)]]
        before = q[others[np.clip(place - 1, 0, len(others) - 1)]]
        after = q[others[np.clip(place, 0, len(others) - 1)]]
        later = q[others[np.clip(place + 1, 0, len(others) - 1)]]
        pose = q[sent[0]]
        least = [max(_STEPS * _resolution(column), _LEAST["position"]) for column in q[others].T]
        around = np.abs(after - before) + np.abs(before - far) + np.abs(later - after)
        away = np.minimum(np.abs(before - pose), np.abs(after - pose)) - around > least
        if np.mean(away.any(axis=1)) > 0.5:
            words = (
                f"{len(sent)} of {len(side)} samples of the {name} side contain {what} between"
                " other values"
            )
            first = moment(side.stamp_ns, int(sent[0]))
            found.append(
                warning(
                    "zeros_between",
                    words,
                    f"a second publisher? They are excluded, first at {first}",
                )
            )
            # Sides of the same messages have the same stamps.
            for also, one in recording.measured().items():
                if np.array_equal(one.stamp_ns, side.stamp_ns):
                    kept[also] = one.at(others)
    return replace(recording, **kept) if kept else recording


def _sent_again(side: Side, q: Array) -> tuple[Indices, str]:
    """Return the samples of zeros, or otherwise those of the sample that recurs most often, and a
    description."""
    zero = np.flatnonzero(~np.nan_to_num(q).any(axis=1))
    same = _most_often(q.sum(axis=1))
    for values in side.channels().values():
        zero = zero[~np.nan_to_num(values[zero]).any(axis=1)]
        same = same[(np.nan_to_num(values[same]) == np.nan_to_num(values[same[:1]])).all(axis=1)]
    if not len(zero) and not (np.diff(same) > 1).any():
        return same[:0], ""  # equal sums of other numbers
    return (zero, "only zeros") if len(zero) else (same, "the same repeated values")


def _most_often(numbers: Array) -> Indices:
    """Return the positions of the number (N,) that recurs most often after other numbers."""
    ordered = np.sort(numbers)
    if not (ordered[1:] == ordered[:-1]).any():
        return np.empty(0, np.intp)
    which = np.unique(numbers, return_inverse=True)[1]
    counts = np.bincount(which[np.flatnonzero(np.diff(which, prepend=-1))], minlength=2)
    most = int(np.argmax(counts))
    return (
        np.flatnonzero(which == most)
        if np.partition(counts, -2)[-2] < counts[most]
        else np.empty(0, np.intp)
    )


def _without_far_samples(recording: Recording, found: list[Finding]) -> Recording:
    good: dict[str, Mask] = {}
    for outliers in find_outliers(recording):
        side: Side = getattr(recording, outliers.side)
        good.setdefault(outliers.side, np.ones(len(side), np.bool_))[outliers.rows] = False
        found.append(warning("outliers", f"excluded as outliers: {outliers.words()}"))
    kept: dict[str, Any] = {name: getattr(recording, name).at(rows) for name, rows in good.items()}
    return replace(recording, **kept) if kept else recording


class _Continuous(NamedTuple):
    """An angle (N,) that was unwrapped after the samples `turned`; its jumps by `size` after
    `rows`, and where its speed continues."""

    q: Array
    turned: Indices
    turn: float
    rows: Indices
    size: Array
    runs_on: Mask


def _in_one_piece(recording: Recording, found: list[Finding]) -> Recording:
    """Unwrap angles that are given within one turn, and split sides at impossible jumps of a
    joint."""
    kept: dict[str, Any] = {}
    for name, side in recording.measured().items():
        if side.position is None or len(side) < _FEWEST or not np.all(np.diff(side.stamp_ns) > 0):
            continue
        if np.nanmax(np.abs(side.position), initial=0.0) > LARGEST["position"]:
            continue
        t = np.asarray((side.stamp_ns - side.stamp_ns[0]) * 1e-9)
        columns = [(t, column) for column in np.ascontiguousarray(side.position.T)]
        looked_at = share_out(lambda one: _continuous(*one), columns)
        jumping = Counter(row for each in looked_at for row in each.rows.tolist())
        position = side.position.copy()
        parted = np.zeros(len(side), np.bool_)
        turned: dict[str, float] = {}
        for j, (joint, each) in enumerate(zip(recording.joints, looked_at, strict=True)):
            what = f"{name} position of {joint}"
            if len(each.turned):
                position[:, j] = each.q
                turned[joint] = each.turn
                found.append(_unwound(what, side, each))
            if not len(each.rows):
                continue
            remedy = (
                "two publishers, or a channel other than an angle? Results that depend on it"
                " are unreliable"
            )
            if len(each.rows) <= _SPIKE_SHARE * len(side):
                behind = max(_APART, round(_APART_SECONDS * len(t) / t[-1]))
                for row in each.rows.tolist():
                    parted[row + 1 : row + 1 + behind] = True
                alone = _zero_was_set(side.effort, each, jumping)
                alone &= side.effort is not None or recording.n > 1
                jumps = np.zeros(len(side) - 1)
                jumps[each.rows[alone]] = each.size[alone]
                position[:, j] = _less(position[:, j], jumps)
                remedy = "concatenated recordings? The recording is split there"
                if alone.all():
                    remedy = (
                        "speed and all other channels continue, so its zero was set during the"
                        " recording: the jump is removed"
                    )
            found.append(_jumped(what, joint, side, each, remedy))
        whole = replace(side, position=position)
        if parted.any() or not np.array_equal(position, side.position, equal_nan=True):
            kept[name] = whole.at(~parted)
        if "reference" not in kept:
            kept |= _commands_unwound(recording, whole, turned, found)
    return replace(recording, **kept) if kept else recording


def _unwound(what: str, side: Side, each: _Continuous) -> Finding:
    """Report that an angle was unwrapped, and where first."""
    first = f"{len(each.turned)} times, first after {moment(side.stamp_ns, int(each.turned[0]))}"
    words = f"{what} is given within a turn of {each.turn:.4g} rad and jumps by a turn {first}"
    return note(f"{words}: it was unwrapped", "wrapped")


def _jumped(what: str, joint: str, side: Side, each: _Continuous, remedy: str) -> Finding:
    """Report how often and how far an angle jumps."""
    k = int(np.argmax(np.abs(each.size)))
    row = int(each.rows[k])
    place = f"by {each.size[k]:.4g} rad after sample {row}, {moment(side.stamp_ns, row)}"
    way = "in a physically impossible way"
    words = f"{what} jumps {way}, {place}"
    if len(each.rows) > 1:
        words = f"{what} jumps {len(each.rows)} times {way}, the largest {place}"
    time = (side.stamp_ns[row] - side.stamp_ns[0]) * 1e-9
    return Finding("warning", "jumps", f"{words}: {remedy}", joint=joint, time=float(time))


def _zero_was_set(effort: Array | None, each: _Continuous, jumping: Mapping[int, int]) -> Mask:
    """Return after which jumps of a joint everything else continues, and no other joint jumps."""
    alone = [jumping[row] == 1 and _runs_on(effort, row) for row in each.rows.tolist()]
    return np.array(alone) & each.runs_on


def _commands_unwound(
    recording: Recording, side: Side, turned: Mapping[str, float], found: list[Finding]
) -> dict[str, Side]:
    """Return the reference with commands by the turn nearest to the angle of the joint, if any
    command is by another turn.

    This concerns joints whose angle was unwrapped by a turn, rad, and joints whose command alone is
    given within one turn, or is whole turns away from the angle throughout.
    """
    given = recording.reference
    position = side.position
    if given is None or given.position is None or position is None or len(given) < 2:
        return {}
    nearest = given.position.copy()
    other = np.zeros(recording.n, np.bool_)
    t = given.stamp_ns - side.stamp_ns[0]
    for j in np.flatnonzero(joints_with(given.position) & joints_with(position)).tolist():
        command = given.position[:, j]
        angle = np.interp(t, side.stamp_ns - side.stamp_ns[0], position[:, j])
        within = np.ptp(command) < _RANGE * 2 * np.pi and np.abs(np.diff(command)).max() > np.pi
        away = np.unique(np.rint((angle - command) / (2 * np.pi)))
        throughout = len(away) == 1 and away[0] != 0.0
        turn = turned.get(recording.joints[j], 2 * np.pi if within or throughout else 0.0)
        if not turn:
            continue
        by_turns = command + turn * np.rint((angle - command) / turn)
        # A step that a joint was told to make is none of the angle's turns: then nothing comes
        # nearer.
        if np.sum((by_turns - angle) ** 2) < 0.25 * np.sum((command - angle) ** 2):
            nearest[:, j] = by_turns
            other[j] = True
    words = (
        "are given within a turn, like the angle or by another turn: they were"
        " unwrapped to follow it"
    )
    found += about(recording.joints, other, "wrapped", "commands", words, severity="note")
    return {"reference": replace(given, position=nearest)} if other.any() else {}


def _runs_on(effort: Array | None, row: int) -> bool:
    """Return whether torques (N, n) change after a sample by no more than they usually do."""
    if effort is None:
        return True
    steps = np.abs(np.diff(effort[max(row - _LOOKED_AT, 0) : row + _LOOKED_AT], axis=0))
    usual = np.nanpercentile(steps, _NEARLY_ALL, axis=0) if joints_with(effort).all() else np.inf
    return bool((np.abs(effort[row + 1] - effort[row]) <= 2.0 * usual).all())


def _continuous(t: Array, q: Array) -> _Continuous:
    """Remove the turns of an angle, and find its other jumps.

    Three or more jumps of equal size are turns as well: the angle of a motor within its turn jumps
    by a turn divided by the gear ratio.
    """
    if np.isnan(q[0]):
        return _Continuous(
            q,
            *(np.empty(0, np.intp), 0.0, np.empty(0, np.intp), np.empty(0), np.empty(0, np.bool_)),
        )
    turns = np.zeros(len(q) - 1)
    # An angle that is given within a turn stays in that range.
    if np.ptp(q) < _RANGE * 2 * np.pi and np.abs(step := np.diff(q)).max() > np.pi:
        turns = np.rint(step / (2 * np.pi))
        # What still jumps then was no turn, and nothing is where any two samples are half a turn
        # apart.
        unwound = _less(q, 2 * np.pi * turns)
        turns[_jumps(t, unwound)[0]] = 0.0
        # 0.1 of a turn, which nearly all steps are below, where turns can be told from motion
        turns *= np.percentile(np.abs(np.diff(unwound)), _NEARLY_ALL) < 0.1 * 2 * np.pi
        q = _less(q, 2 * np.pi * turns)
    turned = np.flatnonzero(turns)
    rows, size, doubt, runs_on = _jumps(t, q)
    usual = float(np.median(np.abs(size))) if len(rows) > 2 else 0.0
    if (
        len(rows) > 2
        and np.ptp(q) < _RANGE * usual
        and (np.abs(np.abs(size) - usual) < doubt).all()
    ):
        jumps = np.zeros_like(turns)
        jumps[rows] = usual * np.sign(size)
        return _Continuous(_less(q, jumps), rows, usual, rows[:0], size[:0], runs_on[:0])
    return _Continuous(q, turned, 2 * np.pi, rows, size, runs_on)


def _less(q: Array, jumps: Array) -> Array:
    return q - np.concatenate([[0.0], np.cumsum(jumps)])


def _jumps(t: Array, q: Array) -> tuple[Indices, Array, Array, Mask]:
    """Return after which samples an angle (N,) moves much faster than before and after, faster than
    any force could move a joint.

    The result also contains the size of each jump, its uncertainty, and whether the speed is the
    same after it. For a channel that holds its values, the intervals between updates are compared.
    """
    step = np.diff(q)
    bent = np.abs(np.diff(step))
    noise = 1.48 * float(np.median(bent[:: max(len(bent) // _LOOKED_AT, 1)]))
    least = 0.5 * _ACCELERATION * float(np.diff(t).min()) ** 2
    # Nearly all angles end here: a jump is one of the steps, too.
    rows = np.flatnonzero(step) if bent.max() > _SPIKE * noise + least else np.empty(0, np.intp)
    if len(rows) < _FEWEST:
        return rows[:0], np.empty(0), np.empty(0), np.empty(0, np.bool_)
    ends = np.append(rows, len(q) - 1)
    moved = np.diff(q[ends])
    lasting = np.diff(t[ends])
    near = np.pad(moved / lasting, 2, mode="reflect")
    around = np.stack([near[k : k + len(moved)] for k in (0, 1, 3, 4)])
    noise = 1.48 * float(np.median(np.abs(moved[1:] - moved[:-1] * (lasting[1:] / lasting[:-1]))))
    fastest = np.abs(around).max(axis=0)
    # 0.05 rad, that play and wind-up of a drive release at once where it turns round
    limit = 0.05 + _SPIKE * noise + 0.5 * _ACCELERATION * lasting**2 + _STEPS * _resolution(q)
    # A sample that is some cycles late moves as far as the joint does in them.
    usual = median_step(t)
    limit += 3.0 * fastest * usual  # 3.0 cycles that a sample may be late
    # Where samples are missing a joint may have gone anywhere.
    together = t[rows + 1] - t[rows] < 2.5 * usual
    found = np.flatnonzero(together & (np.abs(moved) - fastest * lasting > limit))
    around = around[:, found]
    lasting = lasting[found]
    limit = limit[found]
    size = moved[found] - np.median(around, axis=0) * lasting
    runs_on = np.abs(around[2] - around[1]) * lasting < 2.0 * limit
    return rows[found], size, 2.0 * limit, runs_on


def find_outliers(recording: Recording) -> list[Outliers]:
    """Return the outliers of the measured sides of a recording."""
    channels = [
        (
            recording.joints,
            name,
            side,
            channel,
            position_at(recording, side) if channel == "effort" else None,
        )
        for name, side in recording.measured().items()
        if len(side) >= _FEWEST
        for channel in side.channels()
        if channel != "supply"
    ]
    return [
        found
        for of_channel in share_out(lambda one: list(_of_channel(*one)), channels)
        for found in of_channel
    ]


def _of_channel(
    joints: Sequence[str], name: str, side: Side, channel: str, position: Array | None
) -> Iterator[Outliers]:
    """Yield samples far outside the range of nearly all samples, and for the other joints samples
    far from their neighbours."""
    values = side.channels()[channel]
    # What is far from zeros that were filled in is what was measured.
    moving = np.ones(len(values), np.bool_)
    there = [
        j
        for j in np.flatnonzero(joints_with(values)).tolist()
        if filled_in(values[:, j], moving) <= HELD
    ]
    if not there:
        return
    low, high = _central(values[:, there], channel)
    interval = np.diff(side.stamp_ns) * 1e-9
    step = float(np.median(interval))
    usual = interval < 1.5 * step
    regular = usual[:-3] & usual[1:-2] & usual[2:-1] & usual[3:]
    turning = _turning(position)
    for j, least, most in zip(there, low.tolist(), high.tolist(), strict=True):
        column = np.ascontiguousarray(values[:, j])
        rows = _far(column, least, most, channel)
        why = f"while nearly all others are between {least:.3g} and {most:.3g}"
        if not len(rows):
            rows, why = _off_neighbours(column, step, regular, channel, turning)
        if len(rows):
            largest = float(column[rows[np.argmax(np.abs(column[rows]))]])
            yield Outliers(name, channel, joints[j], rows, largest, why)


def _far(column: Array, low: float, high: float, channel: str) -> Indices:
    """Return which samples are several ranges away from the median of their neighbours, or
    extremely far from all others."""
    width = high - low
    # Nearly all channels end with one look at their extremes. Halves, as the largest numbers that
    # there are overflow.
    if column.max() <= high + 0.5 * _BEYOND * width and column.min() >= low - 0.5 * _BEYOND * width:
        return np.empty(0, np.intp)
    suspects = np.flatnonzero((column > high + 0.5 * width) | (column < low - 0.5 * width))
    begin = np.clip(suspects - _NEIGHBOURS, 0, len(column) - 2 * _NEIGHBOURS - 1)
    around = np.median(column[begin[:, None] + np.arange(2 * _NEIGHBOURS + 1)], axis=1)
    apart = np.abs(0.5 * column[suspects] - 0.5 * around)
    absurd = np.abs(0.5 * column[suspects] - 0.25 * (low + high))
    least = max(width, _LEAST_INNER * _LEAST[channel])
    return suspects[(apart > 0.5 * _BEYOND * width) | (absurd > 0.5 * _ABSURD * least)]


def _off_neighbours(
    column: Array, step: float, regular: Mask, channel: str, turning: Indices
) -> tuple[Indices, str]:
    """Return which single samples are far from the cubic through their neighbours, and a
    description of the distance.

    Both neighbours of an outlier deviate by two thirds of its distance to the other side; at a
    step, one neighbour deviates by a third. At the samples `turning` the distance also has to
    exceed the range of the channel, because a torque may cross this range and return.
    """
    low, high = np.percentile(column[:: max(len(column) // _LOOKED_AT, 1)], _INNER)
    # Numbers near the largest that there are have been found by the range.
    off = np.convolve(
        np.clip(column, low - _ABSURD * (high - low), high + _ABSURD * (high - low)),
        _CUBIC,
        mode="valid",
    )
    apart = np.abs(off)
    inside = turning[(turning > 1) & (turning < len(column) - 2)] - 2
    # What is usual where joints turn round, if that is not most of the time, is compared with what
    # is there.
    calm = np.delete(apart, inside) if 2 * len(inside) < len(apart) else apart
    typical = calm[:: max(len(calm) // _LOOKED_AT, 1)]
    tail = float(np.percentile(typical, _NEARLY_ALL))
    # 5.0 times the distance that nearly all samples keep within: noise has no such tail
    limit = max(_SPIKE * float(np.median(typical)) / 0.6745, 5.0 * tail)
    limit += {
        "position": _ACCELERATION * step**2,
        "velocity": _ACCELERATION * step,
        "effort": 0.003 * float(high - low),  # 0.003 of the range
        "pwm": 0.003 * float(high - low),  # a duty makes a torque
    }.get(channel, 0.0)
    rows = 1 + np.flatnonzero((apart > limit)[1:-1] & regular[1:-1])
    rows = rows[~np.isin(rows, inside) | (apart[rows] > high - low)]
    if not 0 < len(rows) <= _SPIKE_SHARE * len(column):
        return rows[:0], ""
    opposite = np.maximum(off[rows - 1] / off[rows], off[rows + 1] / off[rows])
    # 0.45 of a spike's distance, by which its neighbours are off the other way
    rows = rows[(opposite < -0.45) & (apart[rows] > limit + _STEPS * _resolution(column))]
    rows = rows[_returns(column, rows + 2, apart[rows]) & ~_late(column, rows + 2, apart[rows])]
    # What other turns show: a torque may ring as a joint turns round.
    ringing = 5.0 * float(np.percentile(apart[inside], _NEARLY_ALL)) if len(inside) else 0.0
    rows = rows[
        apart[rows] > np.where(np.isin(rows + 2, turning), max(float(high - low), ringing), 0.0)
    ]
    furthest = float(apart[rows].max(initial=0.0))
    kept = f"while {_NEARLY_ALL:.0f} % of all stay within {tail:.2g}"
    return rows + 2, (
        f"with a deviation of up to {furthest:.2g} from the curve through its neighbours, {kept}"
    )


def _returns(column: Array, rows: Indices, apart: Array) -> Mask:
    """Return which samples deviate by at least 0.7 of `apart` to the same side from the lines
    before and after them.

    At a step, as of friction when a joint reverses, or at a bend, the sample is on one of the two
    lines or between them; in longer disturbances the neighbours lie on the way.
    """
    if not len(rows):
        return np.zeros(0, np.bool_)
    before = column[rows] - (2.0 * column[rows - 1] - column[rows - 2])
    after = column[rows] - (2.0 * column[rows + 1] - column[rows + 2])
    return (before * after > 0.0) & (np.minimum(np.abs(before), np.abs(after)) > 0.7 * apart)


def _late(column: Array, rows: Indices, apart: Array) -> Mask:
    """Return which samples were taken one cycle late or early: they equal the sample before or
    after them."""
    slope = 0.5 * np.abs(column[rows + 1] - column[rows - 1])
    beside = np.minimum(
        np.abs(column[rows] - column[rows - 1]), np.abs(column[rows] - column[rows + 1])
    )
    return (beside < 0.3 * slope) & (apart < 1.5 * slope)


def _turning(position: Array | None) -> Indices:
    """Return at which samples any joint reverses, or hardly moves, so that its friction may have
    either sign.

    Its friction also acts on other joints, through the gears of wrists and through the links.
    """
    if position is None:
        return np.empty(0, np.intp)
    step = np.pad(
        np.diff(position[:, joints_with(position)], axis=0), ((1, 0), (0, 0)), mode="edge"
    )
    around = np.stack([np.roll(step, k, axis=0) for k in range(-_ROUND, _ROUND + 2)])
    turns = (around.min(axis=0) <= 0.0) & (around.max(axis=0) >= 0.0)
    return np.flatnonzero(turns.any(axis=1))


def _resolution(column: Array) -> float:
    """Return the smallest difference between two samples that are not equal."""
    different = np.abs(np.diff(column[:_LOOKED_AT]))
    return float(different[different > 0].min(initial=np.inf)) if different.any() else 0.0


def sane_limits(values: Array, channel: str) -> tuple[Array, Array]:
    """Return the numbers (n,) beyond which a sample of a channel (N, n) is absurd."""
    lower, upper = np.percentile(values, _INNER, axis=0)
    middle = 0.5 * (lower + upper)
    spread = np.maximum(upper - lower, _LEAST_INNER * _LEAST[channel])
    return middle - _ABSURD * spread, middle + _ABSURD * spread


def _central(values: Array, channel: str) -> tuple[Array, Array]:
    """Return lower and upper end (n,) of the range of nearly all samples, at least as wide as the
    resolution of the channel."""
    centres = 2 + np.arange(0, len(values) - 4, max((len(values) - 4) // _LOOKED_AT, 1))
    looked_at = values[centres[:, None] + np.arange(-2, 3)]
    lowest, highest = sane_limits(looked_at[:, 2], channel)
    sane = np.where(
        (looked_at[:, 2] >= lowest) & (looked_at[:, 2] <= highest),
        looked_at[:, 2],
        0.5 * (lowest + highest),
    )
    low, high = np.percentile(sane, _CENTRAL, axis=0)
    # Impulses that one sample in a hundred or more holds, and neighbours do not, must not widen it
    # either.
    calm_low, calm_high = np.percentile(np.median(looked_at, axis=1), _CENTRAL, axis=0)
    # 5.0 times the range of medians of five samples; of noise alone it is less than twice that
    impulsive = (high - low) / 5.0 > np.maximum(calm_high - calm_low, _LEAST[channel])
    low = np.where(impulsive, calm_low, low)
    high = np.where(impulsive, calm_high, high)
    # 0.05 of the largest range among the joints, for those that hardly move
    range_ = high - low
    least = np.maximum(_LEAST[channel], 0.05 * range_.max())
    narrow = 0.5 * np.maximum(least - range_, 0.0)
    return low - narrow, high + narrow


def _require_possible(recording: Recording) -> None:
    """Refuse a recording with numbers that no arm can have, naming side, channel, joints and the
    largest number."""
    for name, side in recording.measured().items():
        for channel, values in side.channels().items():
            if not len(values):
                continue
            # NumPy is slow along the first axis of a narrow array.
            ends = [
                (np.fmin.reduce(row), np.fmax.reduce(row)) for row in np.ascontiguousarray(values.T)
            ]
            largest = np.array([np.nan_to_num(max(-low, high)) for low, high in ends])
            what = ""
            if (beyond := largest > LARGEST[channel]).any():
                reached = f"{largest.max():.3g} {_UNITS[channel]}"
                what = f"{name} {channel} of {listed(recording.joints, beyond)} reaches {reached}"
            elif channel == "effort" and 0.0 < largest.max() < SMALLEST_TORQUE:
                what = f"{name} effort is {largest.max():.3g} Nm at most"
            if what:
                problem = (
                    f"{recording.source or 'the recording'}: {what}, which is implausible for an"
                    " arm"
                )
                raise RecordingError(problem, "Check its unit and the content of the channel")
