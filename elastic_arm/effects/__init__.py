"""The catalogue of unmodelled effects: one file an effect, read by simulator, identification,
diagnosis and report.

A file of `library/` that holds an `EFFECT` is in the catalogue; a user's file is added with
:meth:`Catalogue.with_files`. What a file imports to describe an effect is here.
"""

from elastic_arm.effects.catalogue import EFFECTS, Catalogue, from_dict, robot_effects
from elastic_arm.effects.effect import (
    Confusion,
    Effect,
    EffectInstance,
    Plant,
    Scope,
    SensorEffect,
    StructuralEffect,
)
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Choice, Parameter, Role, Scale
from elastic_arm.effects.text import parse

__all__ = [
    "EFFECTS",
    "Catalogue",
    "Choice",
    "Confusion",
    "Contribution",
    "Effect",
    "EffectInstance",
    "Parameter",
    "Plant",
    "Role",
    "Scale",
    "Scope",
    "SensorEffect",
    "StructuralEffect",
    "SymbolicMotion",
    "from_dict",
    "parse",
    "robot_effects",
]
