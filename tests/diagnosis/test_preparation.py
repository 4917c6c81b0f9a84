"""From recordings and a question to data and candidates: which are given, left out, or cannot be
compared."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.common_equations import ONE_ENCODER, common_band
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.recording import Recording, Side
from tests.helpers.gap_recordings import MODEL, ROBOT, motions, record
from tests.helpers.nightly import nightly

FRICTION = EFFECTS["coulomb_friction"]
STRIBECK = "stribeck_friction:joint_3:torque=4,speed=0.05"


@cache
def pair() -> tuple[Recording, Recording]:
    first, second = (record(motion, seed=k) for k, motion in enumerate(motions()))
    return first, second


def question(**changes: object) -> Question:
    return replace(Question(ROBOT, effects=(FRICTION,)), **changes)  # type: ignore[arg-type]


def at_rest(side: Side, joint: int) -> Side:
    """The side with one joint that stays where it began."""
    changed = {name: values.copy() for name, values in side.channels().items()}
    changed["position"][:, joint] = changed["position"][0, joint]
    if "velocity" in changed:
        changed["velocity"][:, joint] = 0.0
    return replace(side, **changed)


def test_validation_recordings_judge_and_without_them_a_part_of_each() -> None:
    """What judges is another motion where it is given, and held back from the same one where
    not."""
    other = prepare([pair()[0]], [pair()[1]], question())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("elastic_arm.diagnosis.split.SHORTEST", 1.0)
        same = prepare([pair()[0]], [], question())
    assert (other.problem.held_back, other.independent_motion) == (False, True)
    assert same.problem.held_back
    assert same.problem.observed[1][0].duration < other.problem.observed[1][0].duration
    (span,) = same.judged.values()
    assert span == pytest.approx((4.0, 6.0), abs=0.01)


def test_known_effects_are_given_at_the_values_that_are_not_linear() -> None:
    """An effect of the user counts as part of the model; its searched parameter stands as
    stated."""
    prepared = prepare([pair()[0]], [pair()[1]], question(given=(parse(STRIBECK, ROBOT),)))
    (known,) = prepared.problem.given
    assert (known.effect.id, known.joint, known.parameters["speed"]) == (
        "stribeck_friction",
        "joint_3",
        0.05,
    )


def test_an_effect_of_the_arm_file_is_given_too() -> None:
    """What the description carries is stated, not searched for."""
    carrying = ROBOT.with_(
        effects=(parse("viscous_friction:joint_1:coefficient=3", ROBOT).to_dict(),)
    )
    prepared = prepare([pair()[0]], [pair()[1]], question(robot=carrying))
    assert [known.effect.id for known in prepared.problem.stated] == ["viscous_friction"]


def test_a_joint_at_rest_has_no_candidate_that_needs_its_motion() -> None:
    """Friction of a joint that does not move is not looked for, and a note states it."""
    still = [
        replace(one, link=at_rest(one.link, 2), motor=at_rest(one.motor, 2))
        for one in pair()
        if one.link is not None and one.motor is not None
    ]
    prepared = prepare([still[0]], [still[1]], question())
    places = {feature.joint for feature in prepared.problem.candidates}
    assert places == {"joint_1", "joint_2"}
    assert any("joint_3" in note for note in prepared.notes)


def test_recordings_of_unequal_channels_are_refused() -> None:
    """Residuals of other equations cannot be judged by the same hypothesis."""
    whole = pair()[1]
    with pytest.raises(DiagnosisError, match="same channels"):
        prepare([pair()[0]], [replace(whole, motor=None)], question())


@pytest.mark.parametrize("step", [3, *nightly([2])])
def test_recordings_of_unequal_rates_go_together(step: int) -> None:
    """The band is one for all; at half and at a third of its rate a recording tells the same size
    of friction."""
    effect = "coulomb_friction:joint_2:torque=4.0,side=motor"
    first, second, judge = (record(motions()[k > 0], effect, seed=k) for k in range(3))
    slower = {name: side.at(slice(None, None, step)) for name, side in second.sides().items()}
    thinned = replace(second, **slower)  # type: ignore[arg-type]
    found = diagnose([first, thinned], question(), [judge])
    (cause,) = found.causes
    friction = cause.parameters["torque"]
    assert (cause.effect, cause.joint) == ("coulomb_friction", "joint_2") and not found.changes
    assert abs(friction.value - 4.0) < 4.0 * friction.std < 0.1 and found.verdict == "explained"


def test_a_recording_whose_rate_changes_is_taken_in_parts_of_one_rate() -> None:
    """Half of it at half the rate is no event, and tells the same friction."""
    effect = "coulomb_friction:joint_2:torque=4.0,side=motor"
    halved = []
    for k, motion in enumerate(motions()):
        whole = record(motion, effect, seed=k, rate=1000.0)
        kept = np.flatnonzero((at := np.arange(len(whole.link or ()))) * (at % 2) < 3000)
        sides = {name: side.at(kept) for name, side in whole.sides().items()}
        halved.append(replace(whole, **sides, source=f"run {k}"))  # type: ignore[arg-type]
    found = diagnose(halved[:1], question(), halved[1:])
    assert found.verdict == "explained" and not found.events and not found.changes
    assert found.identify == ("run 0, 0 to 3 s", "run 0, 3 to 6 s")
    assert any("1000 Hz from 0.0 s, 500 Hz from 3.0 s" in note for note in found.notes)
    (cause,) = found.causes
    assert abs(cause.parameters["torque"].value - 4.0) < 3.0 * cause.parameters["torque"].std < 0.1
    residuals = found.residual_sides("run 1", 0)["/residuals/motor/after"]
    assert residuals.stamp_ns[0] < 0.3e9 and residuals.stamp_ns[-1] > 5.7e9


def test_one_encoder_narrows_the_band() -> None:
    """Above it the deflection that a single encoder does not show changes the motion."""
    both = EquationSet.direct(frozenset({"q", "theta", "tau_m", "tau_J"}), MODEL.n)
    single = EquationSet.direct(frozenset({"q", "tau_m"}), MODEL.n)
    wide, narrow = (common_band(one, MODEL, 1000.0) for one in (both, single))
    assert np.isclose(narrow.cutoff, ONE_ENCODER) and wide.cutoff > narrow.cutoff
    rigid = build_model(
        ROBOT.with_(joints=tuple(replace(j, transmission=None) for j in ROBOT.joints)), "mod1"
    )
    assert common_band(single, rigid, 1000.0).cutoff == wide.cutoff


def test_friction_of_motors_that_were_not_recorded_is_left_out_with_a_note_on_what_is_known() -> (
    None
):
    """With link encoders and joint torque sensors alone, friction of a motor is in no equation;
    that of a link is."""
    alone = [replace(recording, motor=None) for recording in pair()]
    known = tuple(
        parse(f"coulomb_friction:joint_{k}:torque=3,side={side}", ROBOT)
        for k, side in ((1, "motor"), (2, "link"))
    )
    prepared = prepare([alone[0]], [alone[1]], question(given=known))
    assert [instance.joint for instance in prepared.problem.given] == ["joint_2"]
    assert {
        feature.choices["side"]
        for feature in prepared.problem.candidates
        if "side" in feature.choices
    } == {"link"}
    assert any(
        "coulomb_friction on joint_1" in note and "no motor torque" in note
        for note in prepared.notes
    )


def test_velocities_that_are_differences_of_positions_are_left_out_with_one_note() -> None:
    """A driver's differences of its angles measure nothing; the note names both sides of such a
    recording."""
    recordings = []
    for recording in pair():
        sides = {}
        for name, side in (("link", recording.link), ("motor", recording.motor)):
            seconds = np.diff(side.stamp_ns)[:, None] * 1e-9
            difference = np.diff(side.position, axis=0) / seconds
            sides[name] = replace(side, velocity=np.concatenate([difference[:1], difference]))
        recordings.append(replace(recording, **sides))
    prepared = prepare([recordings[0]], [recordings[1]], question())
    notes = [note for note in prepared.notes if "velocities" in note]
    assert len(notes) == len({recording.source for recording in recordings})
    assert all(
        "link and motor velocities are differences of the positions and are not used" in note
        for note in notes
    )
