"""The blind check: hidden arms, their sealed truth, and the score."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import LocalCluster
from typer.testing import CliRunner

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError, ElasticArmError
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge import campaign
from elastic_arm.studies.blind_challenge.answer_scoring import score_answer
from elastic_arm.studies.blind_challenge.arm_sampling import SamplingRequest, sample_arm
from elastic_arm.studies.blind_challenge.command import challenge_app
from elastic_arm.studies.blind_challenge.detectability import Detectability, sized
from elastic_arm.studies.blind_challenge.effect_sampling import model_without, sample_effect
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.kinematic_tree import KinematicTree
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from elastic_arm.studies.blind_challenge.parallel_jobs import Failure, mapped
from elastic_arm.studies.blind_challenge.proportions import Proportion, calibration, detection
from elastic_arm.studies.blind_challenge.scoring import _beside, score
from elastic_arm.studies.blind_challenge.sealed_truth import NAME, open_sealed, seal, seal_piece
from elastic_arm.studies.blind_challenge.summary import markdown

ROBOT = load_robot(None)


@pytest.mark.parametrize("bearings", [False, True])
def test_hidden_tree_agrees_with_the_projects_own_derivation(bearings: bool) -> None:
    """Two engines that share no code give the same torques for the same motion, to rounding."""
    rng = np.random.default_rng(0)
    tree, model = KinematicTree(ROBOT, bearings=bearings), build_model(ROBOT, bearings=bearings)
    x, dx, ddx = (0.3 * rng.standard_normal((3, tree.dof)) for _ in range(3))
    still = np.zeros_like(x)
    # What hangs on stiffness and damping is not the tree's.
    springs = model.inverse_dynamics(x, dx, ddx) - np.array([tree.torque(*row) for row in zip(x, dx, ddx, strict=True)])
    expected = model.inverse_dynamics(x, dx, still) - np.array(
        [tree.torque(*row) for row in zip(x, dx, still, strict=True)]
    )
    np.testing.assert_allclose(springs, expected, atol=1e-8)


def test_hidden_tree_has_the_papers_coupling() -> None:
    """S_11 and S_23 are the constants of (8), and the mass matrix is that of inverse dynamics."""
    tree = KinematicTree(ROBOT)
    x = np.array([0.3, -0.5, 0.7, 0.3, -0.5, 0.7])
    M, _ = tree.terms(x, np.zeros(6))
    columns = [tree.torque(x, np.zeros(6), e) - tree.torque(x, np.zeros(6), np.zeros(6)) for e in np.eye(6)]
    np.testing.assert_allclose(M, np.array(columns), atol=1e-9)
    assert M[0, 3] == pytest.approx(0.4356, rel=1e-6)
    assert M[1, 5] == pytest.approx(0.185, rel=0.01)


@pytest.mark.parametrize(
    "fault",
    [
        Fault("payload", None, {"mass": 4.0, "position_x": 0.1, "position_y": -0.05, "position_z": 0.12}),
        Fault("base_tilt", None, {"x": 0.05, "y": -0.08}),
        Fault("bearing_compliance", None, {"stiffness_scale": 0.5}),
        Fault("rotor_inertia_mismatch", 1, {"inertia": 1.3, "coupled": 0.0}),
        Fault("hysteresis", 2, {"torque": 5.0, "width": 1e-4}),
    ],
    ids=lambda fault: fault.effect,
)
def test_compiled_hidden_arm_moves_as_pinocchio_says(fault: Fault) -> None:
    """Joint and motor torques of a run are those that Pinocchio finds for its motion, to what sampling leaves."""
    arm = HiddenArm(ROBOT, [fault])
    course = arm.run(random_motion(np.random.default_rng(8), 3, 2.0))  # raises where the engines differ
    assert np.isfinite(course.tau_J).all()
    wrong = HiddenArm(ROBOT, [fault])
    wrong.tree = KinematicTree(ROBOT.with_(gravity=(0.0, 0.0, -9.0)), bearings=fault.effect == "bearing_compliance")
    with pytest.raises(Exception, match="not Pinocchio's"):
        wrong.run(random_motion(np.random.default_rng(8), 3, 2.0))


def test_hidden_motion_does_not_depend_on_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as many integration steps change angles by less than 1e-9 rad."""
    from elastic_arm.studies.blind_challenge.hidden_arms import hidden_arm

    motion = random_motion(np.random.default_rng(2), 3, 1.5)
    coarse = HiddenArm(ROBOT).run(motion)
    monkeypatch.setattr(hidden_arm, "SUBSTEPS", 2 * hidden_arm.SUBSTEPS)
    fine = HiddenArm(ROBOT).run(motion)
    assert np.abs(coarse.q - fine.q).max() < 1e-9


