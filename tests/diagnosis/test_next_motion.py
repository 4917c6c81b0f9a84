"""What next: the proposed motion tells apart what the recording could not, within limits, and is a
file to run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.next_motion import DECISIVE, RATE, _ambiguous_pairs, propose
from elastic_arm.diagnosis.predicted_experiment import ExperimentConditions, PredictedExperiment
from elastic_arm.diagnosis.result import SEPARATING, Diagnosis
from elastic_arm.evidence.terms.change import change_of
from elastic_arm.excitation import load_trajectory
from tests.helpers.gap_recordings import LIMITS, MODEL, ROBOT, motions, record
from tests.helpers.shared_diagnoses import PLAY, Commanded

pytestmark = pytest.mark.slow(22)


@pytest.fixture
def doubtful(commanded: Commanded) -> Diagnosis:
    """A diagnosis that cannot tell play from an offset, with the motion that would."""
    return commanded.found


def names(found: Diagnosis) -> set[str]:
    cause = found.causes[0]
    return {cause.effect, *(a.effect for a in cause.alternatives if a.confidence > 0.2)}


def test_what_the_recording_cannot_tell_apart_gets_a_motion_that_does(doubtful: Diagnosis) -> None:
    """The result holds both explanations, how little this recording separates them, and how far the
    motion will."""
    assert names(doubtful) >= {"backlash", "encoder_offset"}
    assert doubtful.proposal is not None
    pair = next(
        p
        for p in doubtful.proposal.pairs
        if {p.cause[0], p.alternative[0]} == {"backlash", "encoder_offset"}
    )
    assert pair.here < 1.0 < DECISIVE < pair.expected
    written = doubtful.to_dict()
    told = {a["effect"]: a["separated_by"] for a in written["causes"][0]["alternatives"]}
    assert (
        told["encoder_offset" if written["causes"][0]["effect"] == "backlash" else "backlash"]
        == SEPARATING
    )
    assert written["next_motion"]["file"] == SEPARATING
    assert written["next_motion"]["duration_s"] == pytest.approx(20.0)


def test_the_motion_keeps_the_limits_and_its_file_loads(
    doubtful: Diagnosis, tmp_path: Path
) -> None:
    """What is proposed may be run: within every limit, and its file gives the same motion."""
    assert doubtful.proposal is not None and doubtful.proposal.trajectory is not None
    motion = doubtful.proposal.trajectory
    assert LIMITS.use(motion, MODEL).kept
    motion.save(tmp_path / SEPARATING)
    t = np.linspace(0.0, motion.duration, 50)
    np.testing.assert_array_equal(
        load_trajectory(tmp_path / SEPARATING).evaluate(t)[0], motion.evaluate(t)[0]
    )


@pytest.mark.nightly
def test_a_recording_of_the_motion_decides(doubtful: Diagnosis) -> None:
    """On the proposed motion the diagnosis names which of the two is true, and has no pair left."""
    assert doubtful.proposal is not None and doubtful.proposal.trajectory is not None
    recording = record(doubtful.proposal.trajectory, PLAY, seed=3, rate=1000.0)
    found = diagnose([recording], Question(ROBOT))
    assert found.causes[0].effect == "backlash"
    assert found.causes[0].confidence > 0.95


def test_the_rehearsed_size_of_an_effect_is_the_recorded_one(two_causes: Diagnosis) -> None:
    """What a motion is expected to show of an effect is, within a tenth, what its recording
    shows."""
    context = two_causes.context
    assert context is not None
    optional = context.explanation.best.optional
    (term,) = [one for one in optional if one.key[0] == "coulomb_friction"]
    assert term.feature is not None
    fitted = context.explanation.linear.data
    around = ExperimentConditions.of(context.model, fitted)
    for data, motion in zip((fitted, context.validate), motions(), strict=True):
        recorded = np.sum(data.whiten(data.plain(term.feature, term.theta)) ** 2)
        predicted = np.sum(
            PredictedExperiment(around, motion, RATE).white(term.feature, term.theta) ** 2
        )
        assert recorded / data.seconds == pytest.approx(predicted / motion.duration, rel=0.1)


def test_without_doubt_nothing_is_proposed(doubtful: Diagnosis) -> None:
    """Where there are no alternatives there is nothing to separate."""
    assert doubtful.context is not None
    alone = [replace(cause, alternatives=()) for cause in doubtful.causes]
    assert propose(doubtful.context, alone, rng=np.random.default_rng(0)) is None


def test_changes_between_recordings_are_no_rivals_of_causes(doubtful: Diagnosis) -> None:
    """A set that holds a change beside its effects gets the same motion: a change is nowhere to be
    simulated."""
    context = doubtful.context
    assert context is not None
    explanation = context.explanation
    changed = [change_of(explanation.linear, t) for t in explanation.best.optional if t.linear]
    assert changed
    best = replace(explanation.best, terms=(*explanation.best.terms, *changed))
    beside = replace(context, explanation=replace(explanation, best=best))
    assert (
        len(_ambiguous_pairs(beside, doubtful.causes))
        == len(_ambiguous_pairs(context, doubtful.causes))
        > 0
    )
