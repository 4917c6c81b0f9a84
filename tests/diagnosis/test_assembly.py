"""From judged and estimated causes to the result: order, confidence, and what is left."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.assembly import assemble
from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis, estimate
from elastic_arm.diagnosis.inference.judgement import Judgement, judge
from elastic_arm.diagnosis.laws.better_laws import BetterLaws
from elastic_arm.diagnosis.pipeline import best_hypothesis
from elastic_arm.diagnosis.preparation import PreparedData, prepare, with_candidates
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.hypothesis import Rival
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects import EFFECTS
from elastic_arm.estimation.effect_columns import Feature
from tests.helpers.gap_recordings import ROBOT, motions, record

EFFECTS_OF_THE_ARM = ("viscous_friction:joint_1:coefficient=20", "coulomb_friction:joint_2:torque=12")
SEARCHED = tuple(EFFECTS[name] for name in ("viscous_friction", "coulomb_friction"))


@cache
def judged() -> tuple[PreparedData, Judgement, EstimatedHypothesis]:
    """The states before the last step, of an arm with two effects."""
    pair = [record(motion, *EFFECTS_OF_THE_ARM, seed=k) for k, motion in enumerate(motions())]
    prepared = with_candidates(prepare([pair[0]], [pair[1]], Question(ROBOT, effects=SEARCHED)))
    found = best_hypothesis(prepared)
    judgement = judge(prepared, found.stepwise.with_rivals(found.hypothesis))
    return prepared, judgement, estimate(prepared, judgement.hypothesis)


def is_at(candidate: Candidate, feature: Feature) -> bool:
    """Whether a candidate is the effect of a feature at its joint, on whatever side."""
    return (candidate.feature.effect.id, candidate.feature.joint) == (feature.effect.id, feature.joint)


def assembled(rivals: Mapping[int, list[Rival]] | None = None) -> Diagnosis:
    """The result, with rivals made up."""
    prepared, judgement, estimated = judged()
    hypothesis = replace(estimated.hypothesis, rivals=rivals or {})
    return assemble(prepared, judgement, replace(estimated, hypothesis=hypothesis))


def test_causes_stand_in_the_order_in_which_they_shrink_the_gap_alone() -> None:
    """The first shrinks it most, and together they shrink it as far as the result states."""
    found = assembled()
    assert {(c.effect, c.joint) for c in found.causes} == {
        ("viscous_friction", "joint_1"),
        ("coulomb_friction", "joint_2"),
    }
    assert found.causes[0].shrink > found.causes[1].shrink
    assert found.cumulative_shrink[0] == pytest.approx(found.causes[0].shrink)
    assert found.cumulative_shrink[-1] == pytest.approx(found.shrink)
    assert list(found.cumulative_shrink) == sorted(found.cumulative_shrink)


def test_confidence_is_shared_with_rivals_by_their_odds() -> None:
    """A rival of odds 1 to 3 leaves a cause three quarters; one below a hundredth is not listed."""
    hypothesis = judged()[2].hypothesis
    own, other = hypothesis.causes
    likely, faint = Rival(hypothesis.selected[other], 1.0 / 3.0), Rival(hypothesis.selected[other], 1e-4)
    found = assembled({own: [likely, faint]})
    place = (hypothesis.selected[own].feature.effect.id, hypothesis.selected[own].feature.joint)
    (cause,) = (c for c in found.causes if (c.effect, c.joint) == place)
    assert cause.confidence == pytest.approx(0.75, rel=1e-3)
    assert [a.confidence for a in cause.alternatives] == pytest.approx([0.25], rel=1e-3)


def test_an_effect_on_either_side_is_one_alternative() -> None:
    """Odds of both sides count together, and what is told apart is the alternative, not the cause's own other side."""
    prepared, _, estimated = judged()
    own, other = (estimated.hypothesis.selected[k].feature for k in estimated.hypothesis.causes)
    places = {feature: [c for c in prepared.library.candidates if is_at(c, feature)] for feature in (own, other)}
    same = next(c for c in places[own] if c.feature.key != own.key)
    rivals = [Rival(same, 1.0), *(Rival(c, 0.5) for c in places[other][:2])]
    found = assembled({estimated.hypothesis.causes[0]: rivals})
    index = [(c.effect, c.joint) for c in found.causes].index((own.effect.id, own.joint))
    (alternative,) = found.causes[index].alternatives
    assert (alternative.effect, alternative.joint) == (other.effect.id, other.joint)
    assert alternative.confidence == pytest.approx(1.0 / 3.0)
    assert found.context is not None and found.context.rivals[index] == (places[other][0],)


def test_a_cause_without_rivals_is_certain() -> None:
    """Its confidence is one where everything is explained."""
    found = assembled()
    assert found.verdict == "explained" and {c.confidence for c in found.causes} == {1.0}


def test_residuals_are_stated_for_every_place_before_and_after() -> None:
    """Root mean square and peak of every joint and side, smaller where a cause acts."""
    found, prepared = assembled(), judged()[0]
    assert set(found.before.rmse) == set(found.after.peak) == set(prepared.places)
    assert found.after.rmse["joint_2", "motor"] < 0.5 * found.before.rmse["joint_2", "motor"]


def test_notes_of_all_steps_come_in_their_order() -> None:
    """Notes of the data first, then those of the judgement, then those of the estimates."""
    prepared, judgement, estimated = judged()
    found = assemble(
        replace(prepared, notes=("data",), independent_motion=True),
        replace(judgement, notes=("judgement",)),
        replace(estimated, notes=("estimates",)),
    )
    assert found.notes == ("data", "judgement", "estimates")


def test_without_a_gap_nothing_shrinks() -> None:
    """A clean arm has the verdict none, no cause, and no share of a gap."""
    pair = [record(motion, seed=k) for k, motion in enumerate(motions())]
    prepared = with_candidates(prepare([pair[0]], [pair[1]], Question(ROBOT, effects=SEARCHED)))
    found = best_hypothesis(prepared)
    judgement = judge(prepared, found.stepwise.with_rivals(found.hypothesis))
    found = assemble(prepared, judgement, estimate(prepared, judgement.hypothesis))
    assert (found.verdict, found.causes, found.shrink, found.shrink_interval) == ("none", (), None, None)


@pytest.mark.parametrize(
    ("measure", "gain", "outweighed"), [("likelihood", 340, 1), ("likelihood", 80, 0), ("excess", 340, 0)]
)
def test_a_law_that_explains_more_than_all_causes_of_a_faint_gap_leaves_it_unexplained(
    measure: str, gain: float, outweighed: bool
) -> None:
    """A late channel of 90 nats does not explain an arm on which a law of no catalogue explains 340."""
    judgement: Any = SimpleNamespace(measure=SimpleNamespace(name=measure), log_likelihood=10.0)
    estimated: Any = SimpleNamespace(faults=(SimpleNamespace(gain=80.0),))
    law: Any = SimpleNamespace(gain=gain)
    assert BetterLaws(law).outweigh(judgement, estimated) == outweighed
    assert not BetterLaws().outweigh(judgement, estimated)
