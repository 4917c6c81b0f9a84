"""Refitted diagnoses of realistic arms, recorded on an engine that shares nothing with the diagnosis."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import Robot, load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)


def refitted(seed: int, *extra: Fault, withheld: str = "") -> tuple[Diagnosis, list[Fault]]:
    """Diagnose an imprecise arm with ordinary friction and sensors, and with something more."""
    rng = np.random.default_rng(seed)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    first, judge = record(true, [*ordinary, *extra], (16.0, 8.0), rng)
    catalogue = Catalogue.default().withholding(withheld)
    return diagnose([first], Question(ROBOT, refit=True, given=FRICTION, catalogue=catalogue), [judge]), ordinary


@pytest.fixture(scope="module")
def ordinary_arm() -> tuple[Diagnosis, list[Fault], Robot]:
    """An arm with nothing more than ordinary errors: its diagnosis, what its sensors and joints have, and itself."""
    found, ordinary = refitted(31)
    return found, ordinary, imprecise(ROBOT, np.random.default_rng(31))


@pytest.mark.slow
def test_an_arm_that_is_only_ordinarily_wrong_has_no_cause(
    ordinary_arm: tuple[Diagnosis, list[Fault], Robot],
) -> None:
    """Wrong masses, stiffness, friction and sensors are found as such, and nothing is blamed."""
    found, ordinary, _ = ordinary_arm
    assert found.verdict == "none" and not found.causes
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["imperfections"]
    known = {(one.what, one.joint): one for one in found.imperfections}
    for fault in ordinary:
        if fault.effect.endswith("_offset"):
            one = known[fault.effect, ROBOT.joint_names[fault.joint or 0]]
            assert abs(one.value - fault.parameters["offset"]) < 4.0 * one.std + 0.02
            assert one.ordinary


@pytest.mark.slow
def test_a_common_scale_of_torques_and_inertias_is_as_uncertain_as_its_priors(
    ordinary_arm: tuple[Diagnosis, list[Fault], Robot],
) -> None:
    """Nothing but the priors of six gains tells the scale of torques, rotors and stiffnesses; joints differ by less."""
    found, ordinary, true = ordinary_arm
    known = {(one.what, one.joint): one for one in found.imperfections}
    values = {}
    for joint, described in zip(true.joints, ROBOT.joints, strict=True):
        now, was = joint.transmission, described.transmission
        assert now is not None and was is not None
        values["rotor_inertia", joint.name] = now.rotor.izz / was.rotor.izz
        values["stiffness", joint.name] = now.stiffness / was.stiffness
    for fault in ordinary:
        if fault.effect.endswith("_gain"):
            values[fault.effect, ROBOT.joint_names[fault.joint or 0]] = fault.parameters["gain"]
    gains = [one.prior_std for (what, _), one in known.items() if what.endswith("_gain")]
    common = np.sum(np.array(gains) ** -2.0) ** -0.5
    for key, value in values.items():
        assert abs(known[key].value - value) < 3.0 * known[key].std
        assert 0.9 * common < known[key].std / value < 1.5 * common
    ratios = [known["motor_torque_gain", name].value / values["motor_torque_gain", name] for name in ROBOT.joint_names]
    assert np.ptp(ratios) < 0.004


@pytest.mark.slow
def test_hysteresis_beside_ordinary_errors_is_named() -> None:
    """Memory of a drive is not swallowed by the refit of stiffness, damping and friction."""
    found, _ = refitted(32, Fault("hysteresis", 1, {"torque": 9.0, "width": 1.5e-4}))
    assert [(c.effect, c.joint) for c in found.causes] == [("hysteresis", "joint_2")]


@pytest.mark.slow
def test_a_lag_of_all_link_encoders_is_one_cause() -> None:
    """A delay of 2.6 ms on every joint's link encoder is reported once, to 1 %, and no eccentricity in its place."""
    found, _ = refitted(33, Fault("time_delay", None, {"delay": 2.6e-3}, channels=("link_encoder",)))
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("time_delay", None)
    assert cause.parameters["delay"].value == pytest.approx(2.6e-3, rel=0.01)
    assert found.verdict == "explained"


