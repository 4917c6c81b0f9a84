"""The levels workshop and field of the challenge: what is drawn, what is recorded, and how answers are scored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from typer.testing import CliRunner

from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.errors import SimulationError
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge import campaign
from elastic_arm.studies.blind_challenge.arm_sampling import SamplingRequest, shares
from elastic_arm.studies.blind_challenge.command import challenge_app
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import as_urdf, imprecise, industrial_arm, strained
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import KNOWN, Fault
from elastic_arm.studies.blind_challenge.hidden_arms.further_laws import FOREIGN
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import (
    LINK,
    MOTOR,
    RealisticSensors,
    _noise,
    measure_realistically,
)
from elastic_arm.studies.blind_challenge.levels.answers import expected_unknown, score_realistic_answer
from elastic_arm.studies.blind_challenge.levels.foreign_sampling import sample_foreign, sized_foreign
from elastic_arm.studies.blind_challenge.levels.information import MarginalInformation, _alterations
from elastic_arm.studies.blind_challenge.levels.level import (
    FIELD,
    FLOORS,
    FOREIGN_FLOORS,
    LABORATORY_EFFECTS,
    WORKSHOP,
    drawn_effects,
)
from elastic_arm.studies.blind_challenge.levels.recording import channels_path, description_path
from elastic_arm.studies.blind_challenge.levels.sizing import ITSELF

ROBOT = load_robot(None)


def test_the_laboratory_draws_the_same_effects_whatever_the_catalogue_holds() -> None:
    """New effects of the package leave the laboratory's arms as they are; those that a user adds are drawn."""
    assert drawn_effects(tuple(EFFECTS), "laboratory") == LABORATORY_EFFECTS
    assert drawn_effects((*EFFECTS, "of_a_user"), "laboratory") == (*LABORATORY_EFFECTS, "of_a_user")
    assert set(FLOORS) <= KNOWN and not set(FOREIGN) & set(EFFECTS)


def test_effects_that_are_stated_alone_are_not_drawn() -> None:
    """What no diagnosis looks for is no hidden effect: the whole catalogue draws what that of the library draws."""
    settings = campaign.ChallengeSettings(seed=23, per_effect=1, clean=4, pairs=4)
    assert settings.requests(Catalogue.default()) == settings.requests(EFFECTS)


@pytest.mark.parametrize("amounts", [[0.0], [0.0, 0.0]])
def test_what_does_not_show_has_equal_shares(amounts: list[float]) -> None:
    """Effects of no catalogue have no bound, and a share that is not a number would be in the truth."""
    assert shares(amounts) == pytest.approx(np.full(len(amounts), 1.0 / len(amounts)))


def test_two_effects_at_once_show_with_the_sensors_of_one_arm() -> None:
    """Of field arms with one side recorded, both effects of a pair act on that side."""
    requests = campaign.ChallengeSettings(seed=5, level="field", per_effect=0, clean=0, pairs=100).requests()
    assert all(FIELD.common_sides(request.effects) for request in requests)
    assert len({request.effects for request in requests}) > 50


@pytest.mark.parametrize("effect", sorted(FOREIGN))
def test_an_effect_of_no_catalogue_changes_what_is_recorded(effect: str) -> None:
    """Each of the ten moves the arm, or its readings, by more than rounding, and Pinocchio confirms every run."""
    rng = np.random.default_rng(2)
    motion = random_motion(rng, 3, 4.0)
    plain = HiddenArm(ROBOT).run(motion)
    fault = sample_foreign(effect, 3, 4.0, rng)
    sized = sized_foreign(fault, FOREIGN_FLOORS[effect].amount, lambda: np.abs(plain.tau_m).max(axis=0))
    arm = HiddenArm(ROBOT, [sized])
    sensors = RealisticSensors((0.0,) * 3, link_bits=40, motor_bits=40, jitter=0.0)
    read = [
        measure_realistically(course, ROBOT.joint_names, faults, sensors, np.ones(3), np.random.default_rng(0))
        for course, faults in ((plain, ()), (arm.run(motion), arm.faults))
    ]
    changes = [np.abs(getattr(read[1], s).effort - getattr(read[0], s).effort).max() for s in ("link", "motor")]
    assert max(changes) > 1e-3


