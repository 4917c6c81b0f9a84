"""Identification: base parameters, least squares in batch and stream, consistency, verdict.

Names are loaded when they are first used: commands that only name parameters import no estimator.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from elastic_arm.effects.text import parse_laws
    from elastic_arm.identification.batch import DerivativeStage, identifier_of, identify, identify_with
    from elastic_arm.identification.result import (
        Comparison,
        Estimate,
        Identification,
        StdRatio,
        chi_square,
        compare,
        std_ratio,
    )
    from elastic_arm.identification.stream import Identifier

__all__ = [
    "Comparison",
    "DerivativeStage",
    "Estimate",
    "Identification",
    "Identifier",
    "StdRatio",
    "chi_square",
    "compare",
    "identifier_of",
    "identify",
    "identify_with",
    "parse_laws",
    "std_ratio",
]

_MODULES = {
    "Comparison": "identification.result",
    "DerivativeStage": "identification.batch",
    "Estimate": "identification.result",
    "Identification": "identification.result",
    "Identifier": "identification.stream",
    "StdRatio": "identification.result",
    "chi_square": "identification.result",
    "compare": "identification.result",
    "identifier_of": "identification.batch",
    "identify": "identification.batch",
    "identify_with": "identification.batch",
    "parse_laws": "effects.text",
    "std_ratio": "identification.result",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"elastic_arm.{_MODULES[name]}"), name)
