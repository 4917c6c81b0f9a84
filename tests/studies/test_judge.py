"""The judge and the bench: what a row of the CSV holds, and what a change does to a recording."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import judge as judging
from benchmarks.judge import Arm, judge, row, summary
from elastic_arm.dynamics import build_model
from elastic_arm.recording import Recording, Side
from elastic_arm.studies.blind_challenge.hidden_arms.motion import random_motion
from examples.bench import NOTICED, TIMES, Bench, against, with_mass
from tests.helpers.random_arms import random_arm

TRUTH = {
    "effect": "payload",
    "joint": "j3",
    "parameters": {"mass": 2.0, "position": [0.1, 0.0, 0.0]},
    "phases": [],
}
ARM = Arm("a", "laboratory", "single", ["fit"], ["held"], [TRUTH], verdicts=["explained"])


def cause(effect: str, joint: str | None, confidence: float, **changes: Any) -> dict[str, Any]:
    """Return a cause as diagnosis.json has it."""
    return {
        "effect": effect,
        "joint": joint,
        "confidence": confidence,
        "parameters": {},
        "alternatives": [],
    } | changes


def answer(*causes: dict[str, Any], verdict: str = "explained") -> dict[str, Any]:
    """Return an answer."""
    return {"verdict": verdict, "causes": list(causes), "shrink": 0.9, "cpu_seconds": 1.0}


def test_a_row_holds_what_is_right_what_is_false_and_how_far_sizes_are_off() -> None:
    """The true effect counts at its joint or as a declared alternative, a false one from 0.9 on,
    sizes by component."""
    mass = {
        "mass": {"value": 2.2, "std": 0.1},
        "position": {"value": [0.1, 0.02, 0.0], "std": [0.01, 0.01, None]},
    }
    found = row(
        ARM, answer(cause("payload", "j3", 0.99, parameters=mass), cause("backlash", "j1", 0.95))
    )
    assert (found["right"], found["false_causes"], found["told"]) == (
        "1",
        "backlash:j1",
        "0.9900:1; 0.9500:0",
    )
    assert (found["z"], found["off"]) == ("2.00; 0.00; 2.00", "0.100; 0.000; inf")
    other = [{"effect": "payload", "joint": "j3", "confidence": 0.2}]
    declared = row(ARM, answer(cause("base_tilt", "j3", 0.8, alternatives=other)))
    assert (declared["right"], declared["false_causes"], declared["told"]) == (
        "1",
        "",
        "0.8000:0; 0.0000:1",
    )
    synonym = row(ARM, answer(cause("link_inertia_mismatch", "j3", 0.95)))
    assert (synonym["right"], synonym["false_causes"], synonym["told"]) == (
        "1",
        "",
        "0.9500:1",
    )


@pytest.mark.parametrize(
    ("kind", "verdicts", "said", "right"),
    [
        ("clean", ["none", "explained"], answer(verdict="none"), "1"),
        ("clean", ["none", "explained"], answer(verdict="unknown"), "0"),
        ("clean", ["none", "explained"], answer(cause("backlash", "j1", 0.4)), "0"),
        ("withheld", ["unknown"], answer(cause("backlash", "j1", 0.4), verdict="unknown"), "1"),
        ("fault", ["refused", "unknown"], answer(verdict="refused"), "1"),
    ],
)
def test_without_a_truth_the_verdict_decides(
    kind: str, verdicts: list[str], said: Any, right: str
) -> None:
    """A clean arm has no cause and is not unknown; what no catalogue has is unknown, with whatever
    causes."""
    assert row(replace(ARM, kind=kind, truth=[], verdicts=verdicts), said)["right"] == right


def test_an_arm_that_fails_is_a_row_and_answers_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crash ends nothing; what the CSV holds is not asked again, and the summary counts it as
    wrong."""
    asked: list[str] = []

    def crash(arguments: list[str], seconds: float | None = None) -> None:
        asked.append(arguments[2])
        raise RuntimeError("segmentation fault")

    monkeypatch.setattr(judging, "_own_process", crash)
    for _ in range(2):
        rows = judge([ARM, replace(ARM, name="b")], tmp_path, tmp_path / "out.csv", 1)
    assert sorted(asked) == ["a", "b"] and {r["verdict"] for r in rows} == {"failed"}
    with (tmp_path / "out.csv").open() as file:
        assert [r["error"] for r in csv.DictReader(file)] == [
            "RuntimeError: segmentation fault"
        ] * 2
    assert "0/2" in summary(rows)


