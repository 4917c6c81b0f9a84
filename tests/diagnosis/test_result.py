"""The result of a diagnosis: as data, in words, and as the corrected arm."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.diagnosis import Diagnosis
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.estimates import ParameterEstimate, averaged
from elastic_arm.diagnosis.regimes import REGIMES
from elastic_arm.diagnosis.result import (
    SEPARATING,
    Alternative,
    Cause,
    Change,
    ComparedScale,
    Imperfection,
    PairSeparation,
    Proposal,
    ResidualSizes,
    UnexplainedResidual,
)
from elastic_arm.diagnosis.words import (
    SHOWN_BY,
    cause_sentence,
    cause_size,
    change_text,
    estimates_text,
    instance_text,
    merged_notes,
    percent,
    probability_text,
    ringing_notes,
    scale_sentence,
    specific_first,
    summary,
    trust_text,
    unknown_sentences,
)
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.errors import DiagnosisError, MissingExtraError, OutputError
from elastic_arm.formatting import JointUnits, rounded
from elastic_arm.results import ClosedLoopError
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)
PLACE = ("joint_2", "motor")


def cause(text: str = "coulomb_friction:joint_2:torque=6", **sizes: ParameterEstimate) -> Cause:
    instance = parse(text, ROBOT)
    others = (
        Alternative("viscous_friction", "joint_2", 0.2, "slow motion"),
        Alternative("backlash", None, 0.1, "any"),
    )
    size = sizes or {"torque": ParameterEstimate(6.0, 0.12345678901, "Nm")}
    return Cause(
        instance.effect.id,
        instance.joint,
        ("motor",),
        "velocity_reversal",
        size,
        0.5,
        0.7,
        others,
        instance,
    )


def diagnosis(*causes: Cause) -> Diagnosis:
    sizes = ResidualSizes({PLACE: 0.4}, {PLACE: 1.2})
    return Diagnosis(
        model="mod3",
        robot=ROBOT.name,
        joints=ROBOT.joint_names,
        identify=("a",),
        validate=("b",),
        independent_motion=True,
        judged={"b": (0.0, 20.0)},
        band=40.0,
        trust={"as measured": 0.0004, "as calibrated": 0.9996 - 0.03, "as built": 0.03},
        verdict="explained",
        noise={PLACE: 0.1},
        before=sizes,
        after=sizes,
        shrink=0.9,
        shrink_interval=(0.8, float("nan")),
        shrink_by_place={PLACE: 0.9},
        causes=causes,
        unexplained=(),
        imperfections=(
            Imperfection("joint_torque_gain", "joint_2", "1", 1.006, 0.001, 0.01, True),
        ),
        changes=(
            Change(
                "coulomb_friction",
                "joint_2",
                "torque",
                "Nm",
                (("a", 6.0, 0.1), ("b", 9.0, 0.1)),
                0.999,
            ),
        ),
    )


def test_the_file_is_the_contracts(tmp_path: Path) -> None:
    """Schema 2 holds every field of the contract; what was not measured is null, and the file is
    valid JSON."""
    data = json.loads(diagnosis(cause()).save(tmp_path / "new" / "diagnosis.json").read_text())
    assert data["schema"] == "elastic_arm/diagnosis/2"
    assert set(data) == {
        "schema", "model", "robot", "recordings", "band_hz", "trust", "verdict", "noise", "gap",
        "shrink", "shrink_interval", "causes", "shrink_by_place", "imperfections", "changes",
        "unexplained", "known", "events", "notes", "not_confirmed", "prediction", "next_motion",
    }  # fmt: skip
    assert set(data["recordings"]) == {"identify", "validate", "independent_motion", "judged_s"}
    assert data["gap"]["before"]["joint_2"] == {
        "link": None,
        "drive": None,
        "motor": {"rmse": 0.4, "max": 1.2},
    }
    assert (
        data["shrink_interval"] == [0.8, None]
        and data["shrink_by_place"]["joint_2"]["motor"] == 0.9
    )
    (one,) = data["causes"]
    assert set(one) == {
        "effect", "joint", "sides", "regime", "parameters", "shrink", "confidence", "from", "to",
        "held_as", "rejected", "alternatives", "shrink_without",
    }  # fmt: skip
    assert (
        one["parameters"]["torque"]["std"] == pytest.approx(0.1234568, abs=1e-9)
        and one["from"] is None
    )
    assert data["imperfections"][0]["prior_std"] == 0.01
    assert data["changes"][0]["values"][1] == {"recording": "b", "value": 9.0, "std": 0.1}


def test_a_saved_diagnosis_is_read_as_it_was(tmp_path: Path) -> None:
    """What was written is written again alike once read, with its causes as the simulator takes
    them; else one line."""
    found = diagnosis(
        cause(), cause("time_delay:delay=0.003", delay=ParameterEstimate(0.003, 1e-4, "s"))
    )
    found = replace(
        found,
        shrink_interval=(0.8, 0.9),
        proposal=Proposal(None, (PairSeparation(PLACE, PLACE, 1.0),), 3),
    )
    read = Diagnosis.load(found.save(tmp_path / "diagnosis.json"))
    assert read.to_dict() == found.to_dict() and read.causes[0].instance == found.causes[0].instance
    assert summary(read) == summary(found)
    for text in ("{", "{}", '{"schema": "elastic_arm/diagnosis/2"}'):
        (tmp_path / "broken.json").write_text(text)
        with pytest.raises(DiagnosisError, match=r"Give a diagnosis\.json|Its schema must be"):
            Diagnosis.load(tmp_path / "broken.json")


def test_tables_are_csv_files_and_a_notebook_shows_the_verdict(tmp_path: Path) -> None:
    """Causes, residuals' sizes and numbers are a file each; without pandas a data frame is refused
    with a remedy."""
    found = diagnosis(cause())
    files = {path.name: path.read_text().splitlines() for path in found.to_csv(tmp_path)}
    assert list(files) == ["causes.csv", "gap.csv", "parameters.csv"]
    assert (
        files["causes.csv"][0]
        == "effect,joint,sides,probability,share_of_gap,parameter,value,std,unit"
    )
    assert (
        files["causes.csv"][1] == "coulomb_friction,joint_2,motor,0.7,0.5,torque,6,0.123456789,Nm"
    )
    assert (
        "Joint 2 has dry friction of 6 Nm" in found._repr_html_()
        and found.plot()._repr_png_()[1:4] == b"PNG"
    )


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_data_frame_is_a_table(library: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The library is given the columns of a table; a table and a library that are missing are
    refused."""
    monkeypatch.setitem(
        sys.modules, library, SimpleNamespace(DataFrame=lambda columns, **_: columns)
    )
    monkeypatch.setattr("elastic_arm.errors.find_spec", lambda name: name)
    assert diagnosis(cause()).to_dataframe("gap", library)["rmse_before"] == [0.4]
    with pytest.raises(OutputError, match="unknown table 'nope'"):
        diagnosis(cause()).to_dataframe("nope")
    monkeypatch.setattr("elastic_arm.errors.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=f"pip install {library}"):
        diagnosis(cause()).to_dataframe(library=library)


def test_what_a_description_states_goes_from_its_number_to_the_one_found() -> None:
    """`from` and `to` are in the file, and both numbers in the words."""
    one = replace(cause(), stated={"torque": 60.0, "side": "motor"})
    written = replace(one, stated={"torque": 60.0}).to_dict()
    assert (written["from"], written["to"]) == ({"torque": 60.0}, {"torque": 6.0})
    assert "has dry friction of 6 Nm, where the description states torque 60 Nm" in cause_sentence(
        one, "mod3"
    )
    assert cause_size(one) == "torque 60 → 6.00 ± 0.12 Nm"


def test_a_decided_alternative_names_the_file_and_others_their_motion() -> None:
    """The proposed motion stands at the alternative that it is expected to decide on, and at no
    other."""
    decided = {(("coulomb_friction", "joint_2"), ("viscous_friction", "joint_2"))}
    first, second = cause().with_separating_file(decided).to_dict()["alternatives"]
    assert (first["separated_by"], second["separated_by"]) == (SEPARATING, "any")
    assert cause().with_separating_file(set()) == cause()


def test_a_file_that_cannot_be_written_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    """A folder in the file's place is refused in one line."""
    with pytest.raises(DiagnosisError, match="Choose another --out"):
        diagnosis().save(tmp_path)


def test_the_corrected_arm_has_what_was_known_and_what_was_found() -> None:
    """Causes join the known effects, at their fitted sizes or, where nothing shows them, as they
    are stated; numbers are the arm's own, and what a richer model variant has is left to that
    variant."""
    known, unseen = (parse(f"viscous_friction:joint_{k}:coefficient=3", ROBOT) for k in (1, 3))
    context: Any = SimpleNamespace(
        known=(known,), unseen=(unseen,), model=SimpleNamespace(robot=ROBOT)
    )
    number = replace(cause("stiffness_mismatch:joint_1:stiffness=0.7"), is_number=True)
    causes = (cause(), cause("inertia_coupling"), number)
    found: Any = SimpleNamespace(context=context, causes=causes, imperfections=(), made=())
    assert [one.held_as for one in found.causes] == ["effect", "variant", "number"]
    effects = repaired_robot(ROBOT, found).effects
    assert [(e["effect"], e["joint"]) for e in effects] == [
        ("viscous_friction", "joint_1"),
        ("viscous_friction", "joint_3"),
        ("coulomb_friction", "joint_2"),
    ]


def test_a_size_is_as_uncertain_as_the_set_of_causes_is() -> None:
    """5 and 7 Nm in two sets at odds of 3 to 1 have the mean 5.5, and their spread adds to the
    deviation."""
    sets = [(p, {"torque": ParameterEstimate(v, 0.1, "Nm")}) for p, v in ((0.6, 5.0), (0.2, 7.0))]
    size, std = averaged(sets)["torque"], (0.1**2 + 0.75 * 0.5**2 + 0.25 * 1.5**2) ** 0.5
    assert (size.value, size.std) == pytest.approx((5.5, std))
    sets = [
        (p, {"com": ParameterEstimate([v, 1.0], [0.1, 0.2], "m")})
        for p, v in ((0.6, 5.0), (0.2, 7.0))
    ]
    size = averaged(sets)["com"]
    assert size.value == pytest.approx([5.5, 1.0]) and size.std == pytest.approx([std, 0.2])


def test_a_cause_is_a_plain_sentence() -> None:
    """Friction is the model's lack, a gain the recording's, what has no size a matter of the model,
    small angles have a prefix, a rival is named, and an effect without words of its own goes by its
    name."""
    alone = replace(cause(), alternatives=())
    assert (
        cause_sentence(alone, "mod3") == "Joint 2 has dry friction of 6 Nm, which the model lacks."
    )
    assert (
        "(or viscous_friction on joint_2: the recording does not separate them)"
        in cause_sentence(cause(), "mod3")
    )
    gain = cause("joint_torque_gain:joint_1:gain=1.15", gain=ParameterEstimate(1.15, 0.01, "1"))
    assert (
        cause_sentence(replace(gain, alternatives=()), "mod3")
        == "Joint 1 records 1.15 times its joint torque."
    )
    slight = replace(
        gain, parameters={"gain": ParameterEstimate(1.0023, 0.0004, "1")}, alternatives=()
    )
    assert cause_sentence(slight, "mod3") == "Joint 1 records 1.002 times its joint torque."
    coupling = replace(cause("inertia_coupling"), parameters={}, alternatives=())
    assert cause_sentence(coupling, "mod2").endswith(
        "on the links that carry them, which mod2 lacks (it is part of mod3)."
    )
    play = cause("backlash:joint_1:half_gap=2e-5", half_gap=ParameterEstimate(2e-5, 1e-6, "rad"))
    assert cause_sentence(play, "mod3").startswith("Joint 1 has 20 µrad of play to either side")
    own = replace(cause().instance, effect=replace(cause().instance.effect, plain=""))
    assert cause_sentence(replace(alone, instance=own), "mod3").startswith(
        "Joint 2 has coulomb friction of torque 6 Nm"
    )


@pytest.mark.parametrize(
    ("std", "words"), [(0.03, "share of 0.06 over"), (0.3, "share of 0.06 ± 0.30 over")]
)
def test_a_size_within_its_deviation_of_none_is_not_said_as_known(std: float, words: str) -> None:
    """Such a size has its deviation in the sentence, and where there is no other, the sentence says
    that it is open."""
    one = cause("thermal_friction:joint_2:change=0.06", change=ParameterEstimate(0.06, std, "1"))
    told = cause_sentence(one, "mod3")
    assert words in told and ("the recording shows its presence but not its size" in told) == (
        std > 0.06
    )
    stated = replace(cause(torque=ParameterEstimate(0.1, 0.3, "Nm")), stated={"torque": 60.0})
    assert "has dry friction of 0.1 Nm" in cause_sentence(
        stated, "mod3"
    )  # 200 deviations from what is stated
    sizes = {
        "mass": ParameterEstimate(1.0, 0.1, "kg"),
        "position": ParameterEstimate([0.06, 0.0, 0.0], [0.3] * 3, "m"),
    }
    load = cause_sentence(cause("payload:mass=1,position=0.06/0/0", **sizes), "mod3")
    assert "carries 1 kg at its tool" in load and "not its size" not in load


def test_every_effect_says_in_plain_words_what_it_does() -> None:
    """At its defaults or in the middle of its ranges, every effect of the catalogue gives a
    sentence."""
    for effect in EFFECTS.values():
        instance = next(effect.candidates(ROBOT))
        sizes = {
            p.name: ParameterEstimate(instance.parameters[p.name], 0.1, p.unit)
            for p in effect.parameters
        }
        one = replace(
            cause(), effect=effect.id, joint=instance.joint, parameters=sizes, instance=instance
        )
        assert effect.plain and re.fullmatch(
            r"[A-Z][^{}_]*\.", cause_sentence(replace(one, alternatives=()), "mod1")
        )


def test_the_summary_says_what_the_arm_has_and_how_right_the_model_is_then() -> None:
    """The verdict comes first, then causes, the model's error without and with them, and the share
    that is gone."""
    first, last = summary(diagnosis(cause()))
    assert (
        first.startswith("explained: Joint 2 has dry friction of 6 Nm")
        and "error on another motion" in last
    )
    place = "0.4 Nm at joint_2 (motor side, noise 0.1 Nm)"
    assert f"{place}, where the description exceeds the noise most;" in last
    assert last.endswith("the gap shrinks by 90.0 %.")
    assert summary(replace(diagnosis(cause()), shrink=-147.69))[-1].endswith(
        "the correction increases the total gap."
    )
    inertia = Imperfection("rotor_inertia", "joint_2", "kg m^2", 1.2, 0.01, 2.0, ordinary=True)
    _, then, named = summary(replace(diagnosis(cause()), imperfections=(inertia,)))
    assert (
        then.startswith("With it and the motor inertia, the model")
        and "1.2 kg m² at joint_2" in named
    )
    assert repr(diagnosis(cause())) == f"{first}\n{last}"
    (off,) = summary(
        replace(diagnosis(), verdict="none", shrink_by_place={("joint_2", "motor"): 0.9})
    )
    assert off.endswith(
        "of the sensors, with only ordinary deviations of the parameters of arm and sensors. At"
        " joint_2 (motor side), the model's error is 0.4 Nm as described and 0.4 Nm with these"
        " deviations."
    )
    (alone,) = summary(replace(diagnosis(), verdict="none", shrink_by_place={}))
    assert alone == "none: recording and model agree within the noise of the sensors."


def test_trust_and_changes_are_sentences() -> None:
    """Trust leaves out what is excluded, a change has every recording."""
    found = diagnosis(cause())
    assert trust_text(found.trust) == (
        "as calibrated, its numbers off by a fifth of ordinary deviations (97 %);"
        " as built, its numbers off by ordinary deviations (3 %)"
    )
    assert "6.00 ± 0.10 Nm in a; 9.00 ± 0.10 Nm in b" in change_text(found.changes[0])


@pytest.mark.parametrize(
    ("value", "std", "told"),
    [
        (0.9036, 0.02031, "0.904 ± 0.020"),
        (5.0, 0.0996, "5.00 ± 0.10"),
        (99.96, 1.0, "100.0 ± 1.0"),
        (46.2453, 288.0, "50 ± 290"),
        (3.562e7, 4.757e5, "3.562e+07 ± 4.8e+05"),
        (1.388e-5, 7.31e-6, "1.39e-05 ± 7.3e-06"),
        (1.2e-10, 4.1e-9, "1e-10 ± 4.1e-09"),
        (0.001, 5.0, "0 ± 5.0"),
        (0.444, 1e-12, "0.4440000 ± 1.0e-12"),
    ],
)
def test_values_have_the_digits_that_their_deviation_warrants(
    value: float, std: float, told: str
) -> None:
    """The deviation has two digits, the value the same place, at most seven of them."""
    assert " ± ".join(rounded(value, std)) == told


def test_sizes_carry_units_and_leave_out_deviations_of_what_is_given() -> None:
    """Whole orders have no deviation, what is not determined has words, and vectors have a
    deviation for each number."""
    told = estimates_text(
        {
            "amplitude": ParameterEstimate(2.0312e-5, 1.7e-7, "rad"),
            "order": ParameterEstimate(2.0, 0.0, "1"),
            "phase": ParameterEstimate(0.7, None, "rad"),
            "position": ParameterEstimate([0.0123, 0.1], [0.0011, 0.02], "m"),
            "com": ParameterEstimate([0.0, 0.0, 0.0], [None] * 3, "m"),
            "inertia": ParameterEstimate([0.0, 1.0], [None, 0.1], "1"),
        }
    )
    assert (
        told
        == "amplitude 2.031e-05 ± 1.7e-07 rad, order 2, phase not determined, position (0.0123,"
        " 0.100) ± (0.0011, 0.020) m, com not determined, inertia (not determined, 1.00) ± (–,"
        " 0.10)"
    )


@pytest.mark.parametrize(
    ("probability", "told"),
    [
        (1.0, "> 99.9 %"),
        (0.9996, "> 99.9 %"),
        (0.9957, "99.6 %"),
        (0.85, "85 %"),
        (0.005, "0.5 %"),
        (0.0, "< 0.1 %"),
    ],
)
def test_certainty_is_never_claimed(probability: float, told: str) -> None:
    """A probability is never told as 100 %, nor as 0 %, and a share next to nothing has no sign."""
    assert probability_text(probability) == told
    assert (percent(-0.0003), percent(-0.048), percent(None)) == ("0.0 %", "-4.8 %", "0.0 %")


def test_given_effects_are_told_with_the_units_at_their_joint() -> None:
    """What a simulation was given has its unit behind every number, N at a rail, and its choices by
    name."""
    rail = JointUnits(ROBOT.joint_names, ["joint_2"])
    friction = parse("coulomb_friction:joint_2:torque=13.9", ROBOT)
    assert instance_text(friction, ROBOT.units) == "torque 13.9 Nm, side motor"
    assert instance_text(friction, rail) == "torque 13.9 N, side motor"
    load = parse("payload:mass=5,position=0/0/0.1", ROBOT)
    assert instance_text(load, ROBOT.units) == "mass 5 kg, position (0, 0, 0.1) m"


def test_a_joint_that_moves_worse_is_said_first_and_not_explained(tmp_path: Path) -> None:
    """What is refused is the first sentence, the verdict is unknown, and both errors are in the
    file that is read."""
    errors = {
        "joint_1": ClosedLoopError(0.03, 0.003, "rad", alone=0.004),
        "joint_2": ClosedLoopError(0.0308, 0.0308, "rad", 0.1015),
        "joint_3": ClosedLoopError(0.002, 0.002, "rad", float("inf")),
    }
    scale = Imperfection("torque_scale", "joint_1", "1", 1.12, 0.04, 0.2, True, neutral=1.0)
    commanded = replace(diagnosis(cause()), made=("joint_1",), imperfections=(scale,))
    found = commanded.with_closed_loop(errors, ("joint_2", "joint_3"))
    first, second, *_ = summary(found)
    assert found.verdict == "unknown" and first.startswith(
        "unknown: With all corrections, the errors under the recorded commands increase"
    )
    assert "joint_2 to 102 mrad (30.8 mrad with the description)" in first
    assert "joint_3 until the simulation diverges" in first
    assert "The correction of joint_2 and joint_3 is not written" in first
    assert second.startswith(
        "According to the torques alone, joint 2 has dry friction of 6 Nm, which the model lacks"
    )
    assert second.endswith("neither robot.yaml nor the corrected file contains it.")
    written = found.to_dict()
    assert written["closed_loop"]["joint_1"] == {
        "described": 0.03,
        "corrected": 0.003,
        "alone": 0.004,
        "unit": "rad",
    }
    assert written["closed_loop"]["joint_3"]["refused"] is None
    assert written["torque_scale"] == {"joint_1": {"value": 1.12, "std": 0.04}}
    read = Diagnosis.load(found.save(tmp_path / "diagnosis.json"))
    assert (read.closed_loop, read.taken_back) == (found.closed_loop, found.taken_back)
    assert [one.rejected for one in read.causes] == [True]
    assert read.torque_scale == found.torque_scale and read.made == found.made


def test_a_scale_that_is_off_is_said_with_its_value() -> None:
    """A scale beyond two of its deviations has its value in the sentence, one within them has
    not."""
    scales = [
        Imperfection("torque_scale", joint, "1", value, 0.04, 0.2, True, neutral=1.0)
        for joint, value in (("joint_1", 1.15), ("joint_2", 1.02))
    ]
    found = replace(diagnosis(), made=("joint_1", "joint_2"), imperfections=tuple(scales))
    (words,) = [one for one in summary(found) if "kp" in one]
    assert "make 1.150 ± 0.040 times the described torque at joint_1: kp," in words
    assert "joint_2" not in words


def test_scales_that_disagree_are_both_said(tmp_path: Path) -> None:
    """A scale of the torques that the simulated motion contradicts is named with both values and
    deviations; scales that agree are only in the file."""

    def compared(motion: float) -> ComparedScale:
        torques = ParameterEstimate(1.15, 0.02, "1")
        return ComparedScale(torques, ParameterEstimate(motion, 0.01, "1"))

    scales = [
        Imperfection("torque_scale", joint, "1", 1.15, 0.02, 0.2, True, neutral=1.0)
        for joint in ("joint_1", "joint_2")
    ]
    both = {"joint_1": compared(1.21), "joint_2": compared(1.17)}
    found = replace(diagnosis(), made=("joint_1", "joint_2"), imperfections=tuple(scales))
    assert "disagree" not in scale_sentence(found)
    found = replace(found, compared_scales=both)
    words = scale_sentence(found)
    assert "disagree about the scale: 1.150 ± 0.020 and 1.210 ± 0.010 at joint_1. The" in words
    assert found.to_dict()["torque_scale"]["joint_2"] == {
        "value": 1.15,
        "std": 0.02,
        "of_torques": {"value": 1.15, "std": 0.02},
        "in_closed_loop": {"value": 1.17, "std": 0.01},
    }
    read = Diagnosis.load(found.save(tmp_path / "diagnosis.json"))
    assert read.compared_scales == both


def test_errors_that_no_joint_has_are_no_reason() -> None:
    """Where no joint moves worse the verdict stays, and the worst joint's errors are the last
    sentence."""
    errors = {
        "joint_1": ClosedLoopError(0.03, 0.003, "rad"),
        "joint_2": ClosedLoopError(0.01, 0.001, "rad"),
    }
    found = diagnosis(cause()).with_closed_loop(errors, ())
    first, *_, last = summary(found)
    assert first.startswith("explained: Joint 2 has dry friction") and "rejects" not in first
    assert found.verdict == "explained"
    assert (
        last
        == "Under the recorded commands the description has an error of 30 mrad at joint_1, the"
        " written correction 3 mrad."
    )
    errors["joint_1"] = replace(errors["joint_1"], alone=0.012)
    *_, last = summary(found.with_closed_loop(errors, ()))
    assert last.endswith(
        "3 mrad; the corrected MJCF alone, without the laws that only robot.yaml states, 12 mrad."
    )


def test_causes_that_the_closed_loop_rejects_do_not_hold_all_the_same() -> None:
    """An unknown with a rejected cause does not call the causes the answer."""
    place = UnexplainedResidual("joint_3", "motor", "load", 0.004)
    errors = {"joint_2": ClosedLoopError(0.0308, 0.0308, "rad", 0.1015)}
    found = unknown(place).with_closed_loop(errors, ("joint_2",))
    assert not any("hold all the same" in words for words in unknown_sentences(found))


def unknown(*places: UnexplainedResidual, share: float = 0.961, causes: int = 1) -> Diagnosis:
    """Return a diagnosis that leaves something at these places."""
    found = diagnosis(*[cause()] * causes)
    return replace(found, verdict="unknown", unexplained=places, shrink=share)


def test_an_unknown_says_what_it_is_owed_to_and_what_to_record() -> None:
    """A torque of 0.004 Nm at the last joint is named with its size, the causes keep their worth,
    and the motion fits what the residual follows."""
    place = UnexplainedResidual("joint_3", "motor", "load", 0.004)
    owed, worth, then = unknown_sentences(unknown(place))
    assert "because of 0.004 Nm at joint_3, motor side" in owed and "depends on the load" in owed
    assert "explain 96.1 % of the gap" in worth and "0.004 Nm" in worth
    assert "joint_3 alone" in then and "weight at the flange" in then


def test_an_unknown_of_several_places_begins_with_the_largest() -> None:
    """Other places follow by their joints, each once, and one without causes claims none."""
    places = [
        UnexplainedResidual("joint_2", "motor", "velocity_reversal", 0.5),
        UnexplainedResidual("joint_2", "link", "always", 0.3),
        UnexplainedResidual("joint_1", "motor", "drift", 0.1),
    ]
    owed, then = unknown_sentences(unknown(*places, causes=0))
    assert "0.5 Nm (noise 0.1) at joint_2" in owed and owed.endswith(
        "smaller unexplained residuals remain at joint_1."
    )
    assert "reversals" in then
    assert unknown_sentences(diagnosis(cause())) == []


def test_every_regime_has_a_motion_that_shows_it() -> None:
    """Whatever a residual follows, something is said of what to record."""
    assert set(SHOWN_BY) == {*REGIMES, "event"}


def test_a_servo_that_swings_on_its_gain_is_not_called_elastic() -> None:
    """Torques that were computed from commands have the spring of the controller."""
    (note,) = ringing_notes({"joint_1": 3.0, "joint_2": 12.0}, made=["joint_1"])
    assert "joint_2 has a resonance near 12 Hz" in note


def test_notes_of_several_recordings_are_one() -> None:
    """Where they differ by the name alone; sentences with a colon stay as they are."""
    notes = ["run_1: no torque.", "a note: with a colon", "run_2: no torque.", "run_3: other."]
    assert merged_notes(notes) == [
        "run_1 and run_2: no torque.",
        "a note: with a colon",
        "run_3: other.",
    ]


def test_friction_that_no_description_states_is_one_statement() -> None:
    """Every drive has friction: what a description lacks of it is one sentence, after what is the
    arm's own; what it states differently is a sentence each."""
    first = cause()
    sizes = {"torque": replace(first.parameters["torque"], value=2.0)}
    drives = [first, replace(first, joint="joint_3", parameters=sizes)]
    stated = replace(first, joint="joint_1", stated={"torque": 1.0})
    found = replace(diagnosis(first), causes=(*drives, stated))
    assert specific_first(found.causes) == [stated, *drives]
    opening, more, *_ = summary(found)
    assert "joint 1 has dry friction" in opening.lower()
    assert more == (
        "joint_2 and joint_3 have friction that the description does not state: coulomb friction"
        " of 2 to 6 Nm."
    )
    assert specific_first((first, stated)) == [first, stated]