def test_sealed_truth_opens_only_unchanged(tmp_path: Path) -> None:
    """What was sealed comes back; what was changed after is refused."""
    seal_piece(tmp_path, "arm", {"name": "arm"})
    digest = seal(tmp_path, ["arm"])
    assert open_sealed(tmp_path, digest) == [{"name": "arm"}]
    (tmp_path / NAME).write_bytes(b"other")
    with pytest.raises(DiagnosisError, match="not what was sealed"):
        open_sealed(tmp_path, digest)


def test_bound_of_an_offset_is_that_of_a_mean() -> None:
    """The smallest known offset of tau_m is the noise over the square root of the number of samples."""
    rng = np.random.default_rng(1)
    detectability = Detectability(ROBOT, random_motion(rng, 3, 20.0), SensorModel(), rng)
    amount, signal = sized(sample_effect(EFFECTS["motor_torque_offset"], 3, rng), 30.0, detectability)
    assert signal.distance == pytest.approx(30.0, rel=0.03)
    # The diagnosis leaves out the ends, and gives each equation a hundredth of the noise's power besides.
    assert amount / signal.distance == pytest.approx(0.26 / np.sqrt(20000.0), rel=0.03)


def test_a_bound_follows_the_items_own_motion() -> None:
    """The faster of two motions shows a smaller viscous friction, in proportion to its speed."""
    bounds = []
    for speed in (0.5, 1.0):
        rng = np.random.default_rng(6)
        motion = random_motion(rng, 3, 6.0, speed=speed, acceleration=100.0, reach=1.5)
        draft = sample_effect(EFFECTS["viscous_friction"], 3, np.random.default_rng(0))
        amount, signal = sized(draft, 50.0, Detectability(ROBOT, motion, SensorModel(), rng))
        bounds.append(amount / signal.distance)
    assert bounds[0] / bounds[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow(15)
@pytest.mark.parametrize("effect", sorted(name for name, effect in EFFECTS.items() if effect.searched))
def test_every_effect_is_drawn_at_the_wanted_multiple_of_its_bound(effect: str) -> None:
    """Sizes are what was asked over the bound, or at an end of the plausible range, which the item then says."""
    rng = np.random.default_rng([4, *effect.encode()])
    item, _ = sample_arm(SamplingRequest("arm", (effect,), (0,), (5.0, 4.0), (40.0, 40.0)), ROBOT, rng)
    # What scales friction is drawn with friction beside it.
    place = [fault.effect for fault in item.faults].index(effect)
    bound, multiple = item.bound[place], item.multiple[place]
    if model := model_without(EFFECTS[effect]):
        assert item.model == model and multiple > 10.0
        return
    assert bound is not None
    low, high = sample_effect(EFFECTS[effect], 3, rng).limits()
    amount = bound * multiple
    at_an_end = amount <= 1.001 * low or amount >= 0.999 * high
    # Below what means no effect the range may end earlier than above.
    size = EFFECTS[effect].parameter(EFFECTS[effect].magnitude[0])
    at_an_end |= bool(np.isclose(item.faults[place].parameters.get(size.name, np.nan), size.low, rtol=1e-3).all())
    assert multiple == pytest.approx(40.0, rel=0.05) or at_an_end


def test_of_two_effects_neither_is_lost_in_the_others_gap() -> None:
    """Each of two effects makes at least one hundredth of the gap, which is what the contract counts as a cause."""
    rng = np.random.default_rng(12)
    effects = ("coulomb_friction", "joint_torque_offset")
    item, _ = sample_arm(SamplingRequest("arm", effects, (0,), (5.0, 4.0)), ROBOT, rng)
    assert sum(item.share) == pytest.approx(1.0)
    assert min(item.share) > 0.01 and min(item.multiple) >= 9.5


@pytest.mark.slow(25)
def test_small_campaign_is_made_resumed_answered_and_scored(tmp_path: Path) -> None:
    """A dozen recordings: what is made and answered stays, clean arms are called none, the score holds every arm."""
    settings = campaign.ChallengeSettings(
        seed=3, per_effect=1, clean=2, pairs=1, seconds=5.0, validate_seconds=4.0,
        effects=("motor_torque_offset", "viscous_friction", "encoder_offset"), ratio=(60.0, 200.0),
    )  # fmt: skip
    digest = campaign.create(tmp_path, settings)
    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")}
    assert len(stamps) == 12
    assert campaign.create(tmp_path, settings) == digest
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("bags/*/*.mcap")} == stamps
    assert campaign.solve(tmp_path) == {}
    answers = {p: p.stat().st_mtime_ns for p in tmp_path.glob("answers/*.json")}
    assert campaign.solve(tmp_path) == {}
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("answers/*.json")} == answers
    found = score(tmp_path)
    assert found["answered"] == 6 and found["open"] == 0
    assert found["shares"]["clean called none"]["hits"] == 2
    assert found["shares"]["effect right"]["hits"] == 3
    document = tmp_path / "results.md"
    said = CliRunner().invoke(challenge_app, ["score", str(tmp_path), "--markdown", str(document)])
    assert said.exit_code == 0, said.output
    assert document.read_text() == markdown(found)
    assert json.loads((tmp_path / "score.json").read_text())["shares"] == json.loads(json.dumps(found["shares"]))
    page = (tmp_path / "report.html").read_text()
    assert "What was named for what" in page and page.count("<svg") >= 4
    with pytest.raises(DiagnosisError, match="another challenge"):
        campaign.create(tmp_path, campaign.ChallengeSettings(seed=4))


