"""A pipeline fails at the answers that it asked to fail at, and at no others."""

from types import SimpleNamespace
from typing import Any

import pytest
import typer

from elastic_arm.cli.gate import check_gate, pass_gate
from elastic_arm.diagnosis.result import Change
from elastic_arm.errors import DiagnosisError

CHANGE = Change(
    "coulomb_friction", "joint_2", "torque", "Nm", (("march", 6.0, 0.1), ("may", 6.6, 0.1)), 0.999
)


def found(verdict: str = "none", *changes: Change, causes: tuple[Any, ...] = ()) -> Any:
    """Return as much of a diagnosis as a gate looks at."""
    return SimpleNamespace(verdict=verdict, changes=changes, causes=causes)


@pytest.mark.parametrize(
    ("diagnosis", "gates"),
    [
        (found("unknown"), ["unknown"]),
        (found("explained"), ["unknown", "explained"]),
        (found("none", CHANGE), ["change:5%"]),
    ],
)
def test_what_was_asked_for_ends_with_status_one(
    diagnosis: Any, gates: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """One line on stderr says which gate it was."""
    with pytest.raises(typer.Exit) as end:
        pass_gate(diagnosis, gates)
    assert end.value.exit_code == 1
    out, told = capsys.readouterr()
    assert not out and told.startswith("failed: ") and len(told.splitlines()) == 1


def test_a_known_effect_that_is_not_as_stated_is_a_change() -> None:
    """Friction stated as 6 Nm and found to be 9 Nm changed by half; a cause of which nothing is
    stated did not."""
    torque = {"torque": SimpleNamespace(value=9.0)}
    stated = SimpleNamespace(
        effect="coulomb_friction", joint="joint_2", parameters=torque, stated={"torque": 6.0}
    )
    pass_gate(found(causes=(stated,)), ["change:50%"])
    with pytest.raises(typer.Exit):
        pass_gate(found(causes=(stated,)), ["change:49%"])
    new = SimpleNamespace(effect="backlash", joint="joint_2", parameters=torque, stated=None)
    pass_gate(found(causes=(new,)), ["change:5%"])


def test_other_answers_pass() -> None:
    """A clean arm passes all gates, and a change of 10 % one of 20 %; without a gate all pass."""
    pass_gate(found(), ["unknown", "explained", "change:5%"])
    pass_gate(found("explained", CHANGE), ["unknown", "change:20%"])
    pass_gate(found("unknown", CHANGE), [])


@pytest.mark.parametrize("gate", ["none", "change", "change:5", "change:-5%", ""])
def test_what_is_no_gate_is_refused_before_the_work(gate: str) -> None:
    """With the words that are gates."""
    with pytest.raises(DiagnosisError, match="--fail-on"):
        check_gate([gate])
