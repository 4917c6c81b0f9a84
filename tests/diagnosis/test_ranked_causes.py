"""Which causes are listed beside laws that no catalogue states."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from elastic_arm.diagnosis.laws.better_laws import BetterLaws
from elastic_arm.diagnosis.ranked_causes import RankedCause, is_listed
from elastic_arm.diagnosis.result import Cause
from elastic_arm.effects import parse
from elastic_arm.robot import load_robot

LEAST = 0.01


def ranked(confidence: float, *, minor: bool = False) -> RankedCause:
    instance = parse("coulomb_friction:joint_2:torque=6", load_robot(None))
    cause = Cause("coulomb_friction", "joint_2", ("motor",), "", {}, 0.5, confidence, (), instance, minor=minor)
    candidate: Any = SimpleNamespace(feature=SimpleNamespace(key="friction"))
    return RankedCause(cause, candidate, (), [])


def laws(*, instead: bool = False, approximated: bool = False) -> BetterLaws:
    law: Any = SimpleNamespace()
    refuted: Any = {"friction": law} if instead else {}
    imitating: Any = frozenset({"friction"} if approximated else ())
    return BetterLaws(instead=refuted, approximated=imitating)


@pytest.mark.parametrize(
    ("cause", "beside", "listed"),
    [
        (ranked(0.5), laws(), True),
        (ranked(1e-9), laws(instead=True), False),
        (ranked(1e-9), laws(instead=True, approximated=True), True),
        (ranked(0.5, minor=True), laws(), True),
        (ranked(1e-9, minor=True), laws(instead=True, approximated=True), False),
    ],
)
def test_what_stands_in_for_a_law_is_listed_where_it_is_large_and_like_it(
    cause: RankedCause, beside: BetterLaws, listed: bool
) -> None:
    """A refuted cause is listed where it takes most of what the law does; a small term of friction never is, as such
    a term is listed where it is there beyond doubt."""
    assert is_listed(cause, beside, LEAST) == listed
