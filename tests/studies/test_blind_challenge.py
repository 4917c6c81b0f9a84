"""The blind check: what is drawn and how large, campaigns, answers and their score."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_arm.effects import EFFECTS, Catalogue
from elastic_arm.errors import DiagnosisError, SimulationError
from elastic_arm.recording import read_recording
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge import campaign
from elastic_arm.studies.blind_challenge.answers import expected_unknown, score_answer
from elastic_arm.studies.blind_challenge.draw import Request, channels_path, description_path, draw
from elastic_arm.studies.blind_challenge.effect_sampling import sample_effect
from elastic_arm.studies.blind_challenge.hidden_arms.base_arms import imprecise
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.realistic_sensors import RealisticSensors
from elastic_arm.studies.blind_challenge.information import (
    ITSELF,
    MarginalInformation,
    _alterations,
)
from elastic_arm.studies.blind_challenge.levels import FIELD, FLOORS, LABORATORY, SERVO, WORKSHOP
from elastic_arm.studies.blind_challenge.score import calibration, markdown, proportion, score
from elastic_arm.studies.blind_challenge.servo_arms import described, with_effect
from tests.helpers.command_line import run
from tests.helpers.nightly import nightly

ROBOT = load_robot(None)
JOINTS = list(ROBOT.joint_names)


# --- what is drawn


def test_the_levels_draw_what_a_diagnosis_looks_for() -> None:
    """Effects that act only where they are stated are no hidden effects; those that a user adds are
    drawn."""
    assert all(EFFECTS[effect].searched for effect in (*LABORATORY.effects, *FIELD.effects))
    assert LABORATORY.drawn((*EFFECTS, "of_a_user"))[-1] == "of_a_user" and set(FLOORS) <= set(
        LABORATORY.effects
    )
    settings = campaign.ChallengeSettings(seed=23, per_effect=1, clean=4, pairs=4)
    assert settings.requests(Catalogue.default()) == settings.requests(EFFECTS)


def test_effects_at_once_show_with_the_sensors_of_one_arm() -> None:
    """Of field arms with one side recorded, both effects of a pair act on that side."""
    requests = campaign.ChallengeSettings(
        seed=5, level="field", per_effect=0, clean=0, pairs=100
    ).requests()
    assert all(FIELD.sides_of(request.effects) for request in requests)
    assert len({request.effects for request in requests}) > 50


def test_a_bound_counts_what_is_ordinary() -> None:
    """An offset of 0.5 Nm is 1.7 ordinary deviations of its own prior, and some ten bounds without
    it."""
    rng = np.random.default_rng(1)
    real = imprecise(ROBOT, rng)
    course = HiddenArm(real, geometry=ROBOT).run(random_motion(rng, 3, 10.0))
    sensors = RealisticSensors((0.26,) * 3)
    information, exact = (
        MarginalInformation(real, sensors, course, level) for level in (WORKSHOP, LABORATORY)
    )
    change = np.zeros((len(course.t[::10]), 3, 3))
    change[:, 2, 1] = 0.5
    key = ("motor_torque_offset", 1)
    assert information.distance(change) == pytest.approx(0.5 / 0.3, rel=0.02)
    # A zero of the motor differs from one of the joint torque sensor by the spring's equation
    # alone, in which a zero of an encoder does the same.
    assert information.distance(change, without=[key]) == pytest.approx(9.5, rel=0.1)
    alone = information.distance(change, without=[key, ("encoder_offset", 1)])
    assert (
        20.0
        < alone
        < exact.distance(change)
        == pytest.approx(0.5 / 0.26 * np.sqrt(9000.0), rel=0.05)
    )


def test_a_link_that_is_heavier_is_known_by_its_own_numbers_alone() -> None:
    """Its inertia goes with its mass: what is ordinary of its shape does not stand against it."""
    own = ITSELF["link_inertia_mismatch"]
    numbers = {what for what, _, _ in _alterations(ROBOT, 1)}
    assert set(own) < numbers and numbers - set(own) == {"com_x", "com_y", "com_z", "rotor"}


# One of each kind: friction, a drive, a sensor, a delay, and another model.
DRAWN = (
    "coulomb_friction",
    "transmission_error",
    "motor_torque_gain",
    "time_delay",
    "inertia_coupling",
)


@pytest.mark.slow(25)
@pytest.mark.parametrize("effect", [*DRAWN, *nightly(sorted({*LABORATORY.effects} - {*DRAWN}))])
def test_every_effect_is_drawn_at_the_wanted_multiple_of_its_bound(effect: str) -> None:
    """Sizes are what was asked over the bound, or at an end of the plausible range, which the truth
    then holds."""
    rng = np.random.default_rng([4, *effect.encode()])
    arm = draw(
        Request("arm", (effect,), (0,), (5.0, 4.0), (40.0, 40.0)), LABORATORY, rng, EFFECTS
    ).arm
    # What scales friction is drawn with friction.
    place = [fault.effect for fault in arm.faults].index(effect)
    bound = arm.bound[place]
    multiple = arm.multiple[place]
    if bound is None:
        assert arm.model != "mod3"
        return
    low, high = sample_effect(EFFECTS[effect], 3, rng).limits()
    amount = bound * multiple
    at_an_end = amount <= 1.001 * low or amount >= 0.999 * high
    # Below what means no effect the range may end earlier than above.
    size = EFFECTS[effect].parameter(EFFECTS[effect].magnitude[0])
    at_an_end |= bool(
        np.isclose(arm.faults[place].parameters.get(size.name, np.nan), size.low, rtol=1e-3).all()
    )
    assert multiple == pytest.approx(40.0, rel=0.06) or at_an_end


BUFFER = """
import casadi as ca
from elastic_arm.effects import Effect, Parameter, Role
def law(motion, i, p):
    return motion.at(i, link=p["stiffness"] * ca.fmax(motion.q[i] - p["contact"], 0.0))