@pytest.mark.slow(6)
def test_an_effect_that_never_acts_is_named(tmp_path: Path) -> None:
    """A stop beyond every motion has no size that could be told: the challenge refuses it by its name."""
    stop = "lambda motion, i, p: motion.at(i, link=p['stiffness'] * ca.fmax(motion.q[i] - 50.0, 0.0))"
    (tmp_path / "stop.py").write_text(
        "import casadi as ca\nfrom elastic_arm.effects import Effect, Parameter\n"
        "EFFECT = Effect(id='high_stop', formula='k max(q - 50, 0)', description='A stop.', signature='None.',\n"
        f"    law={stop}, parameters=(Parameter('stiffness', 'Nm/rad', 1.0, 1e3, neutral=0.0),), sides=('link',))\n"
    )
    settings = campaign.ChallengeSettings(
        seed=1,
        clean=0,
        pairs=0,
        effects=("high_stop",),
        seconds=5.0,
        validate_seconds=4.0,
        effects_files=(str(tmp_path / "stop.py"),),
    )
    with pytest.raises(ElasticArmError, match="high_stop does not act"):
        campaign.create(tmp_path / "challenge", settings)


def test_an_effect_out_of_the_catalogue_is_not_named(tmp_path: Path) -> None:
    """The withheld diagnosis stands beside the first, and does not name the effect that it was not given."""
    settings = campaign.ChallengeSettings(
        seed=1, clean=0, pairs=0, seconds=5.0, validate_seconds=4.0, effects=("torque_ripple",), ratio=(100.0, 200.0)
    )
    campaign.create(tmp_path, settings)
    assert campaign.solve(tmp_path) == {} and campaign.solve(tmp_path, kind=campaign.WITHHELD) == {}
    found = score(tmp_path)
    assert found["items"][0]["named"] == ["torque_ripple"]
    assert "torque_ripple" not in found["withheld_items"][0]["named"]
    assert found["withheld"]["torque_ripple"]["unknown where due"]["trials"] == 1


def _half(number: int) -> int:
    if number % 2:
        raise ValueError(f"{number} is odd")
    return number // 2


