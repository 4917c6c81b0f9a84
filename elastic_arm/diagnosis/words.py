"""Effects, sizes, probabilities and results in words, for screen, report and notes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from elastic_arm.effects.effect import MODELS, SensorEffect
from elastic_arm.effects.library.friction import PLAIN
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.priors import TRUST
from elastic_arm.formatting import JointUnits, rounded

if TYPE_CHECKING:
    from elastic_arm.diagnosis.estimates import ParameterEstimate
    from elastic_arm.diagnosis.events import Event
    from elastic_arm.diagnosis.history import Course
    from elastic_arm.diagnosis.prediction import Prediction
    from elastic_arm.diagnosis.result import (
        Alternative,
        Cause,
        Change,
        Diagnosis,
        UnexplainedResidual,
    )
    from elastic_arm.effects import EffectInstance
    from elastic_arm.equations.formless import GeneralLaw

DOUBT = 0.001  # that stays with every confidence and every alternative
OFF = 2.0  # of its own standard deviations, beyond which a scale is said to be off
WORTH_A_LINE = 0.05  # probability of an alternative that has a line of its own
NAMED = 4  # alternatives that a line names

LOW_PASSED = (
    "residuals are compared below that frequency, as the torques of the motion are"
    " missing above, with an assumed noise of 0.5 % of the torque, as the recording"
    " contains none"
)
SWITCHED_ON = (
    "Record next: the same motion with the drives switched on throughout. Alternatively, cut this"
    " part out of the recording."
)
NOT_DETERMINED = "not determined"  # of a parameter that no recording shows
REPEATED_MOTION = (
    "The validation data repeat the motion of the fit and are therefore not independent."
)


def effect_at(effect: str, joint: str | None) -> str:
    """Return an effect with its place."""
    return f"{effect} on {joint or 'the whole arm'}"


def estimates_text(parameters: Mapping[str, ParameterEstimate]) -> str:
    """Return parameters with standard deviations and units as text; what is whole or given has no
    deviation."""
    named = zip(parameters, sizes_of(parameters), strict=True)
    return ", ".join(f"{name} {size}" for name, size in named)


def sizes_of(parameters: Mapping[str, ParameterEstimate]) -> list[str]:
    """Return the sizes of parameters with standard deviations and units, without their names."""
    return [size_text(e.value, e.std, e.unit) for e in parameters.values()]


def instance_text(instance: EffectInstance, units: JointUnits) -> str:
    """Return all that an effect was given, with the units at its joint."""
    given = instance.parameters
    joint = instance.joint
    numbers = [
        f"{p.name} {size_text(given[p.name], 0.0, units.at(joint, p.unit))}"
        for p in instance.effect.parameters
    ]
    choices = [f"{c.name} {chosen(given[c.name])}" for c in instance.effect.choices]
    return ", ".join([*numbers, *choices])


def percent(share: float | None) -> str:
    """Return a share of the gap as text; none is zero."""
    return f"{round(100 * (share or 0.0), 1) + 0.0:.1f} %"  # + 0.0: no "-0.0"


def probability_text(probability: float) -> str:
    """Return a probability as text that never claims certainty."""
    if not DOUBT <= probability <= 1.0 - DOUBT:
        return f"< {percent(DOUBT)}" if probability < DOUBT else f"> {percent(1.0 - DOUBT)}"
    return f"{100 * probability:.{0 if 0.01 <= probability <= 0.99 else 1}f} %"


def log_likelihood_text(value: float) -> str:
    """Return a log-likelihood with two digits; differences below a tenth are none."""
    if value < 0.1:
        return "0"
    if value < 100.0:
        return f"{value:.2g}"
    two_digits = float(f"{value:.2g}")
    return f"{two_digits:,.0f}".replace(",", "\u202f")


def listed(names: Sequence[str], more: int = 0) -> str:
    """Return names as a list in a sentence, the last one being how many more there are."""
    names = [*names, f"{more} more"] if more > 0 else names
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def chosen(value: object) -> str:
    """Return what was chosen of an effect, such as its channels."""
    return " and ".join(value) if isinstance(value, tuple) else str(value)


def size_text(value: Any, std: Any, unit: str = "1") -> str:
    """Return a number, or a vector of them, with its unit and the digits that its standard
    deviation warrants.

    std: of each; zero where it is given, None where nothing determines it.
    """
    vector = isinstance(value, list | tuple)
    values = list(value) if vector else [value]
    stds = list(std) if isinstance(std, list | tuple) else [std] * len(values)
    if all(s is None for s in stds):
        return NOT_DETERMINED
    parts = zip(*(_pair(v, s) for v, s in zip(values, stds, strict=True)), strict=True)
    number, deviation = (f"({', '.join(part)})" if vector else part[0] for part in parts)
    size = number if all(s == 0.0 for s in stds) else f"{number} ± {deviation}"
    return size if unit == "1" else f"{size} {unit}"


def _pair(value: float, std: float | None) -> tuple[str, str]:
    return (NOT_DETERMINED, "–") if std is None else rounded(value, std)


def merged_notes(notes: Sequence[str]) -> list[str]:
    """Return notes, those that several recordings or joints share as one, behind all their
    names."""
    names: dict[str, list[str]] = {}
    for note in notes:
        name, colon, rest = note.partition(": ")
        of_a_name = bool(colon) and " " not in name
        names.setdefault(rest if of_a_name else note, []).append(name if of_a_name else "")
    return [_behind([*dict.fromkeys(of)], rest) for rest, of in names.items()]


def _behind(names: Sequence[str], note: str) -> str:
    """Return a note behind the names of what it is about, if it has names."""
    named = [name for name in names if name]
    return f"{listed(named)}: {note}" if named else note


def standing_note(joint: str) -> str:
    """Return the note on a joint that does not move."""
    return f"{joint} does not move: effects that need its motion cannot be diagnosed."


def event_notes(events: Sequence[Event]) -> list[str]:
    """Return a note for each recording with events."""
    found = ignored_sentences(events)
    events = [event for event in events if not event.ignored]
    for recording in dict.fromkeys(event.recording for event in events):
        each = [
            f"{e.joint} ({e.side} side) from {e.begin:.1f} to {e.end:.1f} s, residual of"
            f" {e.rmse:.2g} Nm RMS in this interval"
            for e in events
            if e.recording == recording
        ]
        what = (
            "an event, such as a contact, a payload picked up or a brake, contradicts the rest of"
            " the recording and is excluded"
        )
        found.append(f"{recording or 'the recording'}: {what}: {'; '.join(each)}.")
    return found


def ignored_sentences(events: Sequence[Event]) -> list[str]:
    """Return a sentence for each stretch in which no joint followed its commands."""
    stretches = dict.fromkeys((e.recording, e.begin, e.end) for e in events if e.ignored)
    return [
        f"{recording or 'the recording'}: no joint follows its commands from {begin:.1f} to"
        f" {end:.1f} s, as with the torque switched off; this part is excluded."
        for recording, begin, end in stretches
    ]


def bare_note(joints: Sequence[str]) -> str:
    """Return the note on joints without a torque."""
    words = (
        "no torque was recorded, so there is no equation: effects visible only in these"
        " torques cannot be diagnosed"
    )
    return f"{', '.join(joints)}: {words}."


def unseen_notes(instances: Sequence[EffectInstance], bare: Sequence[str]) -> list[str]:
    """Return notes on known effects that act in no torque that was recorded.

    instances: those in no equation, as of the motor side where that was not recorded.
    """
    places: dict[str, dict[str, list[str]]] = {}
    for instance in instances:
        of_motor = (
            "motor torque"
            if set(instance.sides) == {"motor"}
            else "channel in which they are visible"
        )
        missing = "torque of the joint" if instance.joint in bare else of_motor
        places.setdefault(missing, {}).setdefault(instance.effect.id, []).append(
            str(instance.joint)
        )
    found = []
    for missing, joints in places.items():
        names = "; ".join(effect_at(effect, ", ".join(at)) for effect, at in joints.items())
        found.append(
            f"Known effects that are not visible because no {missing} was recorded: {names}. They"
            " keep their stated sizes."
        )
    return found


REJECTED = (
    "The closed-loop simulation rejects this correction: neither robot.yaml nor the corrected file"
    " contains it."
)
UNFINISHED = (
    "The search ended early with the best answer so far. Exchanges of several causes and"
    " laws outside the catalogue may not have been tried."
)


def law_note(joint: str, law: GeneralLaw) -> str:
    """Return the note on a nonparametric law."""
    return (
        f"A torque of {joint} ({law.side}) depends on {law.argument}, and no effect of the"
        " catalogue has this form."
    )


def unnamed_note(joint: str, effect: str) -> str:
    """Return the note on a number that is far off and has no cause in the catalogue."""
    return (
        f"A parameter of {joint} is far from its described value: the deviation acts as {effect},"
        " which is not in the catalogue of this diagnosis."
    )


def shape_note(joint: str, side: str) -> str:
    """Return the note on a residual that keeps more power than its sensors have as noise."""
    return (
        f"The remaining residual at {joint} ({side} side) exceeds the noise of its sensors,"
        " and no effect explains it."
    )


def ringing_notes(found: Mapping[str, float], made: Collection[str]) -> list[str]:
    """Return notes on joints that are described as rigid and have a resonance.

    found: its frequency, Hz, by joint; made: joints whose torques were computed from commands. They
    swing on the gain of their controller, which is no property of the joint.
    """
    return [
        f"{joint} has a resonance near {frequency:.2g} Hz but is described as rigid: it may be"
        " elastic."
        for joint, frequency in found.items()
        if joint not in made
    ]


def mounted_note(joint: str, mass: float, position: Sequence[float]) -> str:
    """Return that a body on the last link, kg and m in the link's frame, changes its weight as much
    as a wrong link does."""
    place = ", ".join(f"{value:.3f}" for value in position)
    return (
        f"{joint}: a body of {mass:.3g} kg at ({place}) m in the frame of the last link, such as a"
        " tool or a workpiece, changes the weight as the wrong link does."
    )


def no_separation(effect: str, other: str) -> str:
    """Return that no motion is known that separates two effects."""
    return f"a motion in which {effect} and {other} act differently"


# By what a residual follows: the motion of its joint that shows the law.
SHOWN_BY = {
    "always": "standing still in several poses, then slowly through its range",
    "velocity_reversal": "many slow reversals, at several places of its range",
    "low_speed": "constant speeds, from creeping to a tenth of its limit, both ways",
    "high_speed": "constant speeds up to its limit, both ways",
    "acceleration": "one path at two speeds, with and without a known weight at the flange",
    "load": "one path with and without a known weight at the flange",
    "position": "slowly through its whole range and back, twice",
    "rotor_angle": "slowly at a constant speed, over several turns of its motor",
    "wave_generator_angle": "slowly at a constant speed, over several turns of its wave generator",
    "frequency": "short strokes at the highest sample rate that your logger has",
    "start": "several starts after a rest",
    "drift": "one motion over and over for ten minutes, from cold",
    "event": "the same motion again, with nobody and nothing near the arm",
}


def motion_that_shows(regime: str) -> str:
    """Return the motion of a joint in which a residual of a regime shows its law."""
    return SHOWN_BY.get(regime, SHOWN_BY["always"])


# When a residual is large, as the predicate of a sentence.
REGIME_WORDS = {
    "always": "is equally large in every motion",
    "velocity_reversal": "changes when the joint reverses",
    "low_speed": "is largest at low speed",
    "high_speed": "increases with speed",
    "acceleration": "follows the acceleration",
    "load": "depends on the load of the joint",
    "position": "depends on the position of the joint",
    "rotor_angle": "repeats with each turn of the rotor",
    "wave_generator_angle": "repeats with each turn of the wave generator",
    "frequency": "oscillates at one frequency",
    "start": "is largest at the start of the recording",
    "drift": "drifts over time",
    "event": "occurs once, in a short interval",
}


def left_text(place: UnexplainedResidual, units: JointUnits) -> str:
    """Return the size of an open residual; that of an event is of its own interval."""
    size = f"{place.rmse:.2g} {units.at(place.joint, 'Nm')}"
    return f"{size} RMS in the interval of the event" if place.regime == "event" else size


def regime_text(regime: str) -> str:
    """Return when a residual is large, as the predicate of a sentence."""
    return REGIME_WORDS.get(regime, f"depends on {regime.replace('_', ' ')}")


def unknown_sentences(found: Diagnosis) -> list[str]:
    """Return the reason of an `unknown`, the share of the gap that the causes explain, and the next
    recording; nothing for another verdict."""
    if found.verdict != "unknown" or not found.unexplained:
        return []
    if ignored := ignored_sentences(found.events):
        return [
            f"The verdict is unknown because of {ignored[0]}",
            SWITCHED_ON,
        ]
    first, *others = found.unexplained
    place = (first.joint, first.side)
    size = left_text(first, found.units)
    noise = found.noise.get(place)
    before = found.before.rmse.get(place)
    whole = " over the whole recording" if first.regime == "event" else ""
    beside = [
        *([f"noise {noise:.2g}"] if noise else []),
        *([f"{before:.2g} without causes{whole}"] if before and found.causes else []),
    ]
    sizes = f" ({', '.join(beside)})" if beside else ""
    left = (
        f"The verdict is unknown because of {size}{sizes} at {first.joint},"
        f" {first.side} side: no cause explains this residual, which {regime_text(first.regime)}"
    )
    joints = [*dict.fromkeys(place.joint for place in others if place.joint != first.joint)]
    rest = listed(joints[:NAMED], len(joints) - NAMED) if joints else ""
    less = f"; smaller unexplained residuals remain at {rest}" if rest else ""
    sentences = [f"{left}{less}."]
    hold = bool(found.causes) and not any(cause.rejected for cause in found.causes)
    if hold and found.shrink is not None and found.shrink > 0.0:
        sentences.append(
            f"The causes explain {percent(found.shrink)} of the gap. If {size} is negligible for"
            " your application, they are the answer."
        )
    sentences.append(
        f"Record next: {first.joint} alone, {motion_that_shows(first.regime)}. See docs/unknown.md."
    )
    return sentences


def scale_sentence(found: Diagnosis) -> str:
    """Return what anchors the scale of torques that were made of commands or of the duty."""
    known = ", ".join(
        f"{100 * e.std / abs(e.value):.2g} % at {joint}" for joint, e in found.torque_scale.items()
    )
    ways = [
        ("the recorded duty (pwm) with the described electrics", bool(found.of_duty)),
        (
            "commands and positions with the described controllers",
            len(found.of_duty) < len(found.made),
        ),
    ]
    made = " or ".join(way for way, used in ways if used)
    whole = len(found.made) == len(found.joints)
    lacking = "no torque" if whole else f"no torque of {listed(found.made)}"
    return (
        f"{lacking} was recorded; torques are computed from {made}. The standard deviation of"
        f" their scale is {known}; masses and friction inherit this uncertainty."
        f"{_disagreement(found)}"
    )


def _gain_sentences(found: Diagnosis) -> list[str]:
    """Return which drives make more or less torque than described."""
    off = [
        f"{' ± '.join(rounded(e.value, e.std))} times the described torque at {joint}"
        for joint, e in found.torque_scale.items()
        if abs(e.value - 1.0) > OFF * e.std
    ]
    kp = "" if len(found.of_duty) == len(found.made) else "kp, "
    why = f"{kp}the supply voltage or the torque constant differs"
    return [f"The drives make {listed(off)}: {why}."] if off else []


def _disagreement(found: Diagnosis) -> str:
    """Return where torques and simulated motion give scales that disagree, and what follows."""
    apart = []
    for joint, both in found.compared_scales.items():
        torques = both.of_torques
        motion = both.in_closed_loop
        if abs(torques.value - motion.value) > OFF * np.hypot(torques.std, motion.std):
            sizes = [" ± ".join(rounded(one.value, one.std)) for one in (torques, motion)]
            apart.append(f"{' and '.join(sizes)} at {joint}")
    if not apart:
        return ""
    return (
        " The residuals of the torques and the simulated motion disagree about the scale:"
        f" {'; '.join(apart)}. The written arm contains the second value. Something that the model"
        " lacks acts like a scale there: the difference, not the standard deviation, is the"
        " uncertainty of the scale, and of the masses and friction that inherit it."
    )


def closed_loop_sentences(found: Diagnosis) -> list[str]:
    """Return which joints of a commanded arm move worse with what was found, and what is not
    written; the worst first.

    Empty where none does.
    """
    refused = {joint: one for joint, one in found.closed_loop.items() if one.refused is not None}
    if not refused:
        return []
    ordered = sorted(
        refused, key=lambda joint: -(refused[joint].refused or 0.0) / refused[joint].described
    )
    moved = []
    for joint in ordered:
        one = refused[joint]
        worse = one.refused or 0.0
        sizes = (
            f"to {_short(worse, one.unit)}"
            if np.isfinite(worse)
            else "until the simulation diverges"
        )
        moved.append(f"{joint} {sizes} ({_short(one.described, one.unit)} with the description)")
    if len(found.taken_back) >= len(found.joints):
        written = "No correction by a cause is written"
        if any(one.corrected < one.described for one in found.closed_loop.values()):
            written += "; the file has the parameters that were refined on the fitted motions"
    else:
        written = f"The correction of {listed(found.taken_back)} is not written"
    return [
        (
            "With all corrections, the errors under the recorded commands increase:"
            f" {listed(moved)}. {written}."
        )
    ]


def closed_loop_sentence(found: Diagnosis) -> str:
    """Return how far a commanded arm errs at its worst joint, as described and as written; empty
    where not known."""
    errors = found.closed_loop
    if not errors:
        return ""
    joint = max(errors, key=lambda name: errors[name].described)
    one = errors[joint]
    described = f"the description has an error of {_short(one.described, one.unit)} at {joint}"
    written = f"the written correction {_short(one.corrected, one.unit)}"
    alone = ""
    if one.alone is not None and one.alone != one.corrected:
        alone = (
            f"; the corrected MJCF alone, without the laws that only robot.yaml states,"
            f" {_short(one.alone, one.unit)}"
        )
    return f"Under the recorded commands {described}, {written}{alone}."


def summary(found: Diagnosis) -> list[str]:
    """Return what was found as sentences: verdict, each cause, how far the model is off without and
    with them."""
    inertias = [
        f"{_short(one.value, one.unit.replace('^2', '²'))} at {one.joint}"
        for one in found.imperfections
        if one.what == "rotor_inertia" and one.unit != "1" and one.value > 2.0 * one.std
    ]
    drives = drive_friction(found.causes)
    causes = [cause_sentence(one, found.model) for one in found.causes if one not in drives]
    if drives:
        causes.append(_friction_sentence(drives))
    worse = closed_loop_sentences(found)
    first, *more = [
        *ignored_sentences(found.events),
        *worse,
        *causes,
        _verdict_sentence(found, "the motor inertia" if inertias else ""),
    ]
    more += (
        [f"Motor inertia, which the description does not state: {listed(inertias)}."]
        if inertias
        else []
    )
    more += _gain_sentences(found)
    more += [closed] if (closed := closed_loop_sentence(found)) else []
    return [f"{found.verdict}: {first}", *more]


def drive_friction(causes: Sequence[Cause]) -> list[Cause]:
    """Return the causes that are friction of drives and that the description does not state.

    Every drive has friction, so several of them are one statement about the description.
    """
    found = [c for c in causes if c.effect in PLAIN and c.stated is None and not c.rejected]
    return found if len(found) > 1 else []


def specific_first(causes: Sequence[Cause]) -> list[Cause]:
    """Return causes in their order, but the friction of drives last."""
    drives = drive_friction(causes)
    return [*(cause for cause in causes if cause not in drives), *drives]


def _friction_sentence(drives: Sequence[Cause]) -> str:
    """Return the friction of drives in words, as ranges over the joints."""
    ranges = []
    for effect in reversed(PLAIN):
        sizes = [one for cause in drives if cause.effect == effect for one in _sizes_in(cause)]
        for unit in dict.fromkeys(unit for _, unit in sizes):
            values = sorted(value for value, own in sizes if own == unit)
            ends = dict.fromkeys(_digits(end) for end in (values[0], values[-1]))
            ranges.append(f"{effect.replace('_', ' ')} of {' to '.join(ends)} {unit}")
    joints = list(dict.fromkeys(cause.joint or "the arm" for cause in drives))
    subject = f"{listed(joints)} {'has' if len(joints) == 1 else 'have'}"
    return f"{subject} friction that the description does not state: {listed(ranges)}."


def _sizes_in(cause: Cause) -> list[tuple[float, str]]:
    """Return the sizes of a cause with their units."""
    return [(float(one.value), one.unit) for one in cause.parameters.values()]


def _verdict_sentence(found: Diagnosis, beside: str) -> str:
    if found.verdict == "none":
        gaps = any(share is not None for share in found.shrink_by_place.values())
        model = f"model with {beside}" if beside else "model"
        ordinary = _ordinary_sentence(found) if gaps else ""
        return f"recording and {model} agree within the noise of the sensors{ordinary}."
    if not found.causes:
        places = ", ".join(f"{p.joint} ({p.side} side)" for p in found.unexplained[:3])
        return (
            "recording and model differ, and no effect of the catalogue explains the difference;"
            f" it is largest at {places}."
        )
    causes = "it" if len(found.causes) == 1 else f"these {len(found.causes)} causes"
    motion = "on another motion" if found.independent_motion else "on a repetition of the motion"
    joint, side = place = _worst_place(found)
    before = found.before.rmse[place]
    after = found.after.rmse[place]
    noise = found.noise.get(place)
    unit = found.units.at(joint, "Nm")
    sizes = f"{before:.3g}", f"{after:.3g}"
    change = f"{'falls' if after < before else 'rises'} from {sizes[0]} to {sizes[1]}"
    if sizes[0] == sizes[1]:
        change = f"stays at {sizes[0]}"
    where = f"at {joint} ({side} side{f', noise {noise:.3g} {unit}' if noise else ''})"
    added = f"{causes} and {beside}" if beside else causes
    share = percent(found.shrink)
    larger = share.startswith("-")
    gone = "the correction increases the total gap" if larger else f"the gap shrinks by {share}"
    sentence = (
        f"With {added}, the model's error {motion} {change} {unit}"
        f" {where}, where the description exceeds the noise most; {gone}"
    )
    if not found.unexplained:
        return f"{sentence}."
    if all(one.regime == "event" for one in found.unexplained):
        return f"{sentence}. This leaves out the intervals that contradict the rest."
    return f"{sentence}, and the remaining gap has another cause."


def _worst_place(found: Diagnosis) -> Place:
    """Return joint and side at which the description exceeds the noise most."""
    return max(
        found.before.rmse, key=lambda p: found.before.rmse[p] / (found.noise.get(p) or np.inf)
    )


def _ordinary_sentence(found: Diagnosis) -> str:
    """Return what ordinary deviations of the numbers do to the gap of the description."""
    joint, side = place = _worst_place(found)
    unit = found.units.at(joint, "Nm")
    return (
        ", with only ordinary deviations of the parameters of arm and sensors. At"
        f" {joint} ({side} side), the model's error is {found.before.rmse[place]:.3g} {unit} as"
        f" described and {found.after.rmse[place]:.3g} {unit} with these deviations"
    )


def cause_name(cause: Cause) -> str:
    """Return what a table calls a cause; one that the closed loop rejects is marked."""
    return f"{cause.effect} (rejected)" if cause.rejected else cause.effect


def cause_sentence(cause: Cause, model: str) -> str:
    """Return in plain words what the arm or its recording has that the model lacks, and what it may
    be instead."""
    effect = cause.instance.effect
    values = cause.instance.parameters
    told = _told(cause)
    texts = {
        n: (size_text(e.value, e.std, e.unit), _short(e.value, e.unit))
        for n, e in cause.parameters.items()
    }
    sizes = {name: both[told[name]] for name, both in texts.items()}
    given = {c.name: chosen(values[c.name]).replace("_", " ") for c in effect.choices}
    given |= {p.name: _short(values[p.name], p.unit) for p in effect.parameters}
    generic = f"has {effect.id.replace('_', ' ')}"
    if sizes:
        generic += f" of {listed([f'{n} {size}' for n, size in sizes.items()])}"
    what = effect.plain.format(**{**given, **sizes}) if effect.plain else generic
    if cause.stated is not None:
        what += f", where the description states {_stated_text(cause)}"
    elif not effect.parameters:
        what += f", which {model} lacks (it is part of {_richer(cause)})"
    elif not isinstance(effect, SensorEffect) and effect.parameters[0].neutral != 1.0:
        what += ", which the model lacks"
    if told and not any(told.values()):
        what += " (the recording shows its presence but not its size)"
    other = max(cause.alternatives, key=lambda a: a.confidence, default=None)
    if other is not None and other.confidence >= WORTH_A_LINE:
        what += (
            f" (or {effect_at(other.effect, other.joint)}: the recording does not separate them)"
        )
    subject = (cause.joint or "the arm").replace("_", " ")
    if cause.rejected:
        return f"According to the torques alone, {subject} {what}. {REJECTED}"
    return f"{subject[:1].upper()}{subject[1:]} {what}."


def _told(cause: Cause) -> dict[str, bool]:
    """Return whether each size of a cause is further from none, or from what is stated, than its
    own deviation."""
    none = {p.name: p.neutral or 0.0 for p in cause.instance.effect.parameters} | dict(
        cause.stated or {}
    )
    found = {
        n: (np.array(e.value, float), np.array(e.std, float)) for n, e in cause.parameters.items()
    }
    return {
        n: bool(np.any(np.abs(value - none.get(n, 0.0)) > std)) for n, (value, std) in found.items()
    }


def _short(value: Any, unit: str) -> str:
    """Return a number, or several, in words: three digits at most, and no deviation; small ones
    with a prefix."""
    values = list(value) if isinstance(value, list | tuple) else [value]
    prefix, factor = _prefix(max(map(abs, values))) if unit in ("rad", "m", "s") else ("", 1.0)
    numbers = [_digits(factor * v) for v in values]
    number = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
    return number if unit == "1" else f"{number} {prefix}{unit}"


def _digits(value: float) -> str:
    """Return three digits, and more where they would make one of what is not."""
    return next((text for n in range(3, 9) if (text := f"{value:.{n}g}") != "1"), "1")


def _richer(cause: Cause) -> str:
    """Return the simplest model that has a cause."""
    return next(model for model in MODELS if model not in cause.instance.effect.lacked_by)


def _stated_text(cause: Cause) -> str:
    stated = [
        (name, value) for name, value in (cause.stated or {}).items() if name in cause.parameters
    ]
    return ", ".join(
        f"{name} {size_text(value, 0.0, cause.parameters[name].unit)}" for name, value in stated
    )


def trust_text(trust: Mapping[str, float]) -> str:
    """Return how far a description could be trusted, most probable first; what is all but excluded
    is left out."""
    likely = sorted((item for item in trust.items() if item[1] >= DOUBT), key=lambda item: -item[1])
    return "; ".join(
        f"{name}, its numbers {TRUST[name].means} ({probability_text(p)})" for name, p in likely
    )


def cause_size(cause: Cause, between: str = ", ") -> str:
    """Return a cause's parameters, and the channels it acts in, as text; those that were stated as
    "from → to"."""
    several = [choice.name for choice in cause.instance.effect.choices if choice.several]
    sizes = []
    for name, e in cause.parameters.items():
        stated = (cause.stated or {}).get(name)
        first = f"{stated:.4g} → " if isinstance(stated, float) else ""
        sizes.append(f"{name} {first}{size_text(e.value, e.std, e.unit)}")
    parts = [*sizes, *(chosen(cause.instance.parameters[name]) for name in several)]
    return between.join(part for part in parts if part) or "no parameters"


def sides_text(cause: Cause) -> str:
    """Return the sides on which a cause shows; those of one drive that the recording does not
    separate by "or"."""
    friction = any(choice.name == "side" for choice in cause.instance.effect.choices)
    return (" or " if friction else ", ").join(cause.sides)


def alone_text(cause: Cause) -> str:
    """Return by how much a cause shrinks the gap alone; one that helps only with the others has no
    number."""
    return "only with others" if percent(cause.shrink).startswith("-") else percent(cause.shrink)


def listed_alternatives(cause: Cause) -> tuple[list[Alternative], str]:
    """Return the alternatives that are worth a line each, and the others summed up in words, empty
    for none."""
    likely = [other for other in cause.alternatives if other.confidence >= WORTH_A_LINE]
    faint = [other for other in cause.alternatives if other.confidence < WORTH_A_LINE]
    if len(faint) < 2:
        return [*likely, *faint], ""
    names = listed(
        [effect_at(other.effect, other.joint) for other in faint[:NAMED]], len(faint) - NAMED
    )
    return (
        likely,
        f"{names} ({probability_text(sum(other.confidence for other in faint))} together)",
    )


def gap_at(found: Diagnosis, joint: str, side: str) -> str:
    """Return the size of a residual as described and as corrected, and the share of its own gap
    that is gone.

    joint, side: which residual; "–" where there is no such equation.
    """
    place = (joint, side)
    if place not in found.before.rmse:
        return "–"
    sizes = f"{found.before.rmse[place]:.3g} → {found.after.rmse[place]:.3g}"
    return f"{sizes} ({share_at(found, joint, side)})"


def share_at(found: Diagnosis, joint: str, side: str) -> str:
    """Return the share of a residual's own gap that is gone, as text."""
    share = found.shrink_by_place.get((joint, side))
    if share is None:
        return "no significant gap"
    return "larger" if percent(share).startswith("-") else f"{percent(share)} removed"


