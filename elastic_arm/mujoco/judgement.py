"""The choice of corrections of a commanded arm that are written: those that do not make its motion
worse.

A joint moves worse if

    mean |e_corrected|² > mean |e_described|² + max(s, (step of the positions)² / 12)

s is the standard error of the description's mean over the halves of the recordings, if they repeat;
the second limit is the resolution of the encoder. Corrections that make a joint move worse are
taken back one by one, by joint or by cause of the whole arm, in the order of the best remaining
motion.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from elastic_arm.arrays import Array, Mask
from elastic_arm.errors import RobotError
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.mujoco.closed_loop import Span, latest, play
from elastic_arm.recording import Recording
from elastic_arm.results import ClosedLoopError
from elastic_arm.robot.mjcf import MjcfArm

JUDGED = 0.9  # share of the closed loop that is typically done before the judgement
PAUSE = 0.5  # s without a position, after which a recording is played anew
SHORTEST = 1.0  # s, of what is played on its own
# What is taken back (joints, and effects of the whole arm) -> the model without it; a RobotError
# where no simulator takes its numbers.
Build = Callable[[frozenset[str]], MjcfArm]


@dataclass(frozen=True)
class Judging:
    """A recording that judges, and which part of it: s from its start; the whole when None."""

    recording: Recording
    span: Span | None = None

    def stretches(self) -> Iterator[Span]:
        """Yield the parts between pauses, s from the recording's start."""
        recording = self.recording
        side = recording.link if recording.link is not None else recording.motor
        if side is None:
            return
        begin, end = self.span or (0.0, np.inf)
        t = (side.stamp_ns - recording.start_ns) * 1e-9
        t = t[(t >= begin) & (t <= end)]
        for part in np.split(t, np.flatnonzero(np.diff(t) > PAUSE) + 1):
            if len(part) and part[-1] - part[0] > SHORTEST:
                yield float(part[0]), float(part[-1])


@dataclass(frozen=True)
class ClosedLoop:
    """A model on recordings: mean squares of its errors of angles."""

    halves: Array  # (B, n) of the halves of each stretch, rad²
    samples: Array  # (B,) in each half
    resolution: Array  # (n,) smallest step between recorded positions, rad

    @property
    def squares(self) -> Array:
        """Mean squares over all samples, (n,) rad²."""
        return np.asarray(self.samples @ self.halves / self.samples.sum())

    @property
    def errors(self) -> Array:
        """Root mean squares, (n,) rad."""
        return np.sqrt(self.squares)

    def worse_than(self, other: "ClosedLoop") -> Mask:
        """Return at which joints (n,) the model moves worse than another one, beyond what the
        recordings repeat."""
        more = self.squares - other.squares
        doubt = other.halves.std(axis=0, ddof=1) / np.sqrt(len(other.halves))
        return np.asarray((more > np.maximum(doubt, self._unseen)) | ~np.isfinite(more))

    @property
    def _unseen(self) -> Array:
        """What of a mean square the encoders cannot tell, (n,) rad²."""
        return self.resolution**2 / 12.0

    def loss(self, other: "ClosedLoop") -> tuple[int, float]:
        """Return at how many joints it is worse than another model, and by how much nearer all are,
        in nats."""
        count = int(self.worse_than(other).sum())
        return count, float(np.mean(np.log(self.squares + self._unseen + 1e-18)))


def closed_loop(arm: MjcfArm, judging: Sequence[Judging], late: float = 0.0) -> ClosedLoop | None:
    """Play recordings in a model; None where there is nothing to play. Later starts by `late` s of
    known commands."""
    plays = [
        play(arm, one.recording, span=span, late=late)
        for one in judging
        for span in one.stretches()
    ]
    found = [one for one in plays if one is not None]
    if not found:
        return None
    halves = list[Array]()
    samples = list[int]()
    for one in found:
        for half in np.array_split(one.errors, 2):
            square = np.mean(half**2, axis=0)
            halves.append(np.where(np.isfinite(square), square, np.inf))
            samples.append(len(half))
    resolution = np.min([one.resolution for one in found], axis=0)
    return ClosedLoop(np.array(halves), np.array(samples), resolution)


