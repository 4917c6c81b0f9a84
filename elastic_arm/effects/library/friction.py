"""What the friction effects share: a side, its velocity, and a torque that resists."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Law
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Choice

DRY = "coulomb_friction"
PLAIN = ("viscous_friction", DRY)  # what every joint has, in the first place
SIDE = Choice("side", ("motor", "link"), "motor")


def chosen_side(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the side the friction acts on."""
    return (parameters["side"],)


def resisting(torque: Callable[[ca.SX, ca.SX, Mapping[str, Any]], ca.SX]) -> Law:
    """Return the law of a friction torque (velocity, its sign, parameters) -> Nm on the chosen side."""

    def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
        side = p["side"]
        resistance: dict[str, Any] = {side: torque(motion.velocity(side)[i], motion.sign(side, i), p)}
        return motion.at(i, **resistance)

    return law
