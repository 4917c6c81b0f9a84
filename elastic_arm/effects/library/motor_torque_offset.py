"""A motor torque with a wrong zero."""

from elastic_arm.effects.library.sensor_error import changing, misread, offset
from elastic_arm.effects.model import Confusion, Effect, SensorEffect

EFFECT: Effect = SensorEffect(
    id="motor_torque_offset",
    formula="tau_m recorded = true + offset",
    description="The zero of the motor's current measurement is off.",
    signature="The motor residual is a constant, at rest and in motion.",
    law=misread("motor_torque", lambda motion, i, p: p["offset"]),
    parameters=(offset("Nm", 50.0),),
    sides=("motor",),
    regime="always",
    change=changing("motor_torque", offset="offset"),
    prior=lambda rate: 0.4,
    set_at_start=True,
    confusions=(
        Confusion("coulomb_friction", "the joint turns one way throughout", "reversals: friction changes sign there"),
    ),
)
