"""A joint torque sensor with a wrong zero."""

from elastic_arm.effects.library.sensor_error import changing, misread, offset
from elastic_arm.effects.model import Confusion, Effect, SensorEffect

EFFECT: Effect = SensorEffect(
    id="joint_torque_offset",
    formula="tau_J recorded = true + offset",
    description="The zero of the joint torque sensor is off.",
    signature="All three residuals of the joint are shifted by a constant, that of the motor the other way.",
    law=misread("joint_torque", lambda motion, i, p: p["offset"]),
    parameters=(offset("Nm", 50.0, example=(2.0, 6.0)),),
    sides=("link", "drive", "motor"),
    regime="always",
    change=changing("joint_torque", offset="offset"),
    prior=lambda rate: 0.4,
    set_at_start=True,
    confusions=(
        Confusion(
            "encoder_offset",
            "only the drive equation can be used",
            "the link or motor equation: an encoder offset does not show there",
        ),
    ),
)
