"""A number of the arm that is far off, of an arm whose other numbers are exact."""

import pytest

from elastic_arm.diagnosis import Question, diagnose
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.nightly import nightly


@pytest.mark.parametrize("stiffness", [0.4, *nightly([1.8])])
def test_a_stiffness_far_off_is_a_cause_and_no_reason_to_trust_the_description_less(
    stiffness: float,
) -> None:
    """By the columns of the described stiffness it looks like a description that is off
    everywhere."""
    effect = f"stiffness_mismatch:joint_2:stiffness={stiffness}"
    fitted, judged = (record(motion, effect, seed=k) for k, motion in enumerate(motions()))
    found = diagnose(
        [fitted],
        Question(ROBOT, effects=["stiffness_mismatch", "damping_mismatch", "payload"]),
        [judged],
    )
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.joint) == (
        "explained",
        "stiffness_mismatch",
        "joint_2",
    )
    assert cause.parameters["stiffness"].value == pytest.approx(stiffness, rel=1e-3)
