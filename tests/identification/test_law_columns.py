"""Columns of laws beside the model's own."""

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import parse
from elastic_arm.errors import IdentificationError
from elastic_arm.identification import parse_laws
from elastic_arm.identification.law_columns import law_columns
from elastic_arm.robot import load_robot
from tests.helpers.smooth_motion import smooth_motion

ROBOT = load_robot(None)
MODEL = build_model(ROBOT, "mod3")


def test_laws_of_identification_need_no_course_of_time() -> None:
    """Samples in any order give the same columns, in that order; missing torques are taken for
    zero."""
    (column,) = law_columns(
        [parse("viscous_friction:joint_2:coefficient=1,side=motor", ROBOT)], ROBOT
    )
    whole = smooth_motion(MODEL, samples=50)
    order = np.random.default_rng(0).permutation(50)
    found = column.values(whole)
    shuffled = column.values(whole[order])
    assert column.name == "viscous_friction:joint_2.coefficient"
    np.testing.assert_array_equal(found[order], shuffled)
    np.testing.assert_allclose(found[:, 2 * ROBOT.n + 1], np.asarray(whole.dtheta)[:, 1])


def test_a_value_of_what_is_to_be_found_is_refused() -> None:
    """A size that is given with a law would be ignored; what the columns need, such as a rest
    angle, is taken."""
    with pytest.raises(
        IdentificationError,
        match=r"identification estimates torque.*Omit it: .*:joint_2\.",
    ):
        parse_laws(["coulomb_friction:joint_2:torque=3"], ROBOT)
    (spring,) = parse_laws(["joint_spring:joint_2:rest=0.3"], ROBOT)
    assert spring.parameters["rest"] == 0.3


@pytest.mark.parametrize("law", ["motor_torque_gain", "joint_torque_gain:joint_2"])
def test_a_torque_gain_is_refused_beside_masses(law: str) -> None:
    """With a free torque gain, masses of zero explain every torque, so nothing is identified."""
    with pytest.raises(IdentificationError, match=r"zero masses explain every torque.*--refit"):
        parse_laws([law], ROBOT)