EFFECT = Effect(
    id="buffer", formula="k max(q - q0, 0)", description="A buffer.",
    signature="A bend over the angle.", law=law,
    parameters=(
        Parameter("stiffness", "Nm/rad", 1.0, 500.0, neutral=0.0, least=0.0, meaning="k"),
        Parameter("contact", "rad", {low}, {high}, role=Role.SEARCHED, meaning="q0"),
    ),
    sides=("link",), regime="position",
)
"""


def test_an_effect_acts_in_both_recordings_or_is_refused(tmp_path: Path) -> None:
    """A buffer is drawn where both motions touch it, with a size of its range; one that nothing
    reaches is refused."""
    requests = []
    catalogues = []
    for name, low, high in (("near", -0.5, 0.5), ("never", 50.0, 60.0)):
        file = tmp_path / f"{name}.py"
        file.write_text(BUFFER.replace("{low}", str(low)).replace("{high}", str(high)))
        catalogues.append(Catalogue.default().with_files([file]))
        requests.append(Request("arm", ("buffer",), (0, 1), (6.0, 5.0)))
    drawn = draw(requests[0], LABORATORY, np.random.default_rng((0, 1)), catalogues[0])
    (fault,) = drawn.arm.faults
    assert 1.0 <= fault.parameters["stiffness"] <= 500.0
    for motion in drawn.motions:
        change = drawn.run(motion, (fault,)).tau_J - drawn.run(motion, ()).tau_J
        assert np.abs(change).max() > 0.05
    with pytest.raises(SimulationError, match="does not change"):
        draw(requests[1], LABORATORY, np.random.default_rng((0, 1)), catalogues[1])


# --- campaigns


@pytest.mark.nightly
@pytest.mark.slow(25)
def test_small_campaign_is_made_resumed_answered_and_scored(tmp_path: Path) -> None:
    """What is made and answered stays, clean arms are called none, a withheld effect is not named,
    all is scored."""
    settings = campaign.ChallengeSettings(
        seed=3, per_effect=1, clean=1, pairs=0, seconds=(5.0, 4.0), ratio=(60.0, 200.0),
        effects=("viscous_friction",),
    )  # fmt: skip
    digest = campaign.create(tmp_path, settings)
    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")}
    assert len(stamps) == 4
    assert campaign.create(tmp_path, settings) == digest
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")} == stamps
    assert campaign.solve(tmp_path) == {} and campaign.solve(tmp_path, kind=campaign.WITHHELD) == {}
    answers = {p: p.stat().st_mtime_ns for p in tmp_path.glob("answers/*.json")}
    assert campaign.solve(tmp_path) == {}
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("answers/*.json")} == answers
    found = score(tmp_path)
    assert found["answered"] == 2 and found["open"] == 0
    shares = found["levels"]["laboratory"]["shares"]
    assert (
        shares["nothing more than ordinary: no cause"]["hits"] == 1
        and shares["effect right"]["hits"] == 1
    )
    assert all(x["truth"][0] not in x["named"] for x in found["withheld_items"])
    document = tmp_path / "results.md"
    said = run("challenge", "score", tmp_path, "--markdown", document)
    assert said.exit_code == 0, said.output
    assert document.read_text() == markdown(found)
    assert json.loads((tmp_path / "score.json").read_text())["levels"] == json.loads(
        json.dumps(found["levels"])
    )
    page = (tmp_path / "report.html").read_text()
    assert "Results by effect" in page and page.count("<svg") >= 2
    with pytest.raises(DiagnosisError, match="another challenge"):
        campaign.create(tmp_path, campaign.ChallengeSettings(seed=4))
    (tmp_path / campaign.SEALED).write_bytes(b"other")
    with pytest.raises(DiagnosisError, match="differs from the file sealed"):
        campaign.open_sealed(tmp_path, digest)


@pytest.mark.nightly
@pytest.mark.slow(20)
def test_a_field_arm_is_recorded_with_its_description_and_read_back(tmp_path: Path) -> None:
    """Bags, URDF with overlay and channel map of an arm are complete: torque sensors are read as
    such."""
    settings = campaign.ChallengeSettings(
        seed=1, per_effect=0, clean=2, pairs=0, seconds=(4.0, 4.0), level="field"
    )
    campaign.create(tmp_path, settings)
    question = campaign.load_manifest(tmp_path)["question"]
    assert question["with"] == ["coulomb_friction", "viscous_friction"]
    assert question["priors"] == {"sensors": {"motor_torque_gain": 0.15}}
    truth = campaign.open_sealed(tmp_path, campaign.load_manifest(tmp_path)["truth_sha256"])
    for entry in truth:
        path = description_path(tmp_path, entry["name"])
        channels = channels_path(tmp_path, entry["name"])
        robot = load_robot(path)
        read = read_recording(
            tmp_path / "bags" / f"{entry['name']}_identify", channels, robot.joint_names
        )
        assert (
            robot.elastic
            and robot.n in (6, 7)
            and np.linalg.norm(robot.gravity) == pytest.approx(9.81)
        )
        assert (read.link is None) == (channels is None) and (read.motor is None) == (
            channels is not None
        )


def test_a_challenge_that_is_not_complete_is_not_diagnosed(tmp_path: Path) -> None:
    """Without a sealed truth there is nothing to score against, and the tool says so before it
    works for hours."""
    (tmp_path / campaign.MANIFEST).write_text('{"settings": {}, "items": []}')
    with pytest.raises(DiagnosisError, match="not complete"):
        campaign.solve(tmp_path)


def test_an_arm_that_no_simulation_gets_through_is_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the engine leaves the finite numbers, the same arm is drawn from another seed."""
    seeds: list[tuple[int, ...]] = []

    def record(folder: Path, request: Request, *_: object) -> dict[str, object]:
        seeds.append(request.seed)
        if len(seeds) < 3:
            raise SimulationError("the hidden arm left the finite numbers", "Draw smaller effects")
        return {"name": request.name}

    monkeypatch.setattr(campaign, "record", record)
    request = Request("arm", (), (7, 1), (2.0, 1.0))
    assert campaign.recorded(tmp_path, request, WORKSHOP, EFFECTS) == {"name": "arm"}
    assert len(set(seeds)) == 3 and seeds[0] == (7, 1)


