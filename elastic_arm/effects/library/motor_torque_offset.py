"""A motor torque with a wrong zero."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.model import Confusion, Effect, SensorEffect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter
from elastic_arm.sensors import Sensors


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """The offset.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `offset` (Nm).
    """
    return motion.at(i, motor=p["offset"])


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
    return sensors.changed("motor_torque", i, n, offset=p["offset"])


EFFECT: Effect = SensorEffect(
    id="motor_torque_offset",
    formula="tau_m recorded = true + offset",
    description="The zero of the motor's current measurement is off.",
    signature="The motor residual is a constant, at rest and in motion.",
    law=law,
    parameters=(Parameter("offset", "Nm", -50.0, 50.0, neutral=0.0, meaning="recorded - true"),),
    sides=("motor",),
    regime="always",
    change=change,
    prior=lambda rate: 1.0,
    confusions=(
        Confusion(
            "coulomb_friction",
            "the joint turns one way throughout",
            "reversals: friction changes sign there",
        ),
    ),
)