def prediction_sentence(found: Diagnosis, prediction: Prediction) -> str:
    """Return in a sentence how far the prediction error of the worst angle falls, or why that is
    not known."""
    before = prediction.before or {}
    after = prediction.after or {}
    if prediction.reason:
        return f"{prediction.reason[0].upper()}{prediction.reason[1:]}."
    joint, side = max(before, key=lambda place: before[place][-1])
    unit = found.units.at(joint, "rad")
    errors = [_short(size[joint, side][-1], unit) for size in (before, after)]
    horizon = f"{1e3 * prediction.horizons[-1]:g} ms"
    sentence = (
        f"Driven by the measured torque, the model has a largest angle error of {errors[0]}"
        f" after {horizon}"
    )
    added = f"; with the causes, {errors[1]}" if any(c.acts for c in found.causes) else ""
    return f"{sentence} ({joint}, {side}){added}."


def _prefix(value: float) -> tuple[str, float]:
    """Return the prefix that suits a size, and by what numbers are multiplied for it."""
    return next(
        ((p, f) for p, f in (("", 1.0), ("m", 1e3)) if value * f >= 1.0 or value == 0.0), ("µ", 1e6)
    )


def change_text(change: Change) -> str:
    """Return in a sentence how a size differs between recordings."""
    what = change.effect.replace("_", " ")
    sizes = "; ".join(
        f"{size_text(value, std, change.unit)} in {recording}"
        for recording, value, std in change.values
    )
    return (
        f"{what} of {change.joint or 'the whole arm'} changed: {sizes}"
        f" ({probability_text(change.confidence)})"
    )


def step_text(one: Course, recordings: Sequence[str]) -> str:
    """Return in a sentence what changed, when and by how much."""
    step = one.step
    sized = one.sized
    assert step is not None
    way = "rose" if step.after_value > step.before_value else "fell"
    before = size_text(step.before_value, step.before_std, sized.unit)
    after = size_text(step.after_value, step.after_std, sized.unit)
    what = f"{sized.effect.replace('_', ' ')} of {sized.joint or 'the whole arm'}"
    when = f"between {recordings[step.after]} and {recordings[step.until]}"
    return (
        f"{what} {way} from {before} to {after} {when} (probability"
        f" {probability_text(step.probability)}); probability of any change:"
        f" {probability_text(one.changed)}"
    )
