"""Which causes are left at last, with estimates made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.diagnosis.inference import estimated_hypothesis
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.plausible_hypothesis import turns_over
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import EFFECTS


def friction(effect: str, joint: str, *speed: float) -> Any:
    """A candidate of friction at a joint."""
    parameters = [p for p in EFFECTS[effect].parameters if p.role.value == "searched"]
    feature = SimpleNamespace(effect=EFFECTS[effect], joint=joint, key=(effect, joint), searched=parameters)
    return SimpleNamespace(feature=feature, searched=speed)


def test_of_two_causes_of_a_joint_that_need_each_other_the_last_found_goes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Coulomb and Stribeck friction, each uncertain beside the other: without the second the first one is certain."""
    dry, other = friction("coulomb_friction", "joint_1"), friction("coulomb_friction", "joint_2")
    curve = friction("stribeck_friction", "joint_1", 0.1)

    def beside(prepared: Any, selected: Any, faults: Any) -> tuple[Any, list[Any]]:
        uncertain = {k for k, one in enumerate(selected) if one in (dry, curve)} if curve in selected else set()
        estimates = SimpleNamespace(insignificant=lambda selected, level: uncertain, polished=lambda selected: selected)
        fit = SimpleNamespace(selected=selected)
        return SimpleNamespace(
            needed=set,
            fit=fit,
            estimates=estimates,
            insignificant=estimates.insignificant,
            polished=estimates.polished,
        ), []

    monkeypatch.setattr(estimated_hypothesis, "_beside_faults", beside)
    monkeypatch.setattr(estimated_hypothesis, "faults_beside", lambda *_, **__: ())
    library = SimpleNamespace(nuisance=SimpleNamespace(turned_over={}))
    prepared: Any = SimpleNamespace(library=library, settings=DiagnosisSettings())
    left, *_ = estimated_hypothesis._that_last(prepared, Hypothesis([dry, other, curve]), ())
    assert list(left.selected) == [dry, other]


@pytest.mark.parametrize(("speed", "expected"), [(0.03, True), (0.05, False)])
def test_friction_below_where_that_of_its_joint_turns_over_is_how_it_does(speed: float, expected: bool) -> None:
    """Each joint has a speed of its own; of another one, or of none, nothing is said."""
    slowest = {"joint_1": 0.04}
    assert turns_over(friction("stribeck_friction", "joint_1", speed), slowest) == expected
    assert not turns_over(friction("stribeck_friction", "joint_2", speed), slowest)
    assert not turns_over(friction("coulomb_friction", "joint_1"), slowest)