# --- answers


def _entry(**changes: Any) -> dict[str, Any]:
    fault = {
        "effect": "coulomb_friction",
        "joint": 1,
        "parameters": {"torque": 2.0},
        "side": "motor",
        "channels": [],
    }
    entry = {
        "name": "a",
        "model": "mod3",
        "level": "laboratory",
        "joints": JOINTS,
        "foreign": [],
        "conditions": [],
        "ordinary": [],
        "numbers": [["stiffness", 1, 1.05]],
        "multiple": [20.0],
        "bound": [0.1],
        "share": [1.0],
        "sensors": {"sides": "both"},
        "visible": True,
    }
    own = {k: v for k, v in changes.items() if k in fault}
    return entry | {"faults": [fault | own]} | {k: v for k, v in changes.items() if k not in own}


def _cause(effect: str, joint: str | None, **changes: Any) -> dict[str, Any]:
    torque = {"value": 2.1, "std": 0.1, "unit": "Nm"}
    cause = {
        "effect": effect,
        "joint": joint,
        "sides": ["motor"],
        "parameters": {"torque": torque},
        "confidence": 0.9,
    }
    return cause | {"alternatives": []} | changes


def _answer(*causes: dict[str, Any], **changes: Any) -> dict[str, Any]:
    verdict = "explained" if causes else "none"
    return {"verdict": verdict, "causes": list(causes), "unexplained": [], "shrink": 0.99} | changes