@dataclass(frozen=True)
class Choice:
    """What of a correction is written, and how the arm moves with it."""

    errors: Mapping[str, ClosedLoopError]  # by joint
    taken_back: tuple[str, ...]  # joints, and effects of the whole arm, that stay as described
    worse: tuple[
        str, ...
    ]  # joints that move worse with all that was found, or that no simulator takes so
    better: bool  # whether any joint moves nearer with what is written
    reason: str = ""  # why no simulator takes all that was found; empty where one does

    @property
    def size(self) -> float:
        """Mean of the logarithms of the errors of what is written."""
        return float(np.mean([np.log(one.corrected + 1e-12) for one in self.errors.values()]))

    def with_errors(self, errors: Mapping[str, ClosedLoopError]) -> "Choice":
        """Return it with other errors."""
        return replace(self, errors=errors)


def chosen(
    described: MjcfArm,
    build: Build,
    units: Sequence[str],
    judging: Sequence[Judging],
    watch: Watch | None = None,
) -> Choice | None:
    """Choose what is written of a correction; None where nothing can be played.

    described: the model as it is; units: joints, and causes of the whole arm, each of which can be
    taken back; watch: is told of what is played, and may end the choice, which then takes all back
    that is not known to move as well.
    """
    watch = watch or Watch()
    search = _Search(described, build, judging, watch)
    first = search.described
    if first is None:
        return None
    everything = frozenset(units)
    whole = search.of(frozenset())
    reason = search.reasons.get(frozenset(), "")
    back = frozenset[str]()
    if whole is None and watch.is_over():
        back = everything
    elif whole is None:
        back = frozenset(one for one in units if search.of(everything - {one}) is None)
        back = back if search.of(back) is not None else everything
    while back != everything:
        here = search.of(back)
        assert here is not None
        if not here.worse_than(first).any():
            break
        if watch.is_over():
            back = everything
            break
        found = [back | {one} for one in units if one not in back]
        back = min(found, key=lambda one: search.loss(one))
    written = first if back == everything else search.of(back)
    assert written is not None
    joints = described.robot.joint_names
    worse = {name for name, bad in zip(joints, _worse(whole, first), strict=True) if bad}
    worse |= set(back) & set(joints) if whole is None else set()
    errors = {}
    for i, name in enumerate(joints):
        refused = None
        if name in worse:
            refused = np.inf if whole is None else float(whole.errors[i])
        unit = described.robot.units.at(name, "rad")
        errors[name] = ClosedLoopError(
            float(first.errors[i]), float(written.errors[i]), unit, refused
        )
    better = bool(first.worse_than(written).any())
    ordered = tuple(one for one in units if one in back)
    return Choice(errors, ordered, tuple(name for name in joints if name in worse), better, reason)


def _worse(whole: ClosedLoop | None, first: ClosedLoop) -> Iterable[Any]:
    return np.zeros(first.halves.shape[1], dtype=bool) if whole is None else whole.worse_than(first)


class _Search:
    """Models with some corrections taken back, each played once."""

    def __init__(
        self, described: MjcfArm, build: Build, judging: Sequence[Judging], watch: Watch
    ) -> None:
        self._build = build
        self._judging = judging
        self._watch = watch
        self._met: dict[frozenset[str], ClosedLoop | None] = {}
        self._models: dict[frozenset[str], MjcfArm] = {}
        self.reasons: dict[frozenset[str], str] = {}
        full = self._model(frozenset())
        # All models start where the latest of them knows its commands.
        self._late = max([latest(one) for one in (described, full) if one is not None], default=0.0)
        self.described = closed_loop(described, judging, self._late)

    def _model(self, back: frozenset[str]) -> MjcfArm | None:
        if back not in self._models:
            try:
                self._models[back] = self._build(back)
            except RobotError as error:
                self.reasons[back] = str(error)
                return None
        return self._models[back]

    def of(self, back: frozenset[str]) -> ClosedLoop | None:
        """Return how the arm moves without some corrections; None where no simulator takes it."""
        if back not in self._met:
            without = f" without {', '.join(sorted(back))}" if back else ""
            self._watch.say(
                f"closed loop: judging the correction{without}", Stage.CLOSED_LOOP, JUDGED
            )
            model = self._model(back)
            self._met[back] = (
                None if model is None else closed_loop(model, self._judging, self._late)
            )
            self._models.pop(back, None)
        return self._met[back]

    def loss(self, back: frozenset[str]) -> tuple[int, float]:
        """Return what is to be small."""
        found = self.of(back)
        assert self.described is not None
        return (
            (len(self.described.halves[0]) + 1, np.inf)
            if found is None
            else found.loss(self.described)
        )