@pytest.mark.slow
def test_a_late_motor_torque_is_not_called_a_low_pass_for_sure() -> None:
    """Before either is refined both are the same column: the low pass, refined first, must not rule out the delay."""
    found, _ = refitted(50, Fault("time_delay", 1, {"delay": 2e-3}, channels=("motor_torque",)))
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("time_delay", "joint_2")
    assert cause.parameters["delay"].value == pytest.approx(2e-3, rel=0.01)
    assert [other.effect for other in cause.alternatives] == ["torque_lowpass"]


@pytest.mark.slow
def test_play_that_is_loaded_one_way_is_named_with_the_encoder_offset_that_it_may_be() -> None:
    """Play of a drive whose load keeps its sign is an encoder's zero nine standard deviations off: both are named."""
    found, _ = refitted(34, Fault("backlash", 2, {"half_gap": 9e-5}))
    (cause,) = found.causes
    names = {(cause.effect, cause.joint), *((other.effect, other.joint) for other in cause.alternatives)}
    assert names >= {("backlash", "joint_3"), ("encoder_offset", "joint_3")} and cause.confidence < 0.7
    assert cause.parameters["half_gap"].value == pytest.approx(9e-5, rel=0.1)
    (unnamed,) = refitted(34, Fault("backlash", 2, {"half_gap": 9e-5}), withheld="encoder_offset")[0].causes
    assert unnamed.effect == "backlash" and "encoder_offset" not in {other.effect for other in unnamed.alternatives}


@pytest.mark.slow
def test_a_payload_that_the_numbers_of_the_last_link_could_hold_is_named() -> None:
    """7 kg on a link of 18 kg are a payload, not a mass at six standard deviations of its prior."""
    place = {"position_x": 0.05, "position_y": 0.08, "position_z": -0.03}
    found, _ = refitted(35, Fault("payload", None, {"mass": 7.0, **place}))
    cause = next(one for one in found.causes if one.effect == "payload")
    mass, position = cause.parameters["mass"], cause.parameters["position"]
    assert abs(mass.value - 7.0) < 3.0 * mass.std
    distance = np.asarray(position.value) - list(place.values())
    assert (np.abs(distance) < 3.0 * np.asarray(position.std)).all()


@pytest.mark.slow
def test_stribeck_friction_is_not_taken_for_gains() -> None:
    """Gains of all torque sensors that scale the friction, masses down, would stand in for a Stribeck curve."""
    found, _ = refitted(36, Fault("stribeck_friction", 2, {"torque": 4.0, "speed": 0.05}))
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("stribeck_friction", "joint_3")
    assert cause.parameters["torque"].value == pytest.approx(4.0, rel=0.03)


@pytest.mark.slow
def test_a_faulty_gain_is_its_whole_size_and_leaves_the_others_ordinary() -> None:
    """A motor's torque read at 62 % is that, though its prior is 1.5 %; where it has no name, the answer is unknown."""
    rng = np.random.default_rng(37)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    faulty = [f for f in ordinary if (f.effect, f.joint) != ("motor_torque_gain", 2)]
    first, judge = record(true, [*faulty, Fault("motor_torque_gain", 2, {"gain": 0.62})], (16.0, 8.0), rng)
    found = diagnose([first], Question(ROBOT, refit=True, given=FRICTION), [judge])
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("motor_torque_gain", "joint_3")
    gain = cause.parameters["gain"]
    assert abs(gain.value - 0.62) < 3.0 * gain.std and gain.std < 0.01
    gains = {(one.what, one.joint): one.value for one in found.imperfections if one.what.endswith("_gain")}
    assert gains.pop(("motor_torque_gain", "joint_3")) == pytest.approx(gain.value)
    assert len(gains) == 5 and all(abs(value - 1.0) < 0.03 for value in gains.values())
    without = Question(ROBOT, refit=True, given=FRICTION, catalogue=Catalogue.default().withholding(cause.effect))
    unnamed = diagnose([first], without, [judge])
    assert unnamed.verdict == "unknown" and cause.effect not in {other.effect for other in unnamed.causes}