def test_a_declared_alternative_counts_as_found_and_an_undeclared_one_does_not() -> None:
    """The truth among the alternatives is right when its confidence is that of a declaration."""
    other = {
        "effect": "coulomb_friction",
        "joint": "joint_2",
        "confidence": 0.3,
        "separated_by": "",
    }
    said = [
        score_answer(
            _entry(), _answer(_cause("load_dependent_friction", "joint_2", alternatives=[one]))
        )
        for one in (other, other | {"confidence": 0.01})
    ]
    assert [x["effect_right"] for x in said] == [True, False] and not said[0]["cause_right"][0]
    assert said[0]["told"] == [(0.9, False), (0.0, True)]


def test_joint_side_and_interval_are_judged_apart() -> None:
    """Right effect on the wrong joint, on the wrong side, or with too narrow an interval: each is
    its own mistake."""
    right = score_answer(_entry(), _answer(_cause("coulomb_friction", "joint_2")))
    assert right["effect_right"] and right["joint_right"] and right["side_right"]
    assert right["coverage"]["causes"] == [1, 1] and right["z"] == [pytest.approx(1.0)]
    elsewhere = score_answer(_entry(), _answer(_cause("coulomb_friction", "joint_3")))
    assert not elsewhere["effect_right"] and not elsewhere["joint_right"]
    other = score_answer(_entry(side="link"), _answer(_cause("coulomb_friction", "joint_2")))
    assert other["effect_right"] and not other["side_right"]
    narrow = {"torque": {"value": 2.1, "std": 0.01, "unit": "Nm"}}
    said = score_answer(_entry(), _answer(_cause("coulomb_friction", "joint_2", parameters=narrow)))
    assert said["coverage"]["causes"] == [0, 1]


def test_a_delay_is_right_on_its_side_only_in_its_channels() -> None:
    """The right effect on the right joint, said of another channel, is right but not on its
    side."""
    truth = _entry(effect="time_delay", parameters={"delay": 0.003}, channels=["joint_torque"])
    delay = {"value": 0.003, "std": 1e-4, "unit": "s"}
    for channels, right in ((["joint_torque"], True), (["link_encoder", "motor_torque"], False)):
        chosen = {"delay": delay, "channels": {"value": channels, "std": None, "unit": ""}}
        found = score_answer(truth, _answer(_cause("time_delay", "joint_2", parameters=chosen)))
        assert found["effect_right"] and found["side_right"] is right


def test_a_model_that_lacks_two_things_may_be_told_both() -> None:
    """mod1 has neither splines nor S: a second cause that names it is right, and on a mod3 arm it
    is false."""
    spline = _entry(effect="spline_inertia", joint=None, parameters={})
    answer = _answer(
        *(_cause(e, None, parameters={}) for e in ("spline_inertia", "inertia_coupling"))
    )
    for model, right in (("mod1", [True, True]), ("mod3", [True, False])):
        found = score_answer(spline | {"model": model}, answer)
        assert found["cause_right"] == right and found["accused"] is not all(right)


def test_a_refused_diagnosis_is_a_wrong_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the diagnosis refuses is told, written down as an answer, and judged as one that found
    nothing."""

    def refuse(*_: Any) -> None:
        raise DiagnosisError("too little motion", "Record longer")

    settings = {"level": "laboratory", "seconds": None}
    monkeypatch.setattr(campaign, "load_manifest", lambda folder: {"settings": settings})
    monkeypatch.setattr(campaign, "read_recording", refuse)
    name, problem = campaign._diagnose(tmp_path, "a", "mod3", "", campaign.ANSWERS)
    assert name == "a" and "too little motion" in problem
    found = score_answer(_entry(), json.loads(campaign.answer_path(tmp_path, "a").read_text()))
    assert (found["verdict"], found["effect_right"]) == ("refused", False)


def test_a_false_cause_counts_by_its_confidence_and_a_condition_of_the_level_is_none() -> None:
    """A cause that no arm had accuses it from 0.9 on; what every arm of the level has beyond the
    ordinary does not."""
    drift = {"effect": "torque_drift", "joint": 2, "parameters": {"rate": 0.01}, "side": "motor"}
    entry = _entry(conditions=[drift]) | {"faults": []}
    said = [
        score_answer(entry, _answer(_cause(effect, joint, confidence=confidence)))
        for effect, joint, confidence in (
            ("backlash", "joint_1", 0.95), ("backlash", "joint_1", 0.6),
            ("torque_drift", "joint_3", 0.99),
        )
    ]  # fmt: skip
    assert [x["accused"] for x in said] == [True, False, False]
    assert [x["no_cause"] for x in said] == [False, False, True]


def test_intervals_of_friction_and_numbers_are_held_against_the_truth() -> None:
    """Of two stated intervals, one holds its true value: the friction's does, the stiffness' does
    not."""
    ordinary = {
        "effect": "coulomb_friction",
        "joint": 0,
        "parameters": {"torque": 5.0},
        "side": "motor",
    }
    friction = {
        "effect": "coulomb_friction",
        "joint": "joint_1",
        "parameters": {"torque": {"value": 5.1, "std": 0.1}},
    }
    stiffness = {"what": "stiffness", "joint": "joint_2", "value": 1.0, "std": 0.01}
    entry = _entry(ordinary=[ordinary]) | {"faults": []}
    line = score_answer(entry, _answer(known=[friction], imperfections=[stiffness]))
    assert line["coverage"]["frictions"] == [1, 1] and line["coverage"]["numbers"] == [0, 1]


def test_none_is_right_only_where_an_effect_of_no_catalogue_cannot_be_seen() -> None:
    """The challenge's own bound decides, not the diagnosis."""
    foreign = [{"effect": "oil_drag", "joint": 0, "parameters": {}, "side": "motor"}]
    entry = _entry(foreign=foreign) | {"faults": []}
    seen, unseen = (score_answer(entry | {"visible": v}, _answer()) for v in (True, False))
    assert not expected_unknown(seen) and expected_unknown(unseen)


