"""Link encoders at three of six joints: causes are found at joints with and without them."""

from __future__ import annotations

import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.result import Diagnosis
from tests.helpers.partial_arm import ENCODERS, recordings, robot

pytestmark = pytest.mark.slow(60)

FRICTION = ("viscous_friction", 3, "motor", "coefficient", 8.0)
SOFT = ("stiffness_mismatch", 1, "drive", "stiffness", 0.8)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    fit, judge = recordings(FRICTION, SOFT)
    return diagnose([fit], Question(robot()), [judge])


def test_causes_are_found_at_joints_with_and_without_a_link_encoder(found: Diagnosis) -> None:
    """A soft drive with both encoders, and friction at a wrist joint with the motor's alone."""
    causes = {(c.effect, c.joint): c for c in found.causes}
    assert {("stiffness_mismatch", "joint_2"), ("viscous_friction", "joint_4")} <= set(causes)
    friction = causes["viscous_friction", "joint_4"].parameters["coefficient"]
    assert friction.value == pytest.approx(8.0, rel=0.1)


def test_only_equations_that_a_joint_has_are_in_the_result(found: Diagnosis) -> None:
    """Nine residuals: link and motor side of three joints, the motor side of the other three."""
    expected = {(joint, "motor") for joint in robot().joint_names}
    expected |= {(joint, "link") for joint in robot().joint_names[:ENCODERS]}
    assert set(found.before.rmse) == set(found.noise) == set(found.shrink_by_place) == expected
