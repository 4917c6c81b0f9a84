"""Arms of which one side is not recorded as a whole."""

from dataclasses import replace

import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.recording import Recording
from elastic_arm.recording.sides import Side
from tests.helpers.gap_recordings import ROBOT, motions, record


def test_motor_torques_without_motor_angles_show_friction_of_the_motors() -> None:
    """Beside joint torque sensors a current alone gives the motor's equation: its friction has its
    place and size."""

    def without_motor_angles(recording: Recording) -> Recording:
        assert recording.motor is not None
        return replace(
            recording, motor=Side(recording.motor.stamp_ns, effort=recording.motor.effort)
        )

    identify, validate = (
        without_motor_angles(record(motion, "coulomb_friction:joint_2:torque=15", seed=k))
        for k, motion in enumerate(motions())
    )
    few = ("coulomb_friction", "viscous_friction", "stiffness_mismatch", "motor_torque_gain")
    found = diagnose([identify], Question(ROBOT, effects=few), [validate])
    assert [(cause.effect, cause.joint, cause.sides) for cause in found.causes] == [
        ("coulomb_friction", "joint_2", ("motor",))
    ]
    assert found.causes[0].parameters["torque"].value == pytest.approx(15.0, rel=0.03)
