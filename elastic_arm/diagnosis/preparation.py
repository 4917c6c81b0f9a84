"""Preparation of a diagnosis: recordings and question become a problem to be explained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.common_equations import common_equations
from elastic_arm.diagnosis.encoder_zeros import with_common_zeros
from elastic_arm.diagnosis.events import Event
from elastic_arm.diagnosis.preprocessing import needs_motion, standing, usable
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.split import HELD_BACK, SHORTEST, independent, split
from elastic_arm.diagnosis.words import LOW_PASSED, bare_note, standing_note, unseen_notes
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Effect, EffectInstance, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import ControllerEffect, Scope
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.effects.library.friction import PLAIN
from elastic_arm.equations.numbers import Number
from elastic_arm.equations.places import feature_of, features, recorded_features
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equation_sets import SIDES, EquationSet
from elastic_arm.estimation.observation import Observation, continued, observe
from elastic_arm.estimation.segments import of_one_rate
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.priors import Priors
from elastic_arm.evidence.problem import Problem, uncertain_numbers
from elastic_arm.identification.batch.ignored_commands import (
    IgnoredCommands,
    without_ignored_commands,
)
from elastic_arm.identification.batch.mounting import Mounting, other_mounting, states_tilt
from elastic_arm.identification.batch.selection import turning_speeds
from elastic_arm.memory import available_memory
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.plausibility import smoothed_torques
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.recording.standstill import without_standstill
from elastic_arm.robot import Robot

# Bytes of products of columns per joint cubed, and of columns per joint and whitened row, measured
# with three and six joints and all sides recorded.
OF_JOINTS = 13e6
OF_ROW = 11e3


@dataclass(frozen=True)
class Prepared:
    """The problem to be explained, and notes on the data."""

    problem: Problem  # recordings, equations, numbers, effects
    unseen: tuple[EffectInstance, ...]  # known effects that act in no recorded equation
    # of the fitted and of the validation recordings
    sources: tuple[tuple[str, ...], tuple[str, ...]]
    # start of each fitted and each validation part in its recording, s
    begins: tuple[dict[str, float], dict[str, float]]
    judged: dict[str, tuple[float, float]]  # recording -> interval used for validation, s
    independent_motion: bool  # whether the validation motion differs from the fitted motion
    notes: tuple[str, ...]  # on the data
    mounting: Mounting | None  # the mounting of the arm if it differs from the described one
    made: tuple[str, ...]  # joints with motor torques that are computed from commands
    events: tuple[Event, ...] = ()  # events that are left out
    # stretches that were cut because drives ignored their commands
    ignored: tuple[Event, ...] = ()

    @property
    def all_events(self) -> tuple[Event, ...]:
        """The stretches that were cut, and the events that are left out."""
        return (*self.ignored, *self.events)

    def without(self, events: Sequence[Event]) -> Prepared:
        """Return the problem without these events, and with all others."""
        if tuple(events) == self.events:
            return self
        parts = []
        for begins, part in zip(self.begins, self.problem.observed, strict=True):
            parts.append(tuple(self._lacking(events, begins, one) for one in part))
        problem = replace(self.problem, observed=(parts[0], parts[1]))
        return replace(self, problem=problem, events=tuple(events))

    def _lacking(
        self, events: Sequence[Event], begins: Mapping[str, float], one: Observation
    ) -> Observation:
        """Return an observation without the events of its recording."""
        names = self.problem.robot.joint_names
        first = begins[one.source]
        at = []
        for event in events:
            if event.recording == one.source:
                place = SIDES.index(event.side), names.index(event.joint)
                at.append((*place, event.begin - first, event.end - first))
        return replace(one, events=tuple(at))


def prepare(
    recordings: Sequence[Recording], validate: Sequence[Recording], question: Question
) -> Prepared:
    """Split, clean and observe recordings, and collect the uncertain numbers and candidate effects.

    validate: validation recordings; if empty, the last third of each recording is used.

    Raises a DiagnosisError if the recordings allow no diagnosis: no torque, no motion, too short,
    validation equal to identification data; a RecordingError if a recording lacks a joint.
    """
    split_up = _split_up(recordings, validate, question.robot, question.model)
    fitted, judging = split_up.parts
    observed = _observed(split_up.parts, held_back=split_up.held_back)
    robot, mounting = _mounted(question, observed[0])
    motored = all(piece.tau_m is not None for one in observed[0] for piece in one.pieces)
    robot = robot.with_armatures() if motored else robot
    observed = _turning_over(robot, fitted, observed)
    model = build_model(robot, question.model)
    layout, band = common_equations([*observed[0], *observed[1]], model)
    _check_memory(observed[0], layout, band)
    names = robot.joint_names
    at_rest = [standing(recording) for recording in fitted]
    still = [joint for joint in names if all(joint in joints for joints in at_rest)]
    acting = _acting(question, robot, layout)
    largest = _largest_torques(observed[0], robot.n)
    priors = question.priors.of_currents(split_up.currents)
    numbers, directions = uncertain_numbers(
        robot,
        question.model,
        observed,
        layout,
        _uncertain(question),
        acting.seen,
        largest,
        priors,
        split_up.held_back,
    )
    candidates = _candidates(question, robot, still, layout, numbers, observed[0][0], acting.seen)
    problem = Problem(
        robot=robot,
        model=question.model,
        observed=observed,
        layout=layout,
        band=band,
        numbers=numbers,
        directions=directions,
        stated=acting.stated,
        given=acting.given,
        candidates=tuple(candidates),
        usual=_usual(candidates, acting.seen),
        largest=largest,
        far=frozenset(effect.id for effect in question.candidates),
        held_back=split_up.held_back,
    )
    notes = dict.fromkeys(note for part in observed for one in part for note in one.notes)
    return Prepared(
        problem=problem,
        unseen=acting.unseen,
        sources=(tuple(r.source for r in fitted), tuple(r.source for r in judging)),
        begins=split_up.begins,
        judged=split_up.judged,
        independent_motion=independent(fitted, judging),
        notes=(*notes, *_notes(split_up, still, layout, acting.unseen, priors)),
        mounting=mounting,
        made=tuple(name for name in names if name in fitted[0].made_by),
        ignored=split_up.ignored,
    )


Parts = tuple[Sequence[Recording], Sequence[Recording]]  # fitted, validation


class _SplitUp(NamedTuple):
    """Recordings without standstill, each at one rate."""

    parts: Parts
    begins: tuple[dict[str, float], dict[str, float]]  # as in :class:`Prepared`
    held_back: bool  # whether the validation recordings are the last parts of the fitted ones
    ignored: tuple[Event, ...]  # stretches that were cut because drives ignored their commands

    @property
    def judged(self) -> dict[str, tuple[float, float]]:
        """Recording -> interval used for validation, s."""
        begins = self.begins[1]
        found = {}
        for recording in self.parts[1]:
            begin = begins[recording.source]
            found[recording.source] = begin, begin + recording.duration
        return found

    @property
    def currents(self) -> list[str]:
        """The torque channels that are currents times a constant."""
        found: set[str] = set()
        for recording in chain.from_iterable(self.parts):
            found.update(recording.currents)
        return sorted(found)


def _split_up(
    recordings: Sequence[Recording], validate: Sequence[Recording], robot: Robot, model: str
) -> _SplitUp:
    """Cut recordings at standstill, changes of rate and ignored commands, clean them, and split
    them."""
    held_back = not validate
    least = SHORTEST / HELD_BACK if held_back else SHORTEST
    first = _moving(recordings, robot, least)
    second = _moving(validate, robot, least)
    chosen = [by_motor_encoders(part, robot) for part, _ in (*first, *second)]
    alike = with_common_zeros(share_out(lambda one: usable(one, robot), chosen), robot)
    followed: list[Recording] = []
    ignored: list[Event] = []
    for one, (_, start) in zip(alike, (*first, *second), strict=True):
        made = with_made_torque(one, robot)
        kept, stretches = without_ignored_commands(made, robot, model)
        followed.append(kept)
        ignored += _ignored(made, stretches, (made.start_ns - start) * 1e-9)
    fitted, judging = split(followed[: len(first)], followed[len(first) :])
    begins = _begins(fitted, first), _begins(judging, first if held_back else second)
    return _SplitUp((fitted, judging), begins, held_back, tuple(ignored))


def _moving(
    recordings: Sequence[Recording], robot: Robot, least: float
) -> list[tuple[Recording, int]]:
    """Return the moving parts of recordings, each with the start of its recording, ns.

    least: shortest part, s.
    """
    found = []
    for recording in recordings:
        moving = without_standstill(recording.select(robot.joint_names))
        found += [(part, recording.start_ns) for part in of_one_rate(moving, least)]
    return found


def _begins(
    parts: Sequence[Recording], moving: Sequence[tuple[Recording, int]]
) -> dict[str, float]:
    """Return the start of each part in its recording, s."""
    pairs = zip(parts, moving, strict=True)
    return {part.source: (part.start_ns - start) * 1e-9 for part, (_, start) in pairs}


def _ignored(
    recording: Recording, stretches: Sequence[IgnoredCommands], offset: float
) -> Iterator[Event]:
    """Yield the stretches in which drives ignore their commands, as events of each joint.

    offset: s from the first sample of the whole recording to that of this part.
    """
    for one in stretches:
        begin = one.begin + offset
        end = one.end + offset
        for joint, size in one.sizes.items():
            yield Event(recording.source, joint, "motor", begin, end, size, ignored=True)


class _Acting(NamedTuple):
    """The stated and given effects that act in a recorded equation, and those that act in none."""

    stated: tuple[EffectInstance, ...]
    given: tuple[EffectInstance, ...]
    unseen: tuple[EffectInstance, ...]

    @property
    def seen(self) -> list[EffectInstance]:
        """All effects that act in a recorded equation."""
        return [*self.stated, *self.given]


def _acting(question: Question, robot: Robot, layout: EquationSet) -> _Acting:
    """Return the known effects; those of the user replace those of the description."""
    equations = ArmEquations(robot, question.model)
    given = {(instance.effect.id, instance.joint) for instance in question.known}
    stated = [
        instance
        for instance in robot_effects(robot, question.catalogue)
        if (instance.effect.id, instance.joint) not in given
    ]
    seen: list[tuple[EffectInstance, ...]] = []
    unseen: list[EffectInstance] = []
    for part in (stated, question.known):
        acting = [i for i in part if feature_of(i, equations).acts]
        _refuse_of_commands([i for i in part if i not in acting], robot)
        own = tuple(i for i in acting if _is_seen(feature_of(i, equations), layout))
        seen.append(own)
        unseen += [i for i in acting if i not in own]
    return _Acting(seen[0], seen[1], tuple(unseen))


def _refuse_of_commands(silent: Sequence[EffectInstance], robot: Robot) -> None:
    """Raise a DiagnosisError if one of the effects that act nowhere would act on the commands of a
    joint whose torque comes from its duty."""
    for instance in silent:
        joints = [robot.joints[i] for i in instance.joint_indices(robot)]
        driven = [joint.name for joint in joints if joint.follows_duty]
        if driven and isinstance(instance.effect, ControllerEffect):
            raise DiagnosisError(
                f"{instance.effect.id} acts on commands, but the torque of {', '.join(driven)}"
                " comes from its recorded duty (pwm)",
                "Omit it, or leave pwm out of the recordings",
            )


def _uncertain(question: Question) -> list[Effect]:
    """Return the effects of sensors and of numbers of the arm that are not given."""
    given = {instance.effect.id for instance in question.known}
    effects = [e for e in question.catalogue.values() if e.prior is not None or _has_number(e)]
    return [e for e in effects if e.id not in given]


def _has_number(effect: Effect) -> bool:
    """Whether an effect is an error of a number of the arm."""
    return bool(effect.number) or (
        isinstance(effect, ControllerEffect) and bool(effect.number_of_duty)
    )


def _notes(
    split_up: _SplitUp,
    still: Sequence[str],
    layout: EquationSet,
    unseen: Sequence[EffectInstance],
    priors: Priors,
) -> Iterator[str]:
    """Yield notes on the data that are not in the observations."""
    fitted, judging = split_up.parts
    yield from _low_passed((fitted, judging))
    yield from (standing_note(joint) for joint in still)
    bare = [fitted[0].joints[j] for j in layout.without_rows]
    if bare:
        yield bare_note(bare)
    yield from unseen_notes(unseen, bare)
    shares = [(channel, priors.sensors[f"{channel}_gain"]) for channel in split_up.currents]
    if shares:
        gains = " and ".join(
            f"{100 * share:.2g} % for the {channel.replace('_', ' ')}s" for channel, share in shares
        )
        yield f"Torques are currents times a torque constant, whose assumed accuracy is {gains}."


def _check_memory(observed: Sequence[Observation], layout: EquationSet, band: Band) -> None:
    """Raise a DiagnosisError if the memory is too small, before it is allocated."""
    seconds = sum(one.duration for one in observed)
    need = OF_JOINTS * layout.n**3 + OF_ROW * layout.n * layout.rows * 2.0 * band.cutoff * seconds
    if need > (there := available_memory()):
        raise DiagnosisError(
            f"{seconds:.0f} s of {layout.n} joints need about {need / 1e9:.2g} GB of"
            f" memory, but {there / 1e9:.2g} GB are free",
            "Use less motion (--motion 20), fewer recordings or more memory",
        )


def _largest_torques(observed: Sequence[Observation], n: int) -> Array:
    """Return the largest torque of each joint (n,), Nm."""
    pieces = [piece for one in observed for piece in one.pieces]
    torques = [t for piece in pieces for t in (piece.tau_m, piece.tau_J) if t is not None]
    each = [np.nanmax(np.abs(torque), axis=0, initial=0.0) for torque in torques]
    found = np.nanmax(each or [np.ones(n)], axis=0)
    return np.maximum(found, 1e-3 * max(float(found.max()), 1e-9))


def _observed(
    parts: Sequence[Sequence[Recording]], *, held_back: bool
) -> tuple[tuple[Observation, ...], tuple[Observation, ...]]:
    """Return the motion of both parts; a validation part that was held back continues the fitted
    part."""
    together = share_out(observe, chain.from_iterable(parts))
    first = together[: len(parts[0])]
    rest = together[len(parts[0]) :]
    if not held_back:
        return tuple(first), tuple(rest)
    cuts = [(b.start_ns - a.start_ns) * 1e-9 for a, b in zip(*parts, strict=True)]
    joined = [continued(a, b, cut) for a, b, cut in zip(first, rest, cuts, strict=True)]
    return tuple(a for a, _ in joined), tuple(b for _, b in joined)


def _mounted(question: Question, observed: Sequence[Observation]) -> tuple[Robot, Mounting | None]:
    """Return the arm with the mounting that its torques show, and this mounting; the described arm
    and None if they agree with the description."""
    known = (*robot_effects(question.robot, question.catalogue), *question.known)
    asked = any(effect.id == TILT for effect in question.candidates)
    if not asked or states_tilt(known):
        return question.robot, None
    found = other_mounting(
        question.robot, question.model, [piece for one in observed for piece in one.pieces]
    )
    return (question.robot, None) if found is None else (found.of(question.robot), found)


def _turning_over(
    robot: Robot,
    recordings: Sequence[Recording],
    observed: tuple[tuple[Observation, ...], tuple[Observation, ...]],
) -> tuple[tuple[Observation, ...], tuple[Observation, ...]]:
    """Return the observations with the speeds at which dry friction changes its sign.

    Friction that changes more gradually than its law would be mistaken for another law, or for a
    lag of the torque. In arms with elastic joints the motion of the motors hides the change, and
    low-passed torques show their filter instead: there the noise of the velocity decides.
    """
    whole = all(o.torque_band == np.inf for part in observed for o in part)
    speeds = turning_speeds(recordings, robot) if whole and not robot.elastic else None
    first, second = (tuple(replace(o, turning=speeds) for o in part) for part in observed)
    return first, second


def _low_passed(parts: Sequence[Sequence[Recording]]) -> list[str]:
    """Return a note on torques without any noise at high frequencies, for the first such
    recording."""
    for recording in chain.from_iterable(parts):
        for words in smoothed_torques(recording):
            return [f"{words}: {LOW_PASSED}."]
    return []


def _is_seen(feature: Feature, layout: EquationSet) -> bool:
    """Whether an effect acts in a recorded equation.

    A joint torque sensor does not see the friction of a motor, and an effect that acts only in void
    rows is not seen at all.
    """
    if feature.choices.get("side") == "motor" and set(layout.sides) <= {"link", "drive"}:
        return False
    whole = bool(layout.live.all()) or feature.effect.regressor is not None
    return whole or bool(layout.transform[:, feature.rows].any())


def _usual(candidates: Sequence[Feature], seen: Sequence[EffectInstance]) -> frozenset[Key]:
    """Return the friction of joints without stated or known friction: every real drive has some.

    It acts on the motor, or on the bearing of the link if only torques behind the gear are
    recorded.
    """
    stated = {(i.effect.id, i.joint) for i in seen}
    plain = [feature for feature in candidates if feature.effect.id in PLAIN]
    of_motors = {f.joint for f in plain if f.choices.get("side") == "motor"}
    found = set()
    for feature in plain:
        side = "motor" if feature.joint in of_motors else "link"
        is_usual = feature.choices.get("side") == side
        if is_usual and (feature.effect.id, feature.joint) not in stated:
            found.add(feature.key)
    return frozenset(found)


def _candidates(
    question: Question,
    robot: Robot,
    still: Sequence[str],
    layout: EquationSet,
    numbers: Sequence[Number],
    observed: Observation,
    seen: Sequence[EffectInstance],
) -> list[Feature]:
    """Return every effect at every place at which motion and channels can show it.

    Effects that are far-off numbers, and known effects, are not candidates.
    """
    equations = ArmEquations(robot, question.model)
    held = {(p.cause.effect.id, p.joint) for p in numbers if p.cause is not None}
    wholly = {effect for effect, _ in held}
    known = {feature_of(i, equations).key for i in seen}
    shown = recorded_features(features(equations, question.candidates), observed.pieces[0])
    if question.robot.n == 1:  # its one joint is the whole arm
        shown = [f for f in shown if f.joint is not None or f.effect.scope is not Scope.EACH_OR_ARM]
    free = [
        f
        for f in shown
        if (f.effect.id, f.joint) not in held and not (f.joint is None and f.effect.id in wholly)
    ]
    visible = (f for f in free if _is_seen(f, layout) and f.key not in known)
    return [f for f in visible if f.joint not in still or not needs_motion(f)]
