"""A motor torque that is recorded too large or too small."""

from collections.abc import Mapping
from typing import Any

from elastic_arm.effects.base import Confusion, Effect, Parameter, SensorEffect
from elastic_arm.effects.motion import Contribution, Motion
from elastic_arm.sensors import Sensors


def law(motion: Motion, i: int, p: Mapping[str, Any]) -> Contribution:
    """In recorded torque: (1 - 1/gain) tau_m."""
    return motion.at(i, motor=(1.0 - 1.0 / p["gain"]) * motion.tau_m[i])


def change(sensors: Sensors, i: int, n: int, p: Mapping[str, Any]) -> Sensors:
    """Scale the channel."""
    return sensors.changed("motor_torque", i, n, gain=p["gain"])


EFFECT: Effect = SensorEffect(
    id="motor_torque_gain",
    formula="tau_m recorded = gain * true",
    description="The motor's torque constant is not what the drive believes.",
    signature="The motor residual follows the motor torque itself, through rest and motion alike.",
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
    sides=("motor",),
    regime="load",
    change=change,
    confusions=(
        Confusion(
            "rotor_inertia_mismatch",
            "no gravity or load acts on the joint, as on a vertical first axis",
            "motion in which other joints or gravity load this one",
        ),
    ),
)