def test_the_larger_set_of_equations_without_its_effects_is_the_smaller_one() -> None:
    """An arm with a spring of no stiffness moves as the plain one does."""
    motion = random_motion(np.random.default_rng(3), 3, 2.0)
    none = Fault("joint_spring", 1, {"stiffness": 0.0, "rest": 0.0})
    first, second = HiddenArm(ROBOT).run(motion), HiddenArm(ROBOT, [none]).run(motion)
    assert np.abs(first.q - second.q).max() < 1e-12


def test_an_arm_read_from_its_urdf_moves_as_the_arm_does() -> None:
    """Base arms of six joints keep mass matrix and gravity when they pass through a URDF."""
    arm = industrial_arm(6, np.random.default_rng(4))
    x, dx, ddx = (0.3 * np.random.default_rng(5).standard_normal((3, 12)) for _ in range(3))
    torques = [KinematicTree(robot).torque(x[0], dx[1], ddx[2]) for robot in (arm, as_urdf(arm))]
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-6)


def test_a_strained_body_stays_one_and_gains_products_of_inertia() -> None:
    """The moments of a rod stretched along itself grow across it by twice the strain; shear makes a product."""
    rod = np.diag([0.0, 1.0, 1.0])
    along, sheared = np.zeros((3, 3)), np.zeros((3, 3))
    along[0, 0], sheared[1, 0] = 0.01, 0.01
    assert strained(rod, along) == pytest.approx(np.diag([0.0, 1.0201, 1.0201]))
    assert strained(rod, sheared)[0, 1] == pytest.approx(-0.01)
    principal = np.sort(np.linalg.eigvalsh(strained(rod, along + sheared)))
    assert principal[0] > -1e-15 and principal[2] <= principal[0] + principal[1] + 1e-12


def test_a_bound_counts_what_is_ordinary() -> None:
    """An offset of 0.5 Nm is 1.7 ordinary deviations of its own prior, and some ten bounds without it."""
    rng = np.random.default_rng(1)
    real = imprecise(ROBOT, rng)
    course = HiddenArm(real, geometry=ROBOT).run(random_motion(rng, 3, 10.0))
    information = MarginalInformation(real, RealisticSensors((0.26,) * 3), course)
    change = np.zeros((len(course.t[::10]), 3, 3))
    change[:, 2, 1] = 0.5
    key = ("motor_torque_offset", 1)
    assert information.distance(change) == pytest.approx(0.5 / 0.3, rel=0.02)
    # A zero of the motor differs from one of the joint torque sensor by the spring's equation alone, in which a zero of
    # an encoder does the same.
    assert information.distance(change, without=[key]) == pytest.approx(9.5, rel=0.1)
    assert 20.0 < information.distance(change, without=[key, ("encoder_offset", 1)]) < 0.5 / 0.26 * 100.0


def test_a_link_that_is_heavier_is_known_by_its_own_numbers_alone() -> None:
    """Its inertia goes with its mass: what is ordinary of its shape does not stand against it."""
    own = ITSELF["link_inertia_mismatch"]
    numbers = {what for what, _, _ in _alterations(ROBOT, 1)}
    assert set(own) < numbers and numbers - set(own) == {"com_x", "com_y", "com_z", "rotor"}


def test_zeros_of_torques_wander_about_their_offsets() -> None:
    """The mean of a channel's noise over a recording is that of white noise, however far its zero walks."""
    sensors = RealisticSensors((0.26,) * 3, drift=1.0)
    noise = _noise(sensors, 20_000, np.random.default_rng(2))
    assert np.all(np.abs(noise.mean(axis=0)) < 4.0 * 0.26 / np.sqrt(20_000))
    assert np.ptp(noise[:, 0].reshape(20, 1000).mean(axis=1)) > 0.1


