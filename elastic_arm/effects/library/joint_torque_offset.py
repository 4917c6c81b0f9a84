"""A joint torque sensor with a wrong zero."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter
from elastic_arm.sensors import Sensors


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """The offset, which the motor equation has with the other sign.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `offset` (Nm).
    """
    return motion.at(i, link=p["offset"], drive=p["offset"], motor=-p["offset"])


def change(sensors: Sensors, i: int, n: int, p: Mapping[str, Any]) -> Sensors:
    """Shift the channel.

    Parameters
    ----------
    sensors
        Of the arm.
    i, n
        Index of the joint, and number of joints.
    p
        `offset` (Nm).
    """
    return sensors.changed("joint_torque", i, n, offset=p["offset"])


EFFECT: Effect = SensorEffect(
    id="joint_torque_offset",
    formula="tau_J recorded = true + offset",
    description="The zero of the joint torque sensor is off.",
    signature="All three residuals of the joint are shifted by a constant, that of the motor the other way.",
    law=law,
    parameters=(Parameter("offset", "Nm", -50.0, 50.0, neutral=0.0, example=(2.0, 6.0), meaning="recorded - true"),),
    sides=("link", "drive", "motor"),
    regime="always",
    change=change,
    prior=lambda rate: 1.0,
    confusions=(
        Confusion(
            "encoder_offset",
            "only the drive equation can be used",
            "the link or motor equation: an encoder offset does not show there",
        ),
    ),
)
