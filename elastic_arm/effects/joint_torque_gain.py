"""A joint torque sensor that reads too much or too little."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.base import Confusion, Effect, Parameter, SensorEffect
from elastic_arm.effects.motion import Contribution, Motion
from elastic_arm.sensors import Sensors


def law(motion: Motion, i: int, p: Mapping[str, Any]) -> Contribution:
    """In recorded torque: (1 - 1/gain) tau_J, which the motor equation has with the other sign."""
    error = (1.0 - 1.0 / p["gain"]) * motion.tau_J[i]
    return motion.at(i, link=error, drive=error, motor=-error)


def change(sensors: Sensors, i: int, n: int, p: Mapping[str, Any]) -> Sensors:
    """Scale the channel."""
    return sensors.changed("joint_torque", i, n, gain=p["gain"])


EFFECT: Effect = SensorEffect(
    id="joint_torque_gain",
    formula="tau_J recorded = gain * true",
    description="The joint torque sensor is scaled wrongly.",
    signature="All three residuals of the joint follow the joint torque, that of the motor with the other sign.",
    law=law,
    parameters=(
        Parameter(
            "gain",
            "1",
            0.5,
            2.0,
            neutral=1.0,
            above=0.0,
            meaning="recorded / true",
            from_coefficient=lambda c: 1.0 / (1.0 - c),
        ),
    ),
    sides=("link", "drive", "motor"),
    regime="load",
    change=change,
    confusions=(
        Confusion(
            "stiffness_mismatch",
            "only the drive equation can be used",
            "the link or motor equation",
        ),
        Confusion(
            "link_inertia_mismatch",
            "one gain on all torque sensors scales all masses, K and D alike",
            "motor torques: they do not pass through the joint torque sensors",
        ),
    ),
)