def test_one_failing_job_on_a_cluster_does_not_stop_the_others() -> None:
    """On a Dask cluster given by its address, every job is answered, the failing one by what went wrong."""
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0") as cluster:
        outcomes = list(mapped(_half, [2, 3, 8], scheduler=cluster.scheduler_address))
    failures = [o for o in outcomes if isinstance(o, Failure)]
    assert sorted(o for o in outcomes if not isinstance(o, Failure)) == [1, 4]
    assert [f.job for f in failures] == [3] and "3 is odd" in failures[0].problem


def test_a_challenge_that_is_not_complete_is_not_diagnosed(tmp_path: Path) -> None:
    """Without a sealed truth there is nothing to score against, and the tool says so before it works for hours."""
    (tmp_path / campaign.MANIFEST).write_text('{"settings": {}, "items": []}')
    with pytest.raises(DiagnosisError, match="not complete"):
        campaign.solve(tmp_path)


def _entry(**changes: Any) -> dict[str, Any]:
    fault = {"effect": "coulomb_friction", "joint": 1, "parameters": {"torque": 2.0}, "side": "motor", "channels": []}
    entry = {
        "name": "a",
        "model": "mod3",
        "faults": [fault | changes],
        "multiple": [20.0],
        "bound": [0.1],
        "share": [1.0],
    }
    return entry | {"instruments": {"encoder_noise": 0.0}}


def _answer(effect: str, joint: str | None, **changes: Any) -> dict[str, Any]:
    torque = {"value": 2.1, "std": 0.1, "unit": "Nm"}
    cause = {"effect": effect, "joint": joint, "sides": ["motor"], "parameters": {"torque": torque}, "confidence": 0.9}
    cause |= {"alternatives": []} | changes
    measured = {"shrink": 0.99, "measured_by": "excess", "log_likelihood": 900.0}
    return {"verdict": "explained", "causes": [cause], "unexplained": []} | measured


def test_a_declared_alternative_counts_as_found_and_an_undeclared_one_does_not() -> None:
    """The truth among the alternatives is right when its confidence is that of a declaration."""
    other = {"effect": "coulomb_friction", "joint": "joint_2", "confidence": 0.3, "separated_by": ""}
    joints = ROBOT.joint_names
    declared = score_answer(_entry(), _answer("load_dependent_friction", "joint_2", alternatives=[other]), joints)
    assert declared["effect_right"] and not declared["effect_itself"] and not declared["cause_right"][0]
    faint = other | {"confidence": 0.01}
    assert not score_answer(_entry(), _answer("load_dependent_friction", "joint_2", alternatives=[faint]), joints)[
        "effect_right"
    ]


def test_joint_side_and_interval_are_judged_apart() -> None:
    """Right effect on the wrong joint, on the wrong side, or with too narrow an interval: each is its own mistake."""
    joints = ROBOT.joint_names
    right = score_answer(_entry(), _answer("coulomb_friction", "joint_2"), joints)
    assert right["effect_right"] and right["joint_right"] and right["side_right"]
    assert (right["covered"], right["intervals"]) == (1, 1)
    elsewhere = score_answer(_entry(), _answer("coulomb_friction", "joint_3"), joints)
    assert not elsewhere["effect_right"] and not elsewhere["joint_right"]
    beside = score_answer(_entry(side="link"), _answer("coulomb_friction", "joint_2"), joints)
    assert beside["effect_right"] and not beside["side_right"]
    narrow = {"torque": {"value": 2.1, "std": 0.01, "unit": "Nm"}}
    assert score_answer(_entry(), _answer("coulomb_friction", "joint_2", parameters=narrow), joints)["covered"] == 0


def test_a_delay_is_right_on_its_side_only_in_its_channels() -> None:
    """The right effect on the right joint, said of another channel, is right but not on its side."""
    truth = _entry(effect="time_delay", parameters={"delay": 0.003}, channels=["joint_torque"])
    delay = {"value": 0.003, "std": 1e-4, "unit": "s"}
    for channels, right in (
        (["joint_torque"], True),
        (["motor_torque"], False),
        (["link_encoder", "motor_torque"], False),
    ):
        chosen = {"delay": delay, "channels": {"value": channels, "std": None, "unit": ""}}
        found = score_answer(truth, _answer("time_delay", "joint_2", parameters=chosen), ROBOT.joint_names)
        assert found["effect_right"] and found["side_right"] is right


