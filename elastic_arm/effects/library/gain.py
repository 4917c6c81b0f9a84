"""What the gains of the torque sensors share: the parameter, the error of a recorded torque, the scaled channel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.parameters import Parameter
from elastic_arm.sensors import Sensors

# The error is linear in 1 - 1/gain, which is the coefficient that a fit gives its column.
GAIN = Parameter(
    "gain",
    "1",
    0.5,
    2.0,
    neutral=1.0,
    above=0.0,
    meaning="recorded / true",
    from_coefficient=lambda c: 1.0 / (1.0 - c),
)


def excess(recorded: ca.SX, p: Mapping[str, Any]) -> ca.SX:
    """Return recorded - true torque, by what was recorded."""
    return (1.0 - 1.0 / p["gain"]) * recorded


def scaling(channel: str) -> Callable[[Sensors, int, int, Mapping[str, Any]], Sensors]:
    """Return the change that scales a channel of a joint."""

    def change(sensors: Sensors, i: int, n: int, p: Mapping[str, Any]) -> Sensors:
        return sensors.changed(channel, i, n, gain=p["gain"])

    return change