def test_shares_carry_binomial_intervals_and_confidences_are_counted_bin_by_bin() -> None:
    """Twenty of twenty begins near 0.83; of four causes with 0.97, three of which were right, the
    bin has three."""
    assert proportion([True] * 20)["interval"] == pytest.approx([0.8316, 1.0], abs=1e-3)
    rows = calibration([*((0.97, held) for held in (True, True, True, False)), (0.3, False)])
    assert [(r["hits"], r["trials"]) for r in rows] == [(0, 1), (3, 4)]
    assert rows[1]["mean_confidence"] == pytest.approx(0.97)


def test_servo_arms_are_drawn_answered_and_scored(tmp_path: Path) -> None:
    """A campaign of the level `servo` has an MJCF, two bags of commands and positions, and an
    answer that is right."""
    settings = campaign.ChallengeSettings(
        seed=2, effects=("position_gain",), clean=0, pairs=0, seconds=(10.0, 5.0), level="servo"
    )
    campaign.create(tmp_path, settings)
    description = description_path(tmp_path, "arm_0000")
    assert description is not None and description.suffix == ".xml"
    recording = read_recording(tmp_path / "bags" / "arm_0000_identify")
    assert recording.reference is not None and all(
        side.effort is None for side in recording.measured().values()
    )
    assert campaign.solve(tmp_path) == {}
    (line,) = score(tmp_path)["items"]
    assert line["effect_right"] and not line["accused"]


@pytest.mark.nightly
@pytest.mark.slow(12)
def test_a_history_is_recorded_and_its_change_told_where_it_happened(tmp_path: Path) -> None:
    """Of three bags those from one on have more friction; a change that is sure at another is a
    false one."""
    settings = campaign.ChallengeSettings(
        seed=1, effects=("coulomb_friction",), clean=0, pairs=0, seconds=(8.0,) * 3, level="history"
    )
    campaign.create(tmp_path, settings)
    assert len(list((tmp_path / "bags").iterdir())) == 3
    assert campaign.solve(tmp_path) == {}
    (line,) = score(tmp_path)["items"]
    assert line["effect_right"] and not line["accused"]
    (path,) = (tmp_path / campaign.ANSWERS).iterdir()
    answer = json.loads(path.read_text())
    (cause,) = answer["causes"]
    elsewhere = cause | {"recording": cause["recording"] + 1, "confidence": 0.99}
    path.write_text(json.dumps(answer | {"causes": [elsewhere]}))
    (line,) = score(tmp_path)["items"]
    assert not line["effect_right"] and line["accused"]


def test_what_is_drawn_of_a_servo_arm_is_the_whole_difference() -> None:
    """Each effect of the levels, and what no catalogue has, changes its joint, or all joints, and
    no other."""
    stated = described(np.random.default_rng(0))
    for effect in (*SERVO.effects, *SERVO.foreign):
        changed, fault = with_effect(
            stated, effect, np.full(len(stated), 2.0), np.random.default_rng(1)
        )
        others = [a == b for a, b in zip(stated, changed, strict=True)]
        assert fault.effect == effect
        assert [k for k, same in enumerate(others) if not same] == (
            list(range(len(stated))) if fault.joint is None else [fault.joint]
        )
