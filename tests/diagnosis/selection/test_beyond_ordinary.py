"""Causes that the nuisance parameters could hold, and their rivals."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from elastic_arm.diagnosis.selection import beyond_ordinary
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Rival


def candidate(name: str) -> Any:
    """Return a stand-in of a candidate, with the key of its feature."""
    return SimpleNamespace(feature=SimpleNamespace(key=(name, None, ())))


def test_rivals_of_what_nuisance_parameters_could_hold_are_judged_by_all_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held-out data say nothing of a payload that masses could hold: dry friction seemed to be as good."""
    payload, friction = candidate("payload"), candidate("friction")
    library = cast("Any", SimpleNamespace(both=lambda chosen: 500.0 if payload in chosen else 10.0))
    monkeypatch.setattr(beyond_ordinary, "misfit", lambda *_: 1.0)
    hypothesis = Hypothesis((payload,), 0, {0: [Rival(friction, 1.0)]})
    (left,) = beyond_ordinary._rivals_by_all_data(library, hypothesis, 0, {payload.feature.key})
    assert left.odds < 1e-9
    (kept,) = beyond_ordinary._rivals_by_all_data(library, hypothesis, 0, set())
    assert kept.odds == 1.0