def test_a_model_that_lacks_two_things_may_be_told_both() -> None:
    """mod1 has neither splines nor S: a second cause that says so is right, and on a mod3 arm it is false."""
    spline = _entry(effect="spline_inertia", joint=None, parameters={}) | {"model": "mod1"}
    answer = _answer("spline_inertia", None, parameters={})
    answer["causes"].append(answer["causes"][0] | {"effect": "inertia_coupling"})
    for model, right in (("mod1", [True, True]), ("mod3", [True, False])):
        found = score_answer(spline | {"model": model}, answer, ROBOT.joint_names)
        assert found["cause_right"] == right and found["alone"] is all(right)


def test_a_refused_diagnosis_is_a_wrong_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the diagnosis refuses is told, written down as an answer, and judged as one that found nothing."""

    def refuse(*_: Any) -> None:
        raise DiagnosisError("too little motion", "Record longer")

    monkeypatch.setattr(campaign, "read_recording", lambda *_: None)
    monkeypatch.setattr(campaign, "diagnose", refuse)
    name, problem = campaign._diagnose((str(tmp_path), "a", "mod3", "", campaign.ANSWERS))
    assert name == "a" and "too little motion" in problem
    answer = json.loads(campaign.answer_path(tmp_path, "a").read_text())
    found = score_answer(_entry(), answer, ROBOT.joint_names)
    assert (found["verdict"], found["effect_right"], found["none"], found["unknown"]) == (
        "refused",
        False,
        False,
        False,
    )


def test_what_the_rest_explains_of_a_faint_gap_is_measured_beside_the_effect_itself() -> None:
    """A faint gap's shrink says nothing of what is not found: then likelihoods with and without the effect count."""
    full = {"name": "a", "log_likelihood": 200.0}
    rest = {"name": "a", "shrink": 1.0, "log_likelihood": 120.0}
    (faint,) = _beside([rest | {"measured_by": "likelihood"}], [full])
    (plain,) = _beside([rest | {"measured_by": "excess"}], [full])
    (alone,) = _beside([rest | {"measured_by": "likelihood"}], [full | {"name": "b"}])
    (nothing,) = _beside([rest | {"measured_by": "likelihood", "log_likelihood": 0.0}], [full | {"name": "b"}])
    assert (faint["by_rest"], plain["by_rest"], alone["by_rest"], nothing["by_rest"]) == (0.6, 1.0, 1.0, 0.0)


def test_shares_carry_binomial_intervals() -> None:
    """Twenty of twenty is a share of one, whose interval begins near 0.83."""
    share = Proportion(20, 20)
    assert share.value == 1.0
    assert share.interval == pytest.approx((0.8316, 1.0), abs=1e-3)


def test_smallest_detected_size_is_found_from_hits_and_misses() -> None:
    """The size detected in 90 % of cases is recovered from drawn cases, and its interval holds it."""
    rng = np.random.default_rng(3)
    multiples = np.exp(rng.uniform(np.log(2.0), np.log(60.0), 300))
    probability = 1.0 / (1.0 + np.exp(-3.0 * (np.log(multiples) - np.log(8.0))))
    true = 8.0 * 9.0 ** (1.0 / 3.0)
    curve = detection(list(multiples), list(rng.random(300) < probability))
    assert curve is not None and curve.low < true < curve.high
    assert curve.smallest == pytest.approx(true, rel=0.25)


def test_cases_that_were_all_detected_bound_the_smallest_size_from_above() -> None:
    """Where nothing was missed from 10 bounds on, the smallest detected size lies below that."""
    curve = detection(list(np.geomspace(10.0, 300.0, 20)), [True] * 20)
    assert curve is not None and curve.smallest < 10.0


def test_calibration_counts_what_was_right_bin_by_bin() -> None:
    """Of four causes with 0.97, three of which were right, the bin says three of four."""
    rows = calibration([0.97] * 4 + [0.3], [True, True, True, False, False])
    assert [(r["hits"], r["trials"]) for r in rows] == [(0, 1), (3, 4)]
    assert rows[1]["mean_confidence"] == pytest.approx(0.97)
