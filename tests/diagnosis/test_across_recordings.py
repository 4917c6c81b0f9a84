"""Several recordings: causes refitted on each alone, and whether they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose, follow_up
from elastic_arm.diagnosis.inference import across_recordings
from elastic_arm.diagnosis.inference.across_recordings import compared, odds_of_different_sizes
from elastic_arm.diagnosis.inference.estimates import Agreement, ParameterEstimate, RecordingEstimate
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.settings import AgreementSettings, DiagnosisSettings, RefitSettings
from elastic_arm.diagnosis.texts.findings import agreement_text
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.recording import Recording
from tests.helpers.gap_recordings import ROBOT, motions, record

pytestmark = pytest.mark.slow(9)


def friction(torque: float) -> str:
    return f"coulomb_friction:joint_2:torque={torque}"


def diagnosed(fitted: list[Recording], judges: list[Recording]) -> Diagnosis:
    """Diagnose with dry friction as the only effect that may explain: a mixture of two days has other explanations."""
    question = Question(ROBOT, effects=(EFFECTS["coulomb_friction"],))
    return follow_up(diagnose(fitted, question, judges), rng=None)


@pytest.fixture(scope="module")
def same() -> Diagnosis:
    first, second = motions()
    return diagnosed([record(first, friction(6), seed=1), record(second, friction(6), seed=2)],
                     [record(second.scaled(0.8), friction(6), seed=3)])  # fmt: skip


def test_a_cause_of_the_arm_has_one_size_in_all_recordings(same: Diagnosis) -> None:
    """Friction that is the arm's agrees over three recordings, each within its own interval of the truth."""
    (agreement,) = same.agreements
    assert agreement.agrees and (agreement.effect, agreement.joint) == ("coulomb_friction", "joint_2")
    assert len(agreement.findings) == 3 and agreement.freedom == 2
    for finding in agreement.findings:
        torque = finding.parameters["torque"]
        assert abs(torque.value - 6.0) < max(5 * torque.std, 0.03)
        assert finding.gain > 100.0


def test_a_cause_that_changes_between_recordings_is_told() -> None:
    """Friction of 6 Nm on one day and 9 on another is one cause that does not agree, and the recording is named."""
    first, second = motions()
    days = [record(first, friction(6), seed=1), record(second, friction(9), seed=2)]
    found = diagnosed(days, [record(second.scaled(0.8), friction(6), seed=3)])
    (agreement,) = [a for a in found.agreements if a.joint == "joint_2"]
    assert not agreement.agrees
    assert [f.parameters["torque"].value for f in agreement.findings] == pytest.approx([6.0, 9.0, 6.0], rel=0.02)


def test_a_cause_absent_from_one_recording_does_not_agree() -> None:
    """Friction in one recording of two is not called the arm's."""
    first, second = motions()
    days = [record(first, friction(6), seed=1), record(second, seed=2)]
    found = diagnosed(days, [record(second.scaled(0.8), friction(6), seed=3)])
    assert found.agreements and not any(a.agrees for a in found.agreements if a.joint == "joint_2")


def test_one_recording_is_compared_with_nothing() -> None:
    """Where the last third of one recording judges, there is no second recording to agree with."""
    whole = record(motions()[0].repeated(2), friction(6))
    assert diagnosed([whole], []).agreements == ()


def test_agreement_is_written_with_every_recording(same: Diagnosis) -> None:
    """diagnosis.json holds each cause's size in each recording with its deviation, and whether they agree."""
    (written,) = same.to_dict()["agreement"]
    assert written["agrees"] is True and len(written["recordings"]) == 3
    for one in written["recordings"]:
        assert set(one) == {"recording", "parameters", "log_likelihood"}
        assert one["parameters"]["torque"]["std"] > 0.0
    assert np.isfinite(written["chi_square"]) and written["degrees_of_freedom"] == 2


def test_what_single_recordings_hardly_determine_is_not_called_equal() -> None:
    """Sizes that chance alone spreads by several times their mean neither agree nor disagree, and it is said."""
    agreement = _agreement([1.0, 8.0, -3.0], std=6.0)
    assert agreement.agrees and not agreement.comparable
    assert agreement_text(agreement) == (
        "cannot be compared over the recordings: each alone determines its size too poorly"
    )


def test_sizes_that_differ_are_stated_as_a_share_of_their_mean() -> None:
    """2 and 3 Nm, each to 0.01 Nm, do not agree and are 20 % from their mean."""
    agreement = _agreement([2.0, 3.0], std=0.01)
    assert not agreement.agrees and agreement.comparable
    assert agreement_text(agreement) == (
        "does not agree over the recordings: sizes differ by up to 20.0 % of their mean, beyond their "
        "deviations, which reduces its confidence"
    )


def test_sizes_within_their_deviations_are_not_called_close() -> None:
    """2 and 3 Nm, each to 0.3 Nm, agree for want of certainty, and it is said; 2 and 2.01 Nm do so by themselves."""
    assert agreement_text(_agreement([2.0, 3.0], std=0.3)) == (
        "agrees over the recordings: sizes differ by up to 20.0 % of their mean, within their deviations"
    )
    assert agreement_text(_agreement([2.0, 2.01], std=1e-4)) == (
        "agrees over the recordings: sizes differ by up to 0.2 % of their mean"
    )