@pytest.fixture(scope="module")
def bench() -> Bench:
    """Two recordings of a rigid arm of three joints at 200 Hz, without noise or friction."""
    rng = np.random.default_rng(3)
    robot = random_arm(3, rng, elastic=False)
    t = np.arange(0.0, 8.0, 0.005)
    recordings = []
    for _ in range(2):
        q, dq, ddq = random_motion(rng, 3, 8.0).evaluate(t)
        torque = build_model(robot, "mod3").inverse_dynamics(q, dq, ddq)
        recordings.append(
            Recording(robot.joint_names, motor=Side((t * 1e9).astype(np.int64), q, dq, torque))
        )
    return Bench(robot, recordings)


@pytest.mark.parametrize("effect", sorted(NOTICED))
def test_a_change_is_its_law_and_goes_with_its_size(bench: Bench, effect: str) -> None:
    """Three times of a change do about three times what one does, in every recording, and the truth
    has its size."""
    sizes = []
    for times in (1.0, 3.0):
        recordings, truth = bench.changed(effect, times, 1)
        changes = [
            getattr(r, m.name).effort - m.torque
            for r, m in zip(recordings, bench.motions, strict=True)
        ]
        assert all(np.abs(change).max() > 0.0 for change in changes)
        sizes.append(float(np.sqrt(np.mean(np.square(changes)))))
    assert sizes[1] / sizes[0] == pytest.approx(3.0, rel=0.25)
    (value,) = truth["parameters"].values()
    assert np.isfinite(value) and TIMES[0] == 3.0


def test_another_arm_takes_other_torques(bench: Bench) -> None:
    """A mass weighs at rest, a tilt turns gravity against the base, a zero is read as true angle
    and offset."""
    motion, robot = bench.motions[0], bench.robot
    heavy, _ = bench.changed("load", 1.0, 1)
    added = with_mass(
        robot, 1, NOTICED["load"][0] * bench.mass, np.asarray(robot.joints[1].link.com)
    )
    change = heavy[0].motor.effort - motion.torque  # type: ignore[union-attr]
    np.testing.assert_allclose(change, motion.taken(added) - motion.taken(robot), atol=1e-9)
    assert sum(j.link.mass for j in added.joints) == pytest.approx(
        bench.mass * (1.0 + NOTICED["load"][0])
    )
    turned, truth = bench.changed("joint_zero", 1.0, 1)
    off = np.array([0.0, truth["parameters"]["offset"], 0.0])
    taken = build_model(robot, "mod3").inverse_dynamics(motion.q - off, motion.dq, motion.ddq)
    change = turned[0].motor.effort - motion.torque  # type: ignore[union-attr]
    np.testing.assert_allclose(change, taken - motion.taken(robot), atol=1e-9)


def test_the_size_to_be_found_is_that_before_and_the_change() -> None:
    """Friction of 5 Nm and 2 Nm more is 7 Nm, found from 6 Nm on; causes before are not false;
    gains multiply."""
    truth = {
        "effect": "coulomb_friction",
        "joint": "j1",
        "parameters": {"torque": 2.0},
        "phases": [],
    }
    before = {
        "causes": [cause("coulomb_friction", "j1", 0.9, parameters={"torque": {"value": 5.0}})]
    }
    asked = against(replace(ARM, truth=[truth]), before)
    assert asked.truth[0]["parameters"] == {"torque": 7.0} and asked.allowed == [
        ["coulomb_friction", "j1"]
    ]
    for said, right in ((5.2, "0"), (6.8, "1")):
        size = {"torque": {"value": said, "std": 0.5}}
        assert (
            row(asked, answer(cause("coulomb_friction", "j1", 0.9, parameters=size)))["right"]
            == right
        )
    gain = {"effect": "motor_torque_gain", "joint": "j1", "parameters": {"gain": 1.1}, "phases": []}
    known = {
        "causes": [],
        "imperfections": [{"what": "motor_torque_gain", "joint": "j1", "value": 0.98}],
    }
    (found,) = against(replace(ARM, truth=[gain]), known).truth
    assert found["parameters"]["gain"] == pytest.approx(1.078) and found["change"][
        "gain"
    ] == pytest.approx(0.1)
