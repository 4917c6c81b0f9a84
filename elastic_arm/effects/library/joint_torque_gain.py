"""A joint torque sensor that reads too much or too little."""

from elastic_arm.effects.library.sensor_error import GAIN, changing, gain_error, misread
from elastic_arm.effects.model import Confusion, Effect, SensorEffect

EFFECT: Effect = SensorEffect(
    id="joint_torque_gain",
    formula="tau_J recorded = gain * true",
    description="The joint torque sensor is scaled wrongly.",
    signature="All three residuals of the joint follow the joint torque, that of the motor with the other sign.",
    law=misread("joint_torque", lambda motion, i, p: gain_error(motion.tau_J[i], p)),
    parameters=(GAIN,),
    sides=("link", "drive", "motor"),
    regime="load",
    change=changing("joint_torque", gain="gain"),
    prior=lambda rate: 0.01,  # strain gauges: up to 2 % of the reading, as two deviations
    confusions=(
        Confusion("stiffness_mismatch", "only the drive equation can be used", "the link or motor equation"),
        Confusion(
            "link_inertia_mismatch",
            "one gain on all torque sensors scales all masses, K and D alike",
            "motor torques: they do not pass through the joint torque sensors",
        ),
    ),
)