def test_what_shows_in_no_recording_alone_is_not_compared() -> None:
    """Of a cause that only all recordings together show, single ones say nothing; of one that some show, they do."""
    text = agreement_text(_agreement([2.0, 3.0], std=0.01, gains=(-1.0, 0.0)))
    assert text == "cannot be compared over the recordings: it shows in none of them alone"
    text = agreement_text(_agreement([2.0, 3.0], std=0.01, gains=(5.0, 0.0)))
    assert text == "does not agree over the recordings: it shows in 1 of 2 alone"


def test_a_cause_of_several_sizes_is_not_certain(same: Diagnosis) -> None:
    """Sizes of 1, 6 and 14 Nm reduce a confidence to less than a tenth; what agrees keeps its own."""
    assert _agreement([1.0, 6.0, 14.0], std=0.05).odds > 9.0
    assert all(agreement.odds == 0.0 for agreement in same.agreements)


def test_odds_of_several_sizes_are_those_of_their_scatter() -> None:
    """Sizes alike, or apart by a tenth, speak for one law, sizes far apart against it, and poor ones for neither."""
    near, tenth, apart, poor = (
        odds_of_different_sizes(np.array(sizes), np.full(3, std), 1.0, AgreementSettings())
        for sizes, std in (
            ([1.0, 1.01, 0.99], 0.02),
            ([1.0, 1.1, 0.9], 1e-3),
            ([0.2, 1.0, 2.2], 0.05),
            ([1.0, 2.0, 0.1], 5.0),
        )
    )
    assert near < 0.05 and tenth < 0.1 and apart > 10.0 and 0.1 < poor < 1.0


def test_with_refit_laws_take_the_torques_that_the_model_predicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A law of the load is compared over recordings by the torque that the diagnosis itself took."""
    given: dict[str, object] = {}

    def data_of(*data: object, **options: object) -> None:
        given.update(options)
        raise StopIteration

    monkeypatch.setattr(across_recordings, "WhitenedData", data_of)
    judged = SimpleNamespace(
        layout=None, band=None, sticking_removed=True, predicted=True, acting=("drag",), scales=(1.0, 3.0)
    )
    with pytest.raises(StopIteration):
        across_recordings.refitted(SimpleNamespace(model=None, validate=judged), [], [])
    assert given == {"predicted": True, "sticking_removed": True, "acting": ("drag",), "scales": (1.0, 3.0)}


def softened(*stiffness: float, comparable: float = AgreementSettings.comparable) -> Diagnosis:
    """Diagnose recordings of an arm whose description is uncertain, each with another stiffness of joint 2."""
    kinds = [*motions(), motions()[1].scaled(0.8)]
    runs = [
        replace(record(motion, f"stiffness_mismatch:joint_2:stiffness={ratio}", seed=k), source=f"run_{k}")
        for k, (motion, ratio) in enumerate(zip(kinds, stiffness, strict=True))
    ]
    # That the whole description is off would explain sizes that differ as well.
    refit = RefitSettings(crude=(0.01,))
    settings = DiagnosisSettings(agreement=AgreementSettings(comparable=comparable), refit=refit)
    question = Question(ROBOT, refit=True, effects=(), settings=settings)
    return follow_up(diagnose(runs[:2], question, runs[2:]), rng=None)


def test_a_number_of_the_arm_is_compared_over_recordings_beside_all_others() -> None:
    """Half the stiffness in every recording is a cause, of that size in each of them."""
    found = softened(0.5, 0.5, 0.5)
    assert [(cause.effect, cause.joint) for cause in found.causes] == [("stiffness_mismatch", "joint_2")]
    assert found.causes[0].confidence > 0.9
    (agreement,) = found.agreements
    assert agreement.agrees and [finding.source for finding in agreement.findings] == ["run_0", "run_1", "run_2"]
    sizes = [finding.parameters["stiffness"].value for finding in agreement.findings]
    assert sizes == pytest.approx([0.5, 0.5, 0.5], rel=0.02)


def test_a_number_that_differs_between_recordings_is_less_sure() -> None:
    """A drive has one stiffness: what seems another one in one of three recordings is hardly its stiffness."""
    found = softened(0.4, 0.4, 1.0)
    (agreement,), (cause,) = found.agreements, found.causes
    assert not agreement.agrees and cause.confidence < 0.5
    *alike, other = (finding.parameters["stiffness"].value for finding in agreement.findings)
    assert alike == pytest.approx([0.4, 0.4], rel=0.05) and other > 0.6


def test_a_number_that_probably_differs_is_no_cause() -> None:
    """Where different sizes are likelier than one, a note states them, and the number stays an imperfection."""
    found = softened(0.4, 0.4, 1.0, comparable=0.1)
    assert not found.causes and found.verdict == "unknown"
    assert any("stiffness_mismatch on joint_2 differs between the recordings" in note for note in found.notes)
    assert any((one.what, one.joint, one.ordinary) == ("stiffness", "joint_2", False) for one in found.imperfections)


def _agreement(torques: Sequence[float], std: float, gains: Sequence[float] = ()) -> Agreement:
    """Compare dry friction of these sizes, one a recording."""
    feature = feature_of(parse(friction(6), ROBOT), ArmEquations(ROBOT, "mod3"))
    sizes = [{"torque": ParameterEstimate(value, std, "Nm")} for value in torques]
    found = [
        RecordingEstimate("run", size, gain) for size, gain in zip(sizes, gains or [50.0] * len(torques), strict=True)
    ]
    return compared(feature, found, AgreementSettings())
