"""Identification: base parameters, least squares in batch and stream, consistency, verdict."""

from elastic_arm.effects.text import parse_laws
from elastic_arm.identification.identify import DerivativeStage, identifier_of, identify, identify_with
from elastic_arm.identification.law_columns import law_columns
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
    "law_columns",
    "parse_laws",
    "std_ratio",
]
