"""Link encoders at three of six joints: causes are found at joints with and without them."""

from __future__ import annotations

import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.result import Diagnosis
from tests.helpers.partial_arm import ENCODERS, recordings, robot

pytestmark = pytest.mark.slow(60)

SIZES = {"joint_2": 15.0, "joint_4": 8.0}  # Nm s/rad
FRICTION = [
    ("viscous_friction", robot().joint_names.index(joint), "motor", "coefficient", size)
    for joint, size in SIZES.items()
]


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    fit, judge = recordings(*FRICTION)
    return diagnose([fit], Question(robot()), [judge])


def test_friction_is_found_at_joints_with_and_without_a_link_encoder(found: Diagnosis) -> None:
    """Viscous friction of joint 2, with both encoders, and of joint 4, with the motor's alone, each within 10 %."""
    sizes = {c.joint: c.parameters["coefficient"].value for c in found.causes if c.effect == "viscous_friction"}
    assert sizes == {joint: pytest.approx(size, rel=0.1) for joint, size in SIZES.items()}


def test_only_equations_that_a_joint_has_are_in_the_result(found: Diagnosis) -> None:
    """Nine residuals: link and motor side of three joints, the motor side of the other three."""
    expected = {(joint, "motor") for joint in robot().joint_names}
    expected |= {(joint, "link") for joint in robot().joint_names[:ENCODERS]}
    assert set(found.before.rmse) == set(found.noise) == set(found.shrink_by_place) == expected
