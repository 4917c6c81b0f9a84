"""A number of the arm that is far off, of an arm whose other numbers are exact."""

import pytest

from elastic_arm.diagnosis import Question, diagnose
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.nightly import nightly

MECHANICAL = ("stiffness_mismatch", "damping_mismatch", "payload")


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
        Question(ROBOT, effects=MECHANICAL),
        [judged],
    )
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.joint) == (
        "explained",
        "stiffness_mismatch",
        "joint_2",
    )
    assert cause.parameters["stiffness"].value == pytest.approx(stiffness, rel=1e-3)


@pytest.mark.nightly
def test_a_drive_half_as_stiff_is_no_law_over_its_load() -> None:
    """Scores at the described and at the true stiffness compare by the noise of the sensors, which
    is the same at both: a law over the load, which leaves the stiffness as described, does not
    win."""
    effect = "stiffness_mismatch:joint_2:stiffness=0.5"
    fitted, judged = (record(motion, effect, seed=k) for k, motion in enumerate(motions()))
    found = diagnose([fitted], Question(ROBOT, effects=MECHANICAL), [judged])
    assert found.verdict == "explained"
    assert [(cause.effect, cause.joint) for cause in found.causes] == [
        ("stiffness_mismatch", "joint_2")
    ]


def test_a_gain_that_the_catalogue_lacks_is_unknown() -> None:
    """A gain of 1.2 resembles gravity compensation, but is not named as such where it is not in the
    catalogue itself."""
    effect = "motor_torque_gain:joint_2:gain=1.2"
    fitted, judged = (record(motion, effect, seed=k) for k, motion in enumerate(motions()))
    candidates = Question(ROBOT).candidates
    others = tuple(e for e in candidates if e.id != "motor_torque_gain")
    found = diagnose([fitted], Question(ROBOT, effects=others), [judged])
    assert found.verdict == "unknown"
    assert not found.causes
    assert any("acts as motor_torque_gain" in note for note in found.notes)
