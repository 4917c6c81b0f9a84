"""Which candidates pass as causes, with gains and falls made up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import pipeline
from elastic_arm.diagnosis.inference import judgement
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.judgement import eliminate, outside_their_ranges, passes
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import EFFECTS

SETTINGS = DiagnosisSettings()


def measure_of(own: float = 0.0) -> Any:
    """A measure by which candidates take what they claim off the gap, and this share of the gap of their joint."""
    return SimpleNamespace(
        contribution=lambda selected, k: selected[k].share, place_contribution=lambda selected, k: own
    )


def candidate(
    name: str, share: float, fall: float, parameters: int = 1, *, friction: bool = False, joint: str = "joint_1"
) -> Any:
    """A candidate that takes a share of the gap and lowers the squares of each block by so much on average."""
    effect = SimpleNamespace(id=name, parameters=[None] * parameters, is_friction=friction)
    feature = SimpleNamespace(effect=effect, joint=joint, key=(name, joint))
    return SimpleNamespace(share=share, fall=fall, feature=feature)


class Library:
    """Falls of blocks and likelihoods that candidates claim."""

    def falls(self, without: Any, selected: Any) -> tuple[np.ndarray, np.ndarray]:
        (one,) = [c for c in selected if c not in without]
        noise = np.random.default_rng(0).standard_normal(40)
        return one.fall + noise, one.fall + noise

    def held_out(self, selected: Any) -> float:
        return float(sum(c.fall for c in selected))


@pytest.fixture
def prepared(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(judgement, "misfit", lambda library, selected: 1.0)
    monkeypatch.setattr(judgement, "insignificant", lambda prepared, hypothesis: [])
    monkeypatch.setattr(judgement, "outside_their_ranges", lambda prepared, hypothesis: [])
    estimates = SimpleNamespace(parameters=lambda selected: [{} for _ in selected])
    sizes = SimpleNamespace(notes=lambda hypothesis, estimated: {})
    return SimpleNamespace(library=Library(), settings=SETTINGS, estimates=estimates, sizes=sizes)


@pytest.mark.parametrize(
    ("share", "fall", "expected"),
    [(0.5, 5.0, True), (0.005, 5.0, False), (0.5, 0.0, False)],
    ids=["a cause", "below 1 % of the gap", "not in every resample"],
)
def test_a_cause_is_large_enough_and_lowers_the_squares_in_every_resample(
    share: float, fall: float, expected: bool, prepared: Any
) -> None:
    """Of a share of the gap and a fall that blocks agree on, neither may be missing."""
    hypothesis = Hypothesis([candidate("one", share, fall)])
    assert passes(prepared, hypothesis, 0, share, measure_of()) == expected


def test_another_least_share_decides_otherwise(prepared: Any) -> None:
    """What is too small at 1 % passes at 0.1 %."""
    prepared.settings = replace(SETTINGS, judgement=replace(SETTINGS.judgement, least_shrink=0.001))
    assert passes(prepared, Hypothesis([candidate("one", 0.005, 5.0)]), 0, 0.005, measure_of())


def test_an_effect_without_parameters_is_judged_by_likelihood(prepared: Any) -> None:
    """It needs the gain of a selected candidate, whatever its share of the gap."""
    for gained, expected in ((SETTINGS.search.least_gain + 1.0, True), (SETTINGS.search.least_gain - 1.0, False)):
        hypothesis = Hypothesis([candidate("coupling", 0.0, gained, 0)])
        assert passes(prepared, hypothesis, 0, 0.0, measure_of()) == expected


def test_causes_that_fail_leave_worst_first_and_known_effects_stay(prepared: Any) -> None:
    """Known effects are not judged; of the causes those that fail go, and one beyond doubt but small is noted."""
    known, good = candidate("known", 0.0, 0.0), candidate("good", 0.6, 30.0)
    small, noise = candidate("small", 0.004, 25.0), candidate("noise", -0.1, 0.0)
    left, notes = eliminate(prepared, Hypothesis([known, noise, good, small], 1), measure_of())
    assert [c.feature.effect.id for c in left.selected] == ["known", "good"]
    (note,) = notes
    assert note == "small of joint_1 shows as well, 0.40% of the gap: less than 1% is no cause."


@pytest.mark.parametrize(
    ("beside", "gained", "expected"),
    [
        (candidate("coulomb", 0.9, 60.0, friction=True), 25.0, True),
        (candidate("stribeck", 0.9, 60.0, friction=True, joint="joint_2"), 25.0, True),
        (candidate("coulomb", 0.9, 60.0, friction=True, joint="joint_2"), 25.0, False),
        (candidate("gain", 0.9, 60.0), 25.0, False),
        (candidate("coulomb", 0.9, 60.0, friction=True), 15.0, False),
    ],
    ids=["other friction of its joint", "its kind elsewhere", "other kind elsewhere", "no friction", "doubtful"],
)
def test_a_small_term_of_friction_is_a_cause_beside_its_family(
    beside: Any, gained: float, expected: bool, prepared: Any
) -> None:
    """Below 1 % of the gap it has to be beyond doubt, beside friction of its joint or of its kind."""
    small = candidate("stribeck", 0.004, gained, friction=True)
    assert passes(prepared, Hypothesis([beside, small]), 1, 0.004, measure_of()) == expected


@pytest.mark.parametrize(
    ("own", "gained", "expected"),
    [(0.5, 25.0, True), (0.1, 25.0, False), (0.5, 15.0, False)],
    ids=["half of its joint's gap", "a tenth of it", "doubtful"],
)
def test_what_makes_a_good_part_of_its_joints_own_gap_is_a_cause(
    own: float, gained: float, expected: bool, prepared: Any
) -> None:
    """Beside an arm on its side the friction of a wrist is less than 1 % of the gap, and all that its joint lacks."""
    large, small = candidate("base_tilt", 0.99, 90.0, joint="arm"), candidate("coulomb", 0.001, gained, friction=True)
    assert passes(prepared, Hypothesis([large, small]), 1, 0.001, measure_of(own)) == expected


def test_a_size_that_no_arm_has_is_noted_and_no_cause(prepared: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cause leaves, and its note stays."""
    absurd, good = candidate("absurd", 0.5, 30.0), candidate("good", 0.4, 30.0)

    prepared.sizes = SimpleNamespace(notes=lambda hypothesis, estimated: {absurd.feature.key: "absurd"})
    monkeypatch.setattr(judgement, "in_its_place", lambda *_: None)
    left, notes = eliminate(prepared, Hypothesis([absurd, good]), measure_of())
    assert left.selected == [good] and notes == ["absurd"]


