"""The most informative segments of the motion in a long recording.

The value of a segment is its contribution to the information of the others, ln |1 + sum of C'C /
s²| (D-optimality). C are the columns of the equations of motion, times the usual deviation of each
number of the description, and those of each joint's friction. Standstill has no value, and a
repeated motion little.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import savgol_filter

from elastic_arm.arrays import Array, Mask, median_step
from elastic_arm.dynamics import Model, build_model
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.stuck_channels import moves
from elastic_arm.recording.sides import Side, Stamps
from elastic_arm.recording.standstill import STANDS, moving_spans, standing_note, within
from elastic_arm.recording.timebase.clocks import HOLE, rates_of
from elastic_arm.robot import Robot

# s of motion that are taken of one recording of three joints, and less in proportion to more: a
# diagnosis takes 2 GB beside as much, and an identification two minutes (benchmarks/bench_day.py);
# deviations fall with its root alone.
DIAGNOSED = 60.0
IDENTIFIED = 600.0
SEGMENT = 10.0  # s; several swings of an arm
RATE = 50.0  # Hz at which a motion is looked at, and s over which its derivatives are taken
WINDOW = 0.2
# What numbers of a description are off by, of themselves (evidence/priors.py: masses 0.06, springs
# 0.15), and the friction of a joint, Nm, at 1 rad/s too.
USUAL = 0.1
FRICTION = 5.0
# Errors of a torque: noise, Nm, and what the model misses, of the torque itself. A jump of an
# encoder, whose torque would be absurd, so tells no more than any other sample.
NOISE = 1.0
MISSED = 0.02


def in_parts(recording: Recording, least: int = 2) -> list[Recording]:
    """Return the parts of a recording, so many or more, that hold some seconds of samples each."""
    stamps = _stamps(recording)
    t = (stamps - stamps[0]) * 1e-9
    count = least
    if len(t) > 1:
        seconds = len(t) * median_step(t)
        count = max(least, round(seconds / SEGMENT))
    begins = np.linspace(0, len(t), count, endpoint=False).astype(int)
    return _cut(recording, t[begins].tolist())


def of_one_rate(recording: Recording, lasting: float) -> list[Recording]:
    """Return the parts of a recording between changes of its rate.

    Parts shorter than so many s are left out. Each has noise of its own.
    """
    samples = recording.samples()
    found = rates_of(samples.t, lasting)
    if len(found) < 2:
        return [recording]
    begins = [float((samples.stamp_ns[k] - recording.start_ns) * 1e-9) for k, _ in found]
    rates = ", ".join(
        f"{rate:.4g} Hz from {begin:.1f} s" for begin, (_, rate) in zip(begins, found, strict=True)
    )
    words = (
        f"{recording.source or 'the recording'}: the rate changes; parts of one rate"
        f" are used separately: {rates}"
    )
    parts = _cut(replace(recording, notes=(*recording.notes, words)), [0.0, *begins[1:]])
    return [part for part in parts if moves(part)] or [recording]


def _cut(recording: Recording, begins: Sequence[float]) -> list[Recording]:
    """Return the parts of a recording that begin at so many s of it, named by their times."""
    if len(begins) == 1:
        return [recording]
    edges = [*begins, recording.duration + 1.0]
    end = recording.duration
    return [
        replace(
            recording.between(a, b), source=f"{recording.source}, {a:.0f} to {min(b, end):.0f} s"
        )
        for a, b in pairwise(edges)
    ]


def _recorded_seconds(recording: Recording) -> float:
    """Return how long a recording lasts, s, without its holes."""
    stamps = _stamps(recording)
    return float(np.diff(stamps)[_unbroken(stamps)].sum()) * 1e-9


def _stamps(recording: Recording) -> Stamps:
    """Return the stamps of the side with the most samples."""
    return max((side.stamp_ns for side in recording.measured().values()), key=len)


def _unbroken(stamps: Stamps) -> Mask:
    """Return between which stamps there is no hole."""
    steps = np.diff(stamps)
    return np.asarray(steps < HOLE * np.median(steps)) if len(steps) else steps > 0


@dataclass
class Segment:
    """Some seconds of motion, and the information (P, P) in them."""

    recording: Recording
    seconds: float
    information: Array


class MostTelling:
    """The segments of a recording that tell most, taken from its parts one after another.

    seconds: of motion, all segments together, `exact` or for three joints and fewer for more.
    """

    def __init__(self, robot: Robot, seconds: float, *, exact: bool = False) -> None:
        self.seconds = seconds if exact else seconds * min(1.0, 3.0 / robot.n)
        self.moving = self.recorded = self.whole = (
            0.0  # s of motion, of all samples, and with holes, so far
        )
        self._model = build_model(robot, "mod3")
        self._segments: list[Segment] = []
        self._first: Recording | None = None
        self._last: Recording | None = None

    def add(self, part: Recording) -> None:
        """Take the next part of the recording."""
        self._first = self._first or part
        self._last = part
        self.whole += part.duration
        self.recorded += _recorded_seconds(part)
        stamps = _stamps(part)
        for begin, end in moving_spans(part).tolist():
            own = stamps[slice(*np.searchsorted(stamps, (begin, end + 1)))]
            for run in np.split(own, np.flatnonzero(~_unbroken(own)) + 1):
                count = max(1, round((run[-1] - run[0]) * 1e-9 / SEGMENT))
                edges = run[0] + np.linspace(0, run[-1] + 1 - run[0], count + 1).astype(np.int64)
                for first, last in pairwise(edges.tolist()):
                    self._take(within(part, np.array([[first, last - 1]])))
        if sum(one.seconds for one in self._segments) > 2.0 * self.seconds:
            self._segments = self._chosen()

    def _take(self, motion: Recording) -> None:
        sides = motion.measured().values()
        if not all(map(len, sides)):
            return
        self.moving += (seconds := _recorded_seconds(motion))
        side = next(
            (
                side
                for side in (motion.motor, motion.link)
                if side is not None and side.position is not None
            ),
            None,
        )
        if side is not None:
            self._segments.append(Segment(motion, seconds, _information(side, self._model)))

    def _chosen(self) -> list[Segment]:
        """Return the segments that tell most, one at least, in the order of their times."""
        left = list(range(len(self._segments)))
        kept = list[int]()
        total = 0.0
        information = np.eye(len(self._segments[0].information))
        while left:
            gains = [
                np.linalg.slogdet(information + self._segments[k].information)[1] for k in left
            ]
            best = left.pop(int(np.argmax(gains)))
            if kept and total + self._segments[best].seconds > self.seconds:
                break
            information = information + self._segments[best].information
            total += self._segments[best].seconds
            kept.append(best)
        return [self._segments[k] for k in sorted(kept)]

    def recording(self) -> Recording:
        """Return what was taken as one recording with holes.

        Its notes state how much of the whole it is.
        """
        assert self._first is not None and self._last is not None
        if not self._segments:
            return self._first  # without motion, as whoever asks for it will say
        chosen = self._chosen()
        found = Recording.joined([one.recording for one in chosen])
        seconds = sum(one.seconds for one in chosen)
        source = self._last.source
        notes = list(self._last.notes)
        if self.whole - self.recorded > 1.0:
            notes.append(
                f"{source}: nothing was recorded in {self.whole - self.recorded:.0f} of"
                f" {self.whole:.0f} s"
            )
        if self.recorded - self.moving > 1.0:
            notes.append(standing_note(source, self.recorded - self.moving, self.whole))
        if self.moving - seconds > 1.0:
            notes.append(
                f"{source}: the most informative {seconds:.0f} s of {self.moving:.0f} s of"
                " motion are used (--motion uses more)"
            )
        return replace(found, currents=self._last.currents, notes=tuple(notes))


def _information(side: Side, model: Model) -> Array:
    """Return C'C / s² (P, P) of a motion, for independent samples one 20th of a second apart."""
    assert side.position is not None
    position = np.nan_to_num(side.position)
    step = max(median_step(side.stamp_ns) * 1e-9, 1e-9) if len(side) > 1 else 1.0
    width = max(round(WINDOW / step) // 2 * 2 + 1, 5)
    if len(position) <= 2 * width:
        position = np.zeros((2 * width + 1, model.n))  # too short to tell anything
    every = slice(width, -width, max(1, round(1.0 / (RATE * step))))
    q = savgol_filter(position, width, 3, deriv=0, delta=step, axis=0)[every]
    dq = savgol_filter(position, width, 3, deriv=1, delta=step, axis=0)[every]
    ddq = savgol_filter(position, width, 3, deriv=2, delta=step, axis=0)[every]
    double = (lambda rate: np.hstack([rate, rate])) if model.robot.elastic else (lambda rate: rate)
    terms = model.regressor(double(q), double(dq), double(ddq)) * model.Psi
    error = np.hypot(NOISE, MISSED * terms.sum(axis=-1))
    rows = (USUAL * terms / error[:, :, None]).reshape(-1, terms.shape[-1])
    found = np.zeros((rows.shape[1] + 2 * model.n,) * 2)
    found[: rows.shape[1], : rows.shape[1]] = rows.T @ rows
    friction = FRICTION * np.hstack([np.tanh(dq / STANDS), dq]) / np.tile(error[:, -model.n :], 2)
    found[rows.shape[1] :, rows.shape[1] :] = friction.T @ friction
    return found / (RATE * WINDOW)
