"""The catalogue of unmodelled effects: one file an effect, read by simulator, diagnosis and report alike.

A file of this folder that holds an `EFFECT` is in the catalogue; adding an effect is adding a file.
"""

from elastic_arm.effects.catalogue import EFFECTS, from_dict, parse, robot_effects
from elastic_arm.effects.model import Confusion, Effect, EffectInstance, Scope
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Choice, Parameter, Role

__all__ = [
    "EFFECTS",
    "Choice",
    "Confusion",
    "Contribution",
    "Effect",
    "EffectInstance",
    "Parameter",
    "Role",
    "Scope",
    "SymbolicMotion",
    "from_dict",
    "parse",
    "robot_effects",
]
