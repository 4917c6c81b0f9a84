"""The result of a diagnosis as data."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.diagnosis import Diagnosis
from elastic_arm.diagnosis.corrected_robot import holds_any, repaired_robot
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.result import SEPARATING, Alternative, Cause, ResidualSizes
from elastic_arm.effects import parse
from elastic_arm.errors import DiagnosisError
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)
PLACE = ("joint_2", "motor")


def cause(text: str = "coulomb_friction:joint_2:torque=6") -> Cause:
    instance = parse(text, ROBOT)
    others = (Alternative("viscous_friction", "joint_2", 0.2, "slow motion"), Alternative("backlash", None, 0.1, "any"))
    size = {"torque": ParameterEstimate(6.0, 0.12345678901, "Nm")}
    return Cause(instance.effect.id, instance.joint, ("motor",), "velocity_reversal", size, 0.5, 0.7, others, instance)


def diagnosis(*causes: Cause) -> Diagnosis:
    sizes = ResidualSizes({PLACE: 0.4}, {PLACE: 1.2})
    return Diagnosis(
        model="mod3",
        robot=ROBOT.name,
        joints=ROBOT.joint_names,
        identify=("a",),
        validate=("b",),
        independent_motion=True,
        band=40.0,
        verdict="explained",
        noise={PLACE: 0.1},
        before=sizes,
        after=sizes,
        shrink=0.9,
        shrink_interval=(0.8, float("nan")),
        measured_by="excess",
        log_likelihood=300.0,
        causes=causes,
        unexplained=(),
        cumulative_shrink=(0.5, 0.9),
    )


def test_a_decided_alternative_names_the_file_and_others_their_motion() -> None:
    """The proposed motion stands at the alternative that it is expected to decide on, and at no other."""
    decided = {(("coulomb_friction", "joint_2"), ("viscous_friction", "joint_2"))}
    first, second = cause().with_separating_file(decided).to_dict()["alternatives"]
    assert (first["separated_by"], second["separated_by"]) == (SEPARATING, "any")
    assert cause().with_separating_file(set()) == cause()


def test_missing_equations_and_undetermined_numbers_are_null(tmp_path: Path) -> None:
    """What was not measured is null in the file, never a number or NaN, and the file is valid JSON."""
    data = json.loads(diagnosis(cause()).save(tmp_path / "new" / "diagnosis.json").read_text())
    assert data["gap"]["before"]["joint_2"] == {"link": None, "drive": None, "motor": {"rmse": 0.4, "max": 1.2}}
    assert data["shrink_interval"] == [0.8, None] and data["ladder"] == [0.5, 0.9]
    assert data["causes"][0]["parameters"]["torque"]["std"] == pytest.approx(0.1234568, abs=1e-9)


def test_a_file_that_cannot_be_written_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    """A folder in the file's place is refused in one line."""
    with pytest.raises(DiagnosisError, match="Choose another --out"):
        diagnosis().save(tmp_path)


def test_the_corrected_arm_has_what_was_known_and_what_was_found() -> None:
    """Causes join the known effects, at their fitted sizes or, where nothing shows them, as they are stated; what a
    richer model variant has is left to that variant."""
    known, unseen = (parse(f"viscous_friction:joint_{k}:coefficient=3", ROBOT) for k in (1, 3))
    context: Any = SimpleNamespace(known=(known,), unseen=(unseen,), fitted=SimpleNamespace(robot=ROBOT))
    found: Any = SimpleNamespace(context=context, causes=(cause(), cause("inertia_coupling")))
    effects = repaired_robot(ROBOT, found).effects
    assert [(e["effect"], e["joint"]) for e in effects] == [
        ("viscous_friction", "joint_1"),
        ("viscous_friction", "joint_3"),
        ("coulomb_friction", "joint_2"),
    ]


def test_every_cause_states_what_it_is_of_the_corrected_arm() -> None:
    """`held_as` is what robot.yaml does with a cause, whose effects are those that are held as one, and no others."""
    friction = cause()
    kinds = {
        "effect": friction,
        "number": replace(friction, refitted=True),
        "variant": cause("inertia_coupling"),
        None: friction.against(3.0),
    }
    assert {kind: one.to_dict()["held_as"] for kind, one in kinds.items()} == {kind: kind for kind in kinds}
    for kind, one in kinds.items():
        found = diagnosis(one)
        assert len(repaired_robot(ROBOT, found).effects) == (kind == "effect")
        assert holds_any(found.causes) == (kind in ("effect", "number"))


def test_a_number_of_the_arm_is_held_though_it_stands_in() -> None:
    """The refitted numbers are in robot.yaml whatever they stand for: the result has both facts."""
    number = replace(cause(), refitted=True).against(3.0).to_dict()
    assert (number["held_as"], number["stands_in"]) == ("number", True)


def test_a_small_term_of_friction_stays_in_the_corrected_arm() -> None:
    """It is there beyond doubt: where its size changes between recordings it is less certain, and held all the same."""
    small = replace(cause(), minor=True).against(3.0)
    assert small.confidence == pytest.approx(0.25 * cause().confidence)
    assert small.held_as == "effect" and repaired_robot(ROBOT, diagnosis(small)).effects
