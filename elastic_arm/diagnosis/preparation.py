"""Recordings and a question become what is to be explained."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

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
from elastic_arm.effects import EffectInstance, robot_effects
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import Scope
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
from elastic_arm.evidence.problem import Problem, uncertain_numbers
from elastic_arm.identification.batch.ignored_commands import (
    IgnoredCommands,
    without_ignored_commands,
)
from elastic_arm.identification.batch.mounting import Mounting, other_mounting
from elastic_arm.identification.batch.selection import turning_speeds
from elastic_arm.memory import available_memory
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.plausibility import smoothed_torques
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders
from elastic_arm.recording.made_torque import with_made_torque
from elastic_arm.recording.standstill import without_standstill
from elastic_arm.robot import Robot

# Bytes of products of columns for each joint cubed, and of columns for each joint and whitened row;
# measured with three and six joints of which all sides are recorded.
OF_JOINTS, OF_ROW = 13e6, 11e3


@dataclass(frozen=True)
class Prepared:
    """What is to be explained, and what the reader should know of the data."""

    problem: Problem  # recordings, equations, numbers, effects
    unseen: tuple[EffectInstance, ...]  # known effects that act in no recorded equation
    sources: tuple[
        tuple[str, ...], tuple[str, ...]
    ]  # where the recordings of either part come from
    # recording -> where each part that is fitted or judges begins in it, s, and from when to when
    # it judges
    begins: tuple[dict[str, float], dict[str, float]]
    judged: dict[str, tuple[float, float]]
    independent_motion: bool  # whether the motion that judges is another one
    notes: tuple[str, ...]  # on the data
    mounting: Mounting | None  # how the arm is mounted, where that is not as described
    made: tuple[str, ...]  # joints whose motor torques are made of commands
    events: tuple[Event, ...] = ()  # that are left out
    ignored: tuple[Event, ...] = ()  # stretches that were cut, as drives ignored their commands

    def without(self, events: Sequence[Event]) -> Prepared:
        """Return it with these events, and no others, left out."""
        if tuple(events) == self.events:
            return self
        names = self.problem.robot.joint_names

        def lacking(which: int, one: Observation) -> Observation:
            first, there = (
                self.begins[which][one.source],
                (e for e in events if e.recording == one.source),
            )
            at = (
                (SIDES.index(e.side), names.index(e.joint), e.begin - first, e.end - first)
                for e in there
            )
            return replace(one, events=tuple(at))

        first, rest = (
            tuple(lacking(k, one) for one in part) for k, part in enumerate(self.problem.observed)
        )
        return replace(
            self, problem=replace(self.problem, observed=(first, rest)), events=tuple(events)
        )


def prepare(
    recordings: Sequence[Recording], validate: Sequence[Recording], question: Question
) -> Prepared:
    """Split, clear and observe recordings, and find what may be off and what may be there.

    validate: what judges them; the last third of the recordings' motion where none is given.

    Raises a DiagnosisError if the recordings allow no diagnosis: no torque, no motion, too short,
    validation equal to identification data; a RecordingError if a recording lacks a joint.
    """
    names, held_back = question.robot.joint_names, not validate
    least = SHORTEST / HELD_BACK if held_back else SHORTEST
    moving = [
        [
            (part, r.start_ns)
            for r in some
            for part in of_one_rate(without_standstill(r.select(names)), least)
        ]
        for some in (recordings, validate)
    ]
    chosen = [by_motor_encoders(r, question.robot) for r, _ in chain.from_iterable(moving)]
    alike = with_common_zeros(share_out(usable, chosen), question.robot)
    made_torques = [with_made_torque(one, question.robot) for one in alike]
    first_ns = [start for some in moving for _, start in some]
    cut = [without_ignored_commands(one, question.robot, question.model) for one in made_torques]
    alike = [one for one, _ in cut]
    ignored = tuple(
        event
        for one, start, (_, stretches) in zip(made_torques, first_ns, cut, strict=True)
        for event in _ignored(one, stretches, (one.start_ns - start) * 1e-9)
    )
    parts = split(alike[: len(moving[0])], alike[len(moving[0]) :])
    starts = (
        [start for _, start in moving[0]],
        [start for _, start in moving[0 if held_back else 1]],
    )
    begins = [
        {r.source: (r.start_ns - start) * 1e-9 for r, start in zip(part, own, strict=True)}
        for part, own in zip(parts, starts, strict=True)
    ]
    observed = _observed(parts, held_back=held_back)
    robot, mounting = _mounted(question, observed[0])
    motored = all(piece.tau_m is not None for one in observed[0] for piece in one.pieces)
    robot = robot.with_armatures() if motored else robot
    observed = _turning_over(robot, parts[0], observed)
    currents = sorted(
        {channel for part in parts for recording in part for channel in recording.currents}
    )
    made = tuple(name for name in names if name in parts[0][0].made_by)
    priors = question.priors.of_currents(currents)
    layout, band = common_equations(
        [*observed[0], *observed[1]], build_model(robot, question.model)
    )
    _check_memory(observed[0], layout, band)
    still = [joint for joint in names if all(joint in standing(r) for r in parts[0])]
    equations = ArmEquations(robot, question.model)
    own = {(instance.effect.id, instance.joint) for instance in question.known}
    stated = [
        i for i in robot_effects(robot, question.catalogue) if (i.effect.id, i.joint) not in own
    ]
    acting = [
        [i for i in part if feature_of(i, equations).acts] for part in (stated, question.known)
    ]
    seen = [tuple(i for i in part if _is_seen(feature_of(i, equations), layout)) for part in acting]
    unseen = tuple(
        i for part, kept in zip(acting, seen, strict=True) for i in part if i not in kept
    )
    largest = _largest_torques(observed[0], robot.n)
    given = {i.effect.id for i in question.known}
    uncertain = [
        e
        for e in question.catalogue.values()
        if (e.prior is not None or e.number) and e.id not in given
    ]
    numbers, directions = uncertain_numbers(
        robot,
        question.model,
        observed,
        layout,
        uncertain,
        [*seen[0], *seen[1]],
        largest,
        priors,
        held_back,
    )
    candidates = _candidates(question, equations, still, layout, numbers, observed[0][0], seen)
    problem = Problem(
        robot=robot,
        model=question.model,
        observed=observed,
        layout=layout,
        band=band,
        numbers=numbers,
        directions=directions,
        stated=seen[0],
        given=seen[1],
        candidates=tuple(candidates),
        usual=_usual(candidates, equations, seen),
        largest=largest,
        far=frozenset(effect.id for effect in question.candidates),
        held_back=held_back,
    )
    notes = list(dict.fromkeys(note for part in observed for o in part for note in o.notes))
    notes += [*_low_passed(parts), *(standing_note(joint) for joint in still)]
    bare = [names[j] for j in layout.without_rows]
    notes += [*([bare_note(bare)] if bare else []), *unseen_notes(unseen, bare)]
    gains = ", ".join(
        f"{100 * priors.sensors[f'{channel}_gain']:.2g} % of {channel}" for channel in currents
    )
    notes += (
        [f"Torques are currents times a torque constant, with an assumed accuracy of {gains}."]
        if currents
        else []
    )
    return Prepared(
        problem=problem,
        unseen=unseen,
        sources=(tuple(r.source for r in parts[0]), tuple(r.source for r in parts[1])),
        begins=(begins[0], begins[1]),
        judged={
            r.source: (begins[1][r.source], begins[1][r.source] + r.duration) for r in parts[1]
        },
        independent_motion=independent(*parts),
        notes=tuple(notes),
        mounting=mounting,
        made=made,
        ignored=ignored,
    )


def _ignored(
    recording: Recording, stretches: Sequence[IgnoredCommands], offset: float
) -> Iterator[Event]:
    """Yield the stretches in which a recording's drives ignore their commands, as events of each
    joint.

    offset: s from the first sample of what was recorded to that of this recording.
    """
    for one in stretches:
        begin = one.begin + offset
        end = one.end + offset
        for joint, size in one.sizes.items():
            yield Event(recording.source, joint, "motor", begin, end, size, ignored=True)


def _check_memory(observed: Sequence[Observation], layout: EquationSet, band: Band) -> None:
    """Refuse what memory is too small for, before it is taken."""
    seconds = sum(one.duration for one in observed)
    need = OF_JOINTS * layout.n**3 + OF_ROW * layout.n * layout.rows * 2.0 * band.cutoff * seconds
    if need > (there := available_memory()):
        raise DiagnosisError(
            f"{seconds:.0f} s of {layout.n} joints need about {need / 1e9:.2g} GB of"
            f" memory, but {there / 1e9:.2g} GB are free",
            "Use less motion (--motion 20), fewer recordings or more memory",
        )


def _largest_torques(observed: Sequence[Observation], n: int) -> Array:
    """Return the largest torque (n,) Nm that each joint carries."""
    pieces = [piece for one in observed for piece in one.pieces]
    torques = [t for piece in pieces for t in (piece.tau_m, piece.tau_J) if t is not None]
    found = np.nanmax(
        [np.nanmax(np.abs(t), axis=0, initial=0.0) for t in torques] or [np.ones(n)], axis=0
    )
    return np.maximum(found, 1e-3 * max(float(found.max()), 1e-9))


def _observed(
    parts: Sequence[Sequence[Recording]], *, held_back: bool
) -> tuple[tuple[Observation, ...], tuple[Observation, ...]]:
    """Return the motion of both parts; where the second was held back from the first, it continues
    it."""
    together = share_out(observe, chain.from_iterable(parts))
    first, rest = together[: len(parts[0])], together[len(parts[0]) :]
    if not held_back:
        return tuple(first), tuple(rest)
    cuts = [(b.start_ns - a.start_ns) * 1e-9 for a, b in zip(*parts, strict=True)]
    joined = [continued(a, b, cut) for a, b, cut in zip(first, rest, cuts, strict=True)]
    return tuple(a for a, _ in joined), tuple(b for _, b in joined)


def _mounted(question: Question, observed: Sequence[Observation]) -> tuple[Robot, Mounting | None]:
    """Return the arm as its torques show it mounted, with that; as it is described where they show
    nothing else."""
    known = (*robot_effects(question.robot, question.catalogue), *question.known)
    asked = any(effect.id == TILT for effect in question.candidates)
    if not asked or any(instance.effect.id == TILT for instance in known):
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
    """Return the observations with the speeds at which dry friction turns over.

    Friction that turns over more gradually than its law is taken for another law, or for a lag of
    the torque. Arms with elastic joints show it beside their motors' own motion, and torques that
    were low-passed show their filter: there the velocity's noise decides.
    """
    whole = all(o.torque_band == np.inf for part in observed for o in part)
    speeds = turning_speeds(recordings, robot) if whole and not robot.elastic else None
    first, second = (tuple(replace(o, turning=speeds) for o in part) for part in observed)
    return first, second


def _low_passed(parts: Sequence[Sequence[Recording]]) -> list[str]:
    """Return a note where torques hold not even noise at high frequencies; that on the first
    recording is enough."""
    found = [words for part in parts for recording in part for words in smoothed_torques(recording)]
    return [f"{words}: {LOW_PASSED}." for words in found[:1]]


def _is_seen(feature: Feature, layout: EquationSet) -> bool:
    """Whether an effect acts in a recorded equation.

    What brakes a motor is not seen by a joint torque sensor, and what acts in void rows alone is
    not seen at all.
    """
    if feature.choices.get("side") == "motor" and set(layout.sides) <= {"link", "drive"}:
        return False
    whole = bool(layout.live.all()) or feature.effect.regressor is not None
    return whole or bool(layout.transform[:, feature.rows].any())


def _usual(
    candidates: Sequence[Feature], equations: ArmEquations, seen: Sequence[Sequence[EffectInstance]]
) -> frozenset[Key]:
    """Return the friction of motors at joints for which none is stated or known: every real drive
    has some."""
    stated = {(i.effect.id, i.joint) for part in seen for i in part}
    found = set()
    for feature in candidates:
        plain = feature.effect.id in PLAIN and feature.choices.get("side") == "motor"
        if plain and (feature.effect.id, feature.joint) not in stated:
            found.add(feature.key)
    return frozenset(found)


def _candidates(
    question: Question,
    equations: ArmEquations,
    still: Sequence[str],
    layout: EquationSet,
    numbers: Sequence[Number],
    observed: Observation,
    seen: Sequence[Sequence[EffectInstance]],
) -> list[Feature]:
    """Return every effect at every place where motion and channels can show it.

    What numbers hold is a number that is far off, and what is known is there already.
    """
    held = {(p.cause.effect.id, p.joint) for p in numbers if p.cause is not None}
    wholly = {effect for effect, _ in held}
    known = {feature_of(i, equations).key for part in seen for i in part}
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
