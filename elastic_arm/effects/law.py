"""The imports of a file with a law, and parameters that many laws share."""

from collections.abc import Mapping
from math import pi
from typing import Any

from elastic_arm.effects.effect import (
    Confusion,
    ControllerEffect,
    Effect,
    Law,
    Plant,
    Scope,
    SensorEffect,
    StructuralEffect,
    no_controller,
)
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Choice, Parameter, Role

Numbers = Mapping[str, Any]  # parameters, choices and internal states of an effect, by name


def amount(name: str, unit: str, low: float, high: float, meaning: str, **more: Any) -> Parameter:
    """Return a size that no arm has below zero, without effect at zero.

    `more` as of :class:`.Parameter`.
    """
    return Parameter(name, unit, low, high, neutral=0.0, least=0.0, meaning=meaning, **more)


def signed(name: str, unit: str, most: float, meaning: str, **more: Any) -> Parameter:
    """Return a number of either sign, and at zero no effect."""
    return Parameter(name, unit, -most, most, neutral=0.0, meaning=meaning, **more)


def ratio(name: str, low: float, high: float, meaning: str, **more: Any) -> Parameter:
    """Return a ratio to the model's number, 1 for no effect."""
    return Parameter(name, "1", low, high, neutral=1.0, meaning=meaning, **more)


def searched(name: str, unit: str, low: float, high: float, meaning: str, **more: Any) -> Parameter:
    """Return a parameter that is only found by trying values."""
    return Parameter(name, unit, low, high, role=Role.SEARCHED, meaning=meaning, **more)


def phase() -> Parameter:
    """Return the phase of a sine, whose amplitude is the parameter before it."""
    return Parameter("phase", "rad", -pi, pi, role=Role.PHASE, default=0.0, meaning="phi")


__all__ = [
    "Choice", "Confusion", "Contribution", "ControllerEffect", "Effect", "Law", "Numbers",
    "Parameter", "Plant", "Role", "Scope", "SensorEffect", "StructuralEffect", "SymbolicMotion",
    "amount", "no_controller", "phase", "ratio", "searched", "signed",
]  # fmt: skip