def test_sides_that_jitter_apart_are_sampled_where_their_stamps_say() -> None:
    """The stamps of the two sides differ by some 28 µs, and each angle is that of its own stamp."""
    rng = np.random.default_rng(7)
    course = HiddenArm(ROBOT).run(random_motion(rng, 3, 3.0))
    sensors = RealisticSensors((0.0,) * 3, link_bits=40, motor_bits=40, apart=True)
    read = measure_realistically(course, ROBOT.joint_names, (), sensors, np.ones(3), rng)
    assert read.link is not None and read.motor is not None
    apart = (read.motor.stamp_ns - read.link.stamp_ns) * 1e-9
    assert np.std(apart) == pytest.approx(np.sqrt(2) * 2e-5, rel=0.1)
    for side, true in ((read.link, course.q), (read.motor, course.theta)):
        t = (side.stamp_ns - 1_700_000_000_000_000_000) * 1e-9
        np.testing.assert_allclose(side.position, CubicSpline(course.t, true)(t), atol=1e-9)


def test_realistic_sensors_leave_out_a_side_and_thin_out_samples() -> None:
    """At 100 Hz with the motor side alone no link is there, angles stand on the encoder's steps, torques are means.

    A mean is over the interval that is centred on its stamp: of ten samples, with half of the eleventh at either end.
    """
    rng = np.random.default_rng(6)
    course = HiddenArm(ROBOT).run(random_motion(rng, 3, 3.0))
    sensors = RealisticSensors((1e-9,) * 3, rate=100.0, sides=MOTOR, jitter=0.0)
    read = measure_realistically(course, ROBOT.joint_names, (), sensors, np.full(3, 100.0), rng)
    assert read.link is None and read.motor is not None
    assert read.motor.position is not None and read.motor.effort is not None
    turns = read.motor.position / (2 * np.pi / 2**13 / 100.0)
    assert np.abs(turns - np.round(turns)).max() < 1e-6
    assert np.median(np.diff(read.motor.stamp_ns)) == 10_000_000
    inner, ends = course.tau_m[36:45].sum(axis=0), course.tau_m[[35, 45]].mean(axis=0)
    np.testing.assert_allclose(read.motor.effort[3], (inner + ends) / 10.0, atol=1e-6)


@pytest.mark.slow(20)
def test_a_field_arm_is_recorded_with_its_description_and_read_back(tmp_path: Path) -> None:
    """Bags, URDF with overlay and channel map of an arm are complete: torque sensors are read as such."""
    settings = campaign.ChallengeSettings(
        seed=1, per_effect=0, clean=2, pairs=0, seconds=4.0, validate_seconds=4.0, level="field"
    )
    campaign.create(tmp_path, settings)
    question = campaign.load_manifest(tmp_path)["question"]
    assert question["with"] == ["coulomb_friction", "viscous_friction"]
    assert question["priors"] == {"sensors": {"motor_torque_gain": 0.15}}
    for item in campaign.load_manifest(tmp_path)["items"]:
        path, channels = description_path(tmp_path, item["name"]), channels_path(tmp_path, item["name"])
        assert path is not None
        robot = load_robot(path)
        read = read_recording(tmp_path / "bags" / f"{item['name']}_identify", channels, robot.joint_names)
        assert robot.elastic and robot.n in (6, 7)
        assert (read.link is None) == (channels is None) and (read.motor is None) == (channels is not None)


@pytest.mark.slow(20)
def test_the_baseline_answers_in_the_same_table(tmp_path: Path) -> None:
    """Plain least squares with BIC stands beside the diagnosis in the table of its level."""
    settings = campaign.ChallengeSettings(
        seed=2, per_effect=1, clean=1, pairs=0, seconds=6.0, validate_seconds=4.0, level="workshop",
        effects=("joint_torque_offset",),
    )  # fmt: skip
    campaign.create(tmp_path, settings)
    assert campaign.solve(tmp_path, kind=campaign.BASELINE) == {}
    for name in ("arm_0000", "arm_0001"):
        own = campaign.answer_path(tmp_path, name)
        own.parent.mkdir(exist_ok=True)
        own.write_text(campaign.answer_path(tmp_path, name, campaign.BASELINE).read_text())
    said = CliRunner().invoke(challenge_app, ["score", str(tmp_path)])
    assert said.exit_code == 0, said.output
    assert "level workshop" in said.output and "least squares" in said.output