@pytest.mark.slow
def test_numbers_beyond_ordinary_are_causes_and_stand_in_the_corrected_arm() -> None:
    """A rotor of 60 % and a damping of three times are named at that size; nothing acts twice in robot.yaml."""
    rng = np.random.default_rng(38)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    gears = [joint.transmission for joint in true.joints]
    light, damped = gears[0], gears[1]
    assert light is not None and damped is not None
    rotor, wave = (
        replace(part, ixx=0.6 * part.ixx, izz=0.6 * part.izz) for part in (light.rotor, light.wave_generator)
    )
    joints = (
        replace(true.joints[0], transmission=replace(light, rotor=rotor, wave_generator=wave)),
        replace(true.joints[1], transmission=replace(damped, damping=3.0 * damped.damping)),
        true.joints[2],
    )
    first, judge = record(true.with_(joints=joints), ordinary, (16.0, 8.0), rng)
    found = diagnose([first], Question(ROBOT, refit=True, given=FRICTION), [judge])
    assert {(c.effect, c.joint) for c in found.causes} == {
        ("rotor_inertia_mismatch", "joint_1"),
        ("damping_mismatch", "joint_2"),
    }
    nominal = ROBOT.joints[0].transmission, ROBOT.joints[1].transmission
    assert nominal[0] is not None and nominal[1] is not None
    expected = {
        "inertia": rotor.izz / nominal[0].rotor.izz,
        "damping": joints[1].transmission.damping / nominal[1].damping,
    }
    for cause in found.causes:
        for name, estimate in cause.parameters.items():
            assert abs(estimate.value - expected[name]) < 3.0 * estimate.std
    corrected = repaired_robot(ROBOT, found)
    gear = corrected.joints[0].transmission
    assert gear is not None and gear.rotor.izz == pytest.approx(rotor.izz, rel=0.03)
    assert not {effect["effect"] for effect in corrected.effects} & {"rotor_inertia_mismatch", "damping_mismatch"}


def of_masses(*ratios: float, extra: tuple[Fault, ...] = ()) -> tuple[Diagnosis, Robot]:
    """Diagnose an arm whose links have these multiples of the masses described, 1 for ordinary ones."""
    rng = np.random.default_rng(39)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    joints = [
        joint
        if ratio == 1.0
        else replace(
            joint,
            link=replace(joint.link, mass=ratio * nominal.link.mass, inertia=ratio * np.asarray(nominal.link.inertia)),
        )
        for joint, nominal, ratio in zip(true.joints, ROBOT.joints, ratios, strict=True)
    ]
    first, judge = record(true.with_(joints=tuple(joints)), [*ordinary, *extra], (16.0, 8.0), rng)
    found = diagnose([first], Question(ROBOT, refit=True, given=FRICTION), [judge])
    return found, repaired_robot(ROBOT, found)


@pytest.mark.slow
def test_links_far_lighter_than_described_are_causes_though_other_links_could_hold_some_of_it() -> None:
    """Two masses of about half, each a cause by itself, are refitted in robot.yaml."""
    found, corrected = of_masses(1.0, 0.5, 0.55)
    assert found.verdict == "explained"
    named = {(cause.effect, cause.joint): cause for cause in found.causes}
    assert set(named) == {("link_inertia_mismatch", "joint_2"), ("link_inertia_mismatch", "joint_3")}
    for (_, joint), ratio in zip(sorted(named), (0.5, 0.55), strict=True):
        cause = named["link_inertia_mismatch", joint]
        mass, k = cause.parameters["mass"], ROBOT.joint_names.index(str(joint))
        assert abs(mass.value - ratio) < 3.0 * mass.std and mass.std < 0.05 and cause.confidence > 0.9
        assert corrected.joints[k].link.mass == pytest.approx(mass.value * ROBOT.joints[k].link.mass, rel=0.02)
    assert "link_inertia_mismatch" not in {effect["effect"] for effect in corrected.effects}


@pytest.mark.slow
def test_a_payload_near_the_last_links_centre_of_mass_is_an_alternative_to_its_mass() -> None:
    """7 kg there do little that a heavier link would not: both are said, and neither for sure."""
    place = {"position_x": 0.48, "position_y": 0.0, "position_z": 0.03}
    found, _ = of_masses(1.0, 1.0, 1.0, extra=(Fault("payload", None, {"mass": 7.0, **place}),))
    (cause,) = found.causes
    shares = {cause.effect: cause.confidence, **{other.effect: other.confidence for other in cause.alternatives}}
    assert set(shares) == {"link_inertia_mismatch", "payload"} and shares["payload"] > 0.05
    assert all(share < 0.95 for share in shares.values())
