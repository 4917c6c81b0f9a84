"""The diagnosis, from recordings of arms that another engine simulated to verdict, causes and shrink."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.effects import EFFECTS
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import DiagnosisError, ElasticArmError
from elastic_arm.recording import Recording
from elastic_arm.report.diagnosis import write_gap_report
from elastic_arm.robot import load_robot, save_robot
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from tests.helpers.hidden_arms import fault, recordings

pytestmark = pytest.mark.slow(4)

ROBOT = load_robot(None)
COULOMB = ("coulomb_friction", 1, "motor", "torque", 6.0)
ERROR = ("transmission_error", 0, "motor", "amplitude", 2e-5, "phase", 0.7, "order", 2.0)


def asked(pair: tuple[Recording, Recording], **question: object) -> Diagnosis:
    return diagnose([pair[0]], Question(ROBOT, **question), [pair[1]])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "instruments",
    [SensorModel(), SensorModel(encoder_noise=5e-6), SensorModel(encoder_step=6e-6, jitter=2e-5)],
    ids=["exact encoders", "noisy encoders", "quantised and jittered"],
)
def test_clean_arm_has_no_cause(instruments: SensorModel) -> None:
    """A recording of the nominal arm is called `none`, whatever its sensors."""
    found = asked(recordings(instruments=instruments))
    assert (found.verdict, found.causes, found.shrink) == ("none", (), None)


def test_residuals_of_a_clean_arm_are_as_large_as_the_noise_says() -> None:
    """The noise estimated from the channels is that of each residual, within its sampling error."""
    found = asked(recordings(instruments=SensorModel(encoder_noise=3e-6)))
    for place, noise in found.noise.items():
        assert found.before.rmse[place] == pytest.approx(noise, rel=0.12)


def test_coulomb_friction_is_named_placed_and_sized() -> None:
    """Friction on motor 2 is the one cause, its interval holds the truth, and the gap is gone on another motion."""
    found = asked(recordings(COULOMB, instruments=SensorModel(encoder_noise=1e-6)))
    assert found.verdict == "explained"
    assert [(c.effect, c.joint, c.sides) for c in found.causes] == [("coulomb_friction", "joint_2", ("motor",))]
    torque = found.causes[0].parameters["torque"]
    assert abs(torque.value - 6.0) < 4 * torque.std < 1.0
    assert found.shrink is not None and found.shrink > 0.95
    assert found.causes[0].confidence > 0.9


def test_transmission_error_is_one_cause_in_two_equations() -> None:
    """What acts in drive and motor equation is one cause."""
    found = asked(recordings(ERROR))
    assert [(c.effect, c.joint, c.sides) for c in found.causes] == [
        ("transmission_error", "joint_1", ("drive", "motor"))
    ]


def test_effect_out_of_the_catalogue_is_unknown_at_its_place() -> None:
    """Without its effect in the catalogue the verdict is `unknown`, at the right joint, side and regime."""
    rest = tuple(e for e in EFFECTS.values() if e.id != "transmission_error")
    found = asked(recordings(ERROR), effects=rest)
    assert found.verdict == "unknown"
    assert (found.unexplained[0].joint, found.unexplained[0].side) == ("joint_1", "drive")
    assert found.unexplained[0].regime == "wave_generator_angle"


@pytest.mark.parametrize(
    ("effect", "joint", "name", "value"),
    [
        ("joint_torque_gain", 2, "gain", 1.03),
        ("motor_torque_offset", 0, "offset", 0.5),
        ("encoder_eccentricity", 1, "amplitude", 3e-5),
    ],
)
def test_sensor_fault_competes_with_physics(effect: str, joint: int, name: str, value: float) -> None:
    """A faulty sensor is named as such."""
    more = ("phase", 0.4) if effect == "encoder_eccentricity" else ()
    found = asked(recordings(sensors=(fault(effect, joint, "motor", name, value, *more),)))
    assert (found.causes[0].effect, found.causes[0].joint) == (effect, f"joint_{joint + 1}")
    assert found.causes[0].parameters[name].value == pytest.approx(value, rel=0.1)


def test_two_sensor_faults_are_both_named() -> None:
    """Two causes at once are told apart."""
    faults = (
        fault("motor_torque_gain", 1, "motor", "gain", 1.01),
        fault("joint_torque_offset", 1, "motor", "offset", 0.6),
    )
    found = asked(recordings(sensors=faults))
    assert {c.effect for c in found.causes} == {"motor_torque_gain", "joint_torque_offset"}


def test_lag_of_one_sample_is_no_cause_and_of_four_is() -> None:
    """A channel one sample late is aligned in silence; four samples late it is a delay."""

    def late(recording: Recording, k: int) -> Recording:
        assert recording.link is not None and recording.link.effort is not None
        effort = np.vstack([np.repeat(recording.link.effort[:1], k, axis=0), recording.link.effort[:-k]])
        return replace(recording, link=replace(recording.link, effort=effort))

    pair = recordings()
    one, four = (asked((late(pair[0], k), late(pair[1], k))) for k in (1, 4))
    assert one.verdict == "none" and not one.causes
    assert [(c.effect, c.joint) for c in four.causes] == [("time_delay", None)]
    assert four.causes[0].parameters["delay"].value == pytest.approx(0.004, rel=0.1)


def test_missing_sensors_leave_what_the_rest_can_say() -> None:
    """Without joint torque sensors, or with the motor side alone, friction is still found."""
    pair = recordings(COULOMB, instruments=SensorModel(encoder_noise=1e-6))
    without = tuple(replace(r, link=replace(r.link, effort=None)) for r in pair)  # type: ignore[type-var]
    alone = tuple(replace(r, link=None) for r in pair)
    for given, missing in ((without, {"drive"}), (alone, {"link", "drive"})):
        found = asked(given)  # type: ignore[arg-type]
        assert [(c.effect, c.joint) for c in found.causes] == [("coulomb_friction", "joint_2")]
        sizes = found.to_dict()["gap"]["before"]["joint_2"]
        assert {side for side, size in sizes.items() if size is None} == missing


@pytest.mark.parametrize(
    ("model", "expected"), [("mod1", {"inertia_coupling", "spline_inertia"}), ("mod2", {"inertia_coupling"})]
)
def test_what_simpler_models_lack_is_named(model: str, expected: set[str]) -> None:
    """Against mod1 and mod2 the plain arm shows the missing S and the folded spline, and nothing else."""
    assert {c.effect for c in asked(recordings(), model=model).causes} == expected


def test_known_effect_counts_as_part_of_the_model() -> None:
    """With --with the friction that the user knows is fitted first, and nothing is left to explain."""
    pair = recordings(COULOMB, instruments=SensorModel(encoder_noise=1e-6))
    found = asked(pair, given=known_effects(["coulomb_friction:joint_2"], ROBOT))
    assert (found.verdict, found.causes) == ("none", ())


@pytest.mark.parametrize("scale", [0.1, 0.4])
def test_bearings_that_tilt_are_named_alone(scale: float) -> None:
    """An arm whose bearings give way in another engine: that and nothing else, the stiffness within a tenth."""
    soft = ("bearing_compliance", None, "motor", "stiffness_scale", scale)
    found = asked(recordings(soft))
    assert [c.effect for c in found.causes] == ["bearing_compliance"]
    assert found.verdict == "explained" and found.shrink is not None and found.shrink > 0.95
    assert found.causes[0].parameters["stiffness_scale"].value == pytest.approx(scale, rel=0.1)


def test_refit_leaves_structure() -> None:
    """A wrong torque gain of the model's own numbers goes into the refit; friction stays a cause."""
    found = asked(recordings(COULOMB, instruments=SensorModel(encoder_noise=1e-6)), refit=True)
    assert [(c.effect, c.joint) for c in found.causes] == [("coulomb_friction", "joint_2")]