def _entry(**changes: Any) -> dict[str, Any]:
    ordinary = {"effect": "coulomb_friction", "joint": 0, "parameters": {"torque": 5.0}, "side": "motor"}
    entry = {
        "name": "a", "model": "mod3", "level": "workshop", "faults": [], "foreign": [], "conditions": [],
        "ordinary": [ordinary], "numbers": [["stiffness", 1, 1.05]], "multiple": [], "bound": [], "share": [],
        "instruments": {"encoder_noise": 0.0}, "sensors": {"torque_noise": [0.26] * 3, "sides": LINK}, "visible": True,
    }  # fmt: skip
    return entry | changes


def _answer(*causes: dict[str, Any], **changes: Any) -> dict[str, Any]:
    answer = {"verdict": "explained" if causes else "none", "causes": list(causes), "unexplained": [], "shrink": None}
    return answer | changes


def _cause(effect: str, joint: str, confidence: float) -> dict[str, Any]:
    return {
        "effect": effect, "joint": joint, "confidence": confidence, "sides": ["motor"], "parameters": {},
        "alternatives": [],
    }  # fmt: skip


def test_a_false_cause_counts_by_its_confidence_and_a_condition_of_the_level_is_none() -> None:
    """A cause that no arm had accuses it from 0.9 on; what every arm of the level has beyond the ordinary does not."""
    drift = {"effect": "torque_drift", "joint": 2, "parameters": {"rate": 0.01}, "side": "motor"}
    entry = _entry(conditions=[drift])
    sure = score_realistic_answer(entry, _answer(_cause("backlash", "joint_1", 0.95)))
    unsure = score_realistic_answer(entry, _answer(_cause("backlash", "joint_1", 0.6)))
    own = score_realistic_answer(entry, _answer(_cause("torque_drift", "joint_3", 0.99)))
    assert [x["accused"] for x in (sure, unsure, own)] == [True, False, False]
    assert [x["no_cause"] for x in (sure, unsure, own)] == [False, False, True]


def test_intervals_of_friction_and_numbers_are_held_against_the_truth() -> None:
    """Of two stated intervals, one holds its true value: the friction's does, the stiffness' does not."""
    friction = {"effect": "coulomb_friction", "joint": "joint_1", "parameters": {"torque": {"value": 5.1, "std": 0.1}}}
    stiffness = {"what": "stiffness", "joint": "joint_2", "value": 1.0, "std": 0.01}
    line = score_realistic_answer(_entry(), _answer(known=[friction], imperfections=[stiffness]))
    assert line["coverage"]["frictions"] == [1, 1] and line["coverage"]["numbers"] == [0, 1]


def test_none_is_right_only_where_an_effect_of_no_catalogue_cannot_be_seen() -> None:
    """The challenge's own bound decides, not the diagnosis."""
    foreign = [{"effect": "oil_drag", "joint": 0, "parameters": {}, "side": "motor"}]
    seen, unseen = (score_realistic_answer(_entry(foreign=foreign, visible=v), _answer()) for v in (True, False))
    assert not expected_unknown(seen) and expected_unknown(unseen)


def test_an_arm_that_no_simulation_gets_through_is_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the engine leaves the finite numbers, the same arm is drawn from another seed."""
    seeds: list[tuple[int, ...]] = []

    def record(folder: Path, bags: object, request: SamplingRequest, *_: object) -> dict[str, object]:
        seeds.append(request.seed)
        if len(seeds) < 3:
            raise SimulationError("the hidden arm left the finite numbers", "Draw smaller effects")
        return {"name": request.name}

    monkeypatch.setattr(campaign, "record_realistic_arm", record)
    request = SamplingRequest("arm", (), (7, 1), (2.0, 1.0))
    assert campaign._recorded(tmp_path, request, WORKSHOP, EFFECTS) == {"name": "arm"}
    assert len(set(seeds)) == 3 and seeds[0] == (7, 1)