@pytest.mark.parametrize("found", [True, False], ids=["something else stands for it", "nothing does"])
def test_in_the_place_of_a_number_outside_its_range_stands_what_it_is_confused_with(
    found: bool, prepared: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction that bends beyond its range is another friction, not none; without one it leaves, and no note stays."""
    bent, viscous, good = candidate("bent", 0.5, 30.0), candidate("viscous", 0.5, 30.0), candidate("good", 0.4, 30.0)

    def outside(prepared: Any, hypothesis: Hypothesis) -> list[int]:
        return [k for k in hypothesis.causes if hypothesis.selected[k] is bent]

    def replaced(prepared: Any, hypothesis: Hypothesis, k: int, refused: Any) -> Hypothesis | None:
        assert ("bent", "joint_1") in refused
        return replace(hypothesis, selected=[viscous, *hypothesis.without(k)]) if found else None

    monkeypatch.setattr(judgement, "outside_their_ranges", outside)
    monkeypatch.setattr(judgement, "in_its_place", replaced)
    left, notes = eliminate(prepared, Hypothesis([bent, good]), measure_of())
    assert left.selected == ([viscous, good] if found else [good]) and notes == []


def test_a_cause_that_is_impossible_beside_everything_else_gives_way(
    prepared: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Believable in the search, not in the last estimates: what it is confused with is judged and estimated."""
    bent, viscous, good = candidate("bent", 0.5, 30.0), candidate("viscous", 0.5, 30.0), candidate("good", 0.4, 30.0)

    def judged(prepared: Any, hypothesis: Hypothesis, *impossible: Any) -> Any:
        return SimpleNamespace(hypothesis=eliminate(prepared, hypothesis, measure_of(), *impossible)[0], faults=())

    def estimated(prepared: Any, hypothesis: Hypothesis, faults: Any) -> Any:
        impossible = {bent.feature.key: "bent"} if bent in hypothesis.selected else {}
        return SimpleNamespace(hypothesis=hypothesis, impossible=impossible)

    def replaced(prepared: Any, hypothesis: Hypothesis, k: int, refused: Any) -> Hypothesis:
        return replace(hypothesis, selected=[viscous, *hypothesis.without(k)])

    monkeypatch.setattr(judgement, "in_its_place", replaced)
    monkeypatch.setattr(pipeline, "beyond_ordinary", lambda prepared, hypothesis, refused: (prepared, hypothesis))
    monkeypatch.setattr(pipeline, "judge", judged)
    monkeypatch.setattr(pipeline, "estimate", estimated)
    found = pipeline.estimated_beyond_ordinary(prepared, Hypothesis([bent, good]))
    assert found.estimated.hypothesis.selected == [viscous, good]
    assert found.judgement.hypothesis.selected == [viscous, good]


@pytest.mark.parametrize("left", [(), ("other fault",)])
def test_a_fault_beside_false_causes_alone_is_no_part_of_the_gap(
    left: tuple[str, ...], prepared: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no fault is left beside the causes that pass, the gap is measured without those that were counted."""
    good, false = candidate("good", 0.6, 30.0), candidate("false", -0.1, 0.0)
    prepared.gear_ratios, prepared.model = (lambda joint: (1.0, 1.0)), SimpleNamespace(n=1)
    search = SimpleNamespace(simplified=lambda hypothesis: hypothesis)
    monkeypatch.setattr(judgement, "LackOfFitTest", lambda *given: None)
    monkeypatch.setattr(judgement, "StepwiseSearch", lambda *given: search)
    monkeypatch.setattr(judgement, "without_ordinary", lambda prepared, hypothesis: (hypothesis, []))
    monkeypatch.setattr(judgement, "faults_beside", lambda prepared, chosen: ("fault",) if false in chosen else left)
    monkeypatch.setattr(judgement, "_measured", lambda prepared, hypothesis, test, faults: (faults, f"beside {faults}"))
    monkeypatch.setattr(
        judgement, "gap_measure", lambda *given, **of: SimpleNamespace(contribution=lambda chosen, k: 1.0)
    )
    monkeypatch.setattr(judgement, "eliminate", lambda prepared, hypothesis, *beside: (hypothesis.drop(1), []))
    judged = judgement.judge(prepared, Hypothesis([good, false]))
    assert judged.faults == left and (bool(left) or judged.measure == "beside ()")


@pytest.mark.parametrize(("half_gap", "beyond"), [(0.002005, []), (0.0022, [0])])
def test_a_number_that_passes_its_range_by_next_to_nothing_is_within(half_gap: float, beyond: list[int]) -> None:
    """Limits are round numbers: play of 2 mrad that comes out as 2.005 is that; 2.2 mrad stand for something else."""
    effect = SimpleNamespace(parameters=EFFECTS["backlash"].parameters)
    hypothesis: Any = Hypothesis([SimpleNamespace(feature=SimpleNamespace(effect=effect))])  # type: ignore[list-item]
    values = [{"half_gap": ParameterEstimate(half_gap, 1e-6, "rad")}]
    estimates, library = SimpleNamespace(parameters=lambda selected: values), SimpleNamespace(nuisance=[None])
    prepared: Any = SimpleNamespace(library=library, settings=SETTINGS, estimates=estimates)
    assert outside_their_ranges(prepared, hypothesis) == beyond
