"""Servos whose duty was recorded: the electrics are judged, and the firmware is not needed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.diagnosis.words import scale_sentence
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.effect import ControllerEffect
from elastic_arm.equations.places import features
from elastic_arm.errors import DiagnosisError
from elastic_arm.excitation import MotionLimits, random_trajectories
from elastic_arm.identification import identify
from elastic_arm.recording import Side
from elastic_arm.recording.made_torque import with_recorded_duty
from elastic_arm.robot import JointController, Robot
from elastic_arm.simulation import SimulationSettings, simulate
from tests.diagnosis.test_armature import rigid
from tests.helpers.duty_servo import described, recorded
from tests.helpers.nightly import nightly

OF_SERVOS = [
    "coulomb_friction",
    "viscous_friction",
    "load_dependent_friction",
    "payload",
    "position_gain",
    "velocity_gain",
    "command_delay",
    "position_dead_band",
    "supply_sag",
    "torque_constant",
]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return described(tmp_path_factory.mktemp("arm"))


@pytest.fixture(params=[OF_SERVOS, *nightly([None])], ids=["few", "all"])
def effects(request: pytest.FixtureRequest) -> list[str] | None:
    """The candidates: None for the whole catalogue."""
    return request.param  # type: ignore[no-any-return]


def answer(arm: Robot, effects: list[str] | None, **true: float) -> Diagnosis:
    runs = [recorded(seed, **true) for seed in (0, 1)]
    return diagnose(runs[:1], Question(arm, effects=effects), runs[1:])


def test_a_firmware_that_nobody_described_is_no_cause(
    arm: Robot, effects: list[str] | None, tmp_path: Path
) -> None:
    """The true firmware has a fifth of the described kp, another dead band and late commands."""
    found = answer(arm, effects)
    assert (found.verdict, found.causes) == ("none", ())
    assert "recorded duty (pwm) with the described electrics" in scale_sentence(found)
    assert "controllers" not in scale_sentence(found)
    read = Diagnosis.load(found.save(tmp_path / "diagnosis.json"))
    assert read.of_duty == found.of_duty == ("servo",) and read.made == ("servo",)


def test_another_torque_constant_is_named_and_written(
    arm: Robot, effects: list[str] | None
) -> None:
    """Its size is exact, and the corrected arm has the described firmware with other electrics."""
    found = answer(arm, effects, per_volt=0.17)
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("torque_constant", "servo")
    assert cause.parameters["gain"].value == pytest.approx(1.7, rel=2e-3)
    (stated,) = (joint.controller for joint in arm.joints)
    (written,) = (joint.controller for joint in repaired_robot(arm, found).joints)
    assert stated is not None
    assert written is not None
    for name in ("kp", "kd", "stall"):
        assert getattr(written, name) == pytest.approx(1.7 * getattr(stated, name), rel=2e-3)
    assert replace(written, kp=stated.kp, kd=stated.kd, stall=stated.stall) == stated


def test_a_supply_that_sags_is_named(arm: Robot, effects: list[str] | None) -> None:
    """Its size comes out to 2 %."""
    found = answer(arm, effects, sag=0.25)
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("supply_sag", "servo")
    assert cause.parameters["share"].value == pytest.approx(0.25, rel=0.02)


def test_a_recorded_supply_voltage_takes_the_place_of_the_stated_one(
    arm: Robot, effects: list[str] | None
) -> None:
    """Of a battery that loses a third of its voltage, recorded in steps of 0.1 V, the description
    is right as it is; without the voltage its torques are 0.13 Nm off."""
    runs = [recorded(seed, falls=0.33) for seed in (0, 1)]
    question = Question(arm, effects=effects)
    place = "servo", "motor"
    found = diagnose(runs[:1], question, runs[1:])
    assert not found.causes and found.before.rmse[place] < 0.02
    assert found.torque_scale["servo"].value == pytest.approx(1.0, abs=1e-3)
    assert any("of the recorded supply voltage" in note for note in found.notes)
    blind = [replace(run, motor=replace(run.motor, supply=None)) for run in runs]
    other = diagnose(blind[:1], question, blind[1:])
    assert other.before.rmse[place] > 5.0 * found.before.rmse[place]
    assert other.torque_scale["servo"].value < 0.95


def test_effects_of_commands_are_not_offered(arm: Robot) -> None:
    """Of the controller's effects only those of the electrics act, and a known one of commands is
    refused."""
    of_controllers = [e for e in EFFECTS.values() if isinstance(e, ControllerEffect)]
    runs = [recorded(seed, seconds=10.0) for seed in (0, 1)]
    driven = with_recorded_duty(arm, runs)
    acting = {one.effect.id for one in features(ArmEquations(driven), of_controllers)}
    assert acting == {"velocity_gain", "supply_sag", "torque_constant"}
    given = parse("command_delay:servo:delay=0.02", arm)
    with pytest.raises(DiagnosisError, match="command_delay acts on commands"):
        diagnose(runs[:1], Question(arm, given=[given]), runs[1:])


def test_a_duty_of_one_joint_stands_beside_measured_torques() -> None:
    """The others keep their sensors; the torque constant of that joint is found exactly."""
    arm = rigid()
    drive = JointController(kp=30.0, kd=2.0, stall=400.0)
    rng = np.random.default_rng(0)
    motions = random_trajectories(build_model(arm), MotionLimits.of(arm), 2, rng=rng)
    settings = SimulationSettings(nominal=arm)
    runs = []
    for motion in motions:
        run = simulate(arm, motion, settings, rng=rng)
        t = (run.motor.stamp_ns - run.motor.stamp_ns[0]) * 1e-9
        speed = CubicSpline(t, run.motor.position[:, 1])(t, 1)
        duty, effort = np.full_like(run.motor.effort, np.nan), run.motor.effort.copy()
        duty[:, 1] = (effort[:, 1] / 1.6 + drive.kd * speed) / drive.stall
        effort[:, 1] = np.nan
        motor = replace(run.motor, effort=effort, pwm=duty)
        runs.append(replace(run, motor=motor, reference=None))
    effects = ["coulomb_friction", "torque_constant", "supply_sag", "position_gain"]
    question = Question(arm.with_joint("joint_2", controller=drive), effects=effects)
    found = diagnose(runs[:1], question, runs[1:])
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("torque_constant", "joint_2")
    assert cause.parameters["gain"].value == pytest.approx(1.6, rel=1e-3)
    assert scale_sentence(found).startswith("no torque of joint_2 was recorded")


def test_an_identification_takes_the_duty(arm: Robot) -> None:
    """Friction and weight come out as they are."""
    found = identify([recorded(0), recorded(1)], arm)
    values = {one.name: one for one in found.estimates}
    weight = values["rod.mz"]
    assert weight.value == pytest.approx(-0.05, abs=max(3.0 * weight.std, 5e-4))
    assert weight.std < 2e-3


def test_the_duty_decides_although_commands_were_recorded(arm: Robot) -> None:
    """Commands that no drive received change nothing but the closed loop."""
    runs = [recorded(seed) for seed in (0, 1)]
    told = [
        replace(run, reference=Side(run.link.stamp_ns, position=np.zeros((len(run.link), 1))))
        for run in runs
    ]
    one = Question(arm, effects=["coulomb_friction"])
    assert diagnose(told[:1], one, told[1:]).after == diagnose(runs[:1], one, runs[1:]).after
