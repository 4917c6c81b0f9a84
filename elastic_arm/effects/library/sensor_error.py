"""What errors of torque sensors and encoders share: the law of a wrong reading, and the changed channel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Law
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter
from elastic_arm.sensors import Sensors

# Which residuals hold a channel.
SIDES = {"joint_torque": ("link", "drive", "motor"), "motor_torque": ("motor",), "link_encoder": ("link", "drive")}
TORQUES = ("joint_torque", "motor_torque")

# The error is linear in 1 - 1/gain, which is the coefficient that a fit gives its column.
GAIN = Parameter(
    "gain", "1", 0.5, 2.0, neutral=1.0, above=0.0, meaning="recorded / true", from_coefficient=lambda c: 1.0 / (1.0 - c)
)


def offset(unit: str, most: float, example: tuple[float, float] | None = None) -> Parameter:
    """Return the parameter of a wrong zero."""
    return Parameter("offset", unit, -most, most, neutral=0.0, example=example, meaning="recorded - true")


def sides_of(p: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the residuals that hold the channels of an effect, by its choice `channels`, or `channel`."""
    chosen = p["channels"] if "channels" in p else (p["channel"],)
    return tuple(side for side in ("link", "drive", "motor") if any(side in SIDES[channel] for channel in chosen))


def misread(channel: str, error: Callable[[SymbolicMotion, int, Mapping[str, Any]], Any]) -> Law:
    """Return the law of an error (motion, joint index, parameters) -> recorded - true torque (Nm) of a channel.

    The motor equation holds the joint torque with the other sign.
    """

    def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
        more = error(motion, i, p)
        if channel == "motor_torque":
            return motion.at(i, motor=more)
        return motion.at(i, link=more, drive=more, motor=-more)

    return law


def gain_error(recorded: ca.SX, p: Mapping[str, Any]) -> ca.SX:
    """Return recorded - true torque of a wrong gain, by what was recorded."""
    return (1.0 - 1.0 / p["gain"]) * recorded


def changing(channel: str, **numbers: str) -> Callable[[Sensors, int, int, Mapping[str, Any]], Sensors]:
    """Return the change that gives numbers of a joint's channel the values of parameters: `gain="gain"`."""

    def change(sensors: Sensors, i: int, n: int, p: Mapping[str, Any]) -> Sensors:
        return sensors.changed(channel, i, n, **{number: p[name] for number, name in numbers.items()})

    return change
