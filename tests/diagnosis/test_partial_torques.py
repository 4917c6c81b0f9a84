"""Torques at two of three joints: causes are found where they show, and nothing is said of the
third joint."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.preparation import prepare
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.recording import Recording
from tests.helpers.gap_recordings import ROBOT, motions, record

BARE = "joint_2"


def without_motor_side(recording: Recording) -> Recording:
    """Return what joint torque sensors and encoders behind the drives read, no torque at one
    joint."""
    assert recording.link is not None and recording.link.effort is not None
    effort = recording.link.effort.copy()
    effort[:, ROBOT.joint_names.index(BARE)] = np.nan
    return replace(recording, link=replace(recording.link, effort=effort), motor=None)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    acting = [f"viscous_friction:{joint}:coefficient=8,side=link" for joint in ("joint_1", BARE)]
    fit, judge = (
        without_motor_side(record(motion, *acting, seed=k)) for k, motion in enumerate(motions())
    )
    known = parse(f"coulomb_friction:{BARE}:torque=3,side=link", ROBOT)
    effects = (EFFECTS["viscous_friction"],)
    return diagnose([fit], Question(ROBOT, effects=effects, given=(known,), refit=True), [judge])


def test_known_friction_of_a_motor_without_a_torque_is_not_seen_beside_its_encoders() -> None:
    """With both encoders the joint has the equation of its link, in which friction of its motor is
    not."""
    recordings = []
    for k, motion in enumerate(motions()):
        one = record(motion, seed=k)
        assert one.link is not None and one.motor is not None and one.motor.effort is not None
        effort = one.motor.effort.copy()
        effort[:, ROBOT.joint_names.index(BARE)] = np.nan
        recordings.append(
            replace(
                one, link=replace(one.link, effort=None), motor=replace(one.motor, effort=effort)
            )
        )
    known = tuple(parse(f"coulomb_friction:{joint}:torque=3", ROBOT) for joint in ("joint_1", BARE))
    effects = (EFFECTS["viscous_friction"],)
    prepared = prepare(
        recordings[:1], recordings[1:], Question(ROBOT, effects=effects, given=known)
    )
    assert [given.joint for given in prepared.problem.given] == ["joint_1"]
    assert any(
        "no motor torque was recorded: coulomb_friction on joint_2" in note
        for note in prepared.notes
    )
    sides = {(one.joint, one.choices["side"]) for one in prepared.problem.candidates}
    assert (BARE, "link") in sides and (BARE, "motor") not in sides


def test_friction_is_found_where_a_torque_shows_it(found: Diagnosis) -> None:
    """Viscous friction of joint 1 comes out within a tenth, and no cause is named at the joint
    without a torque."""
    assert [(cause.effect, cause.joint) for cause in found.causes] == [
        ("viscous_friction", "joint_1")
    ]
    assert found.causes[0].parameters["coefficient"].value == pytest.approx(8.0, rel=0.1)


def test_the_joint_without_a_torque_is_named_and_has_no_residual(found: Diagnosis) -> None:
    """Residuals are those of two joints; what is known of the third stays as it is, and nothing
    drives a prediction."""
    assert {joint for joint, _ in found.before.rmse} == set(ROBOT.joint_names) - {BARE}
    assert any(note.startswith(f"{BARE}: no torque was recorded") for note in found.notes)
    assert any("not visible" in note and BARE in note for note in found.notes)
    assert all(np.isfinite(list(found.before.rmse.values())))
