"""Identification: derivatives, base parameters, least squares in batch and stream, consistency, verdict."""

from elastic_arm.effects.text import parse_laws
from elastic_arm.estimation.regressors import law_columns
from elastic_arm.identification.identify import differentiate, identifier_of, identify, identify_with
from elastic_arm.identification.result import Comparison, Estimate, Gain, Identification, chi_square, compare, gain
from elastic_arm.identification.stream import Identifier

__all__ = [
    "Comparison",
    "Estimate",
    "Gain",
    "Identification",
    "Identifier",
    "chi_square",
    "compare",
    "differentiate",
    "gain",
    "identifier_of",
    "identify",
    "identify_with",
    "law_columns",
    "parse_laws",
]
