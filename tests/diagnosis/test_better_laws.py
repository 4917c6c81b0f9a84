"""Effects that no catalogue has end as unknown, and effects that it has keep their names."""

from __future__ import annotations

from functools import cache

import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.robot import load_robot
from tests.helpers.hidden_arms import recordings

pytestmark = pytest.mark.slow(40)


@cache
def diagnosed(*numbers: object) -> Diagnosis:
    """Return the diagnosis of a hidden arm with one effect."""
    identify, validate = recordings(numbers)
    return diagnose([identify], Question(load_robot(None)), [validate])


@pytest.mark.parametrize(
    ("effect", "side", "regime"),
    [
        (("oil_drag", 1, "motor", "coefficient", 3.0), "motor", "high_speed"),
        (("cogging_cable", 1, "link", "torque", 1.0, "rate", 10.0, "phase", 0.3), "link", "position"),
        (("gear_creep", 1, "motor", "stiffness", 3000.0, "relaxation", 1.0), "drive", None),
        (("dragging_brake", 1, "motor", "torque", 2.0, "on", 2.0, "off", 5.0), "motor", None),
    ],
)
def test_an_effect_of_no_catalogue_is_unknown_with_its_place(
    effect: tuple[object, ...], side: str, regime: str | None
) -> None:
    """It is placed first, at its joint and side."""
    found = diagnosed(*effect)
    assert found.verdict == "unknown"
    place = found.unexplained[0]
    assert (place.joint, place.side) == ("joint_2", side)
    assert regime in (None, place.regime)


@pytest.mark.parametrize(
    "effect",
    [
        ("stribeck_friction", 1, "motor", "torque", 2.0, "speed", 0.1),
        ("load_dependent_friction", 1, "motor", "coefficient", 0.05),
        ("nonlinear_stiffness", 1, "drive", "cubic", 3e8),
        ("hysteresis", 1, "drive", "torque", 3.0, "width", 1e-4),
        ("joint_spring", 1, "link", "stiffness", 30.0, "rest", 0.2),
    ],
)
def test_an_effect_of_the_catalogue_keeps_its_name(effect: tuple[object, ...]) -> None:
    """A law of the right form is not given up for one without a form."""
    found = diagnosed(*effect)
    assert found.verdict == "explained"
    assert [(cause.effect, cause.joint) for cause in found.causes] == [(effect[0], "joint_2")]
    assert found.causes[0].confidence > 0.9
