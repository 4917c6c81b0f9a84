"""A motor torque that is recorded too large or too small."""

from elastic_arm.effects.library.sensor_error import GAIN, changing, gain_error, misread
from elastic_arm.effects.model import Confusion, Effect, SensorEffect

EFFECT: Effect = SensorEffect(
    id="motor_torque_gain",
    formula="tau_m recorded = gain * true",
    description="The motor's torque constant is not what the drive believes.",
    signature="The motor residual follows the motor torque itself, through rest and motion alike.",
    law=misread("motor_torque", lambda motion, i, p: gain_error(motion.tau_m[i], p)),
    parameters=(GAIN,),
    sides=("motor",),
    regime="load",
    change=changing("motor_torque", gain="gain"),
    prior=lambda rate: 0.015,  # current sensors and calibrated torque constants: up to 3 %, as two deviations
    confusions=(
        Confusion(
            "rotor_inertia_mismatch",
            "no gravity or load acts on the joint, as on a vertical first axis",
            "motion in which other joints or gravity load this one",
        ),
    ),
)
