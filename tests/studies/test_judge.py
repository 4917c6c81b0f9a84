"""The judge: what a row of the CSV holds."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks import judge as judging
from benchmarks.judge import Arm, judge, row, summary

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