def test_result_is_what_the_contract_says(tmp_path: Path) -> None:
    """The file loads, holds the contract's fields, and the arm with the causes in it loads as well."""
    found = asked(recordings(COULOMB, instruments=SensorModel(encoder_noise=1e-6)))
    data = json.loads(found.save(tmp_path / "diagnosis.json").read_text())
    assert data["schema"] == "elastic_arm/diagnosis/1"
    assert set(data["recordings"]) == {"identify", "validate", "independent_motion"}
    assert data["recordings"]["independent_motion"] is True
    assert set(data["gap"]["after"]["joint_1"]["link"]) == {"rmse", "max"}
    assert set(data["causes"][0]) == {
        "effect", "joint", "sides", "regime", "parameters", "shrink", "minor", "stands_in", "held_as", "confidence",
        "alternatives",
    }  # fmt: skip
    low, high = data["shrink_interval"]
    assert low <= data["shrink"] <= high
    save_robot(repaired_robot(ROBOT, found), tmp_path / "robot.yaml")
    assert load_robot(tmp_path / "robot.yaml").effects[0]["effect"] == "coulomb_friction"
    page = write_gap_report(tmp_path / "report.html", found).read_text()
    assert "coulomb_friction" in page and "<svg" in page


def test_unusable_recordings_are_refused_with_a_reason() -> None:
    """No torque, no motion, too short, and judging itself: each is refused in its own words."""
    fitted, judge = recordings()
    assert fitted.motor is not None and fitted.link is not None
    silent = replace(fitted, link=replace(fitted.link, effort=None), motor=replace(fitted.motor, effort=None))
    rest = replace(
        fitted,
        link=replace(fitted.link, position=0 * fitted.link.position),  # type: ignore[operator]
        motor=replace(fitted.motor, position=0 * fitted.motor.position),  # type: ignore[operator]
    )
    for given, validate, word in (
        ([silent], [judge], "no torque"),
        ([rest], [judge], "no motion"),
        ([fitted.between(0.0, 3.0)], [], "too short"),
        ([fitted], [fitted], "also what is fitted"),
        ([], [], "no recording"),
    ):
        with pytest.raises(DiagnosisError, match=word):
            diagnose(given, Question(ROBOT), validate)


def test_periodic_motion_is_said_not_to_be_independent() -> None:
    """A third that repeats the rest of the recording judges nothing new, and the result says so."""
    from elastic_arm.diagnosis.data.split import independent
    from elastic_arm.diagnosis.settings import SplitSettings

    fitted, judge = recordings()
    settings = SplitSettings()
    assert independent([fitted], [judge], settings)
    assert not independent([fitted], [fitted.between(2.0, 6.0)], settings)


def test_unknown_effects_given_by_the_user_are_refused() -> None:
    """--with names what exists."""
    for text in ("coulomb_frction", "coulomb_friction:joint_9", "coulomb_friction:joint_1:mass=3"):
        with pytest.raises(ElasticArmError):
            known_effects([text], ROBOT)
