"""Identification: derivatives, base parameters, least squares in batch and stream, consistency, verdict."""

from elastic_arm.identification.identify import differentiate, identifier_of, identify, identify_with
from elastic_arm.identification.laws import law_columns, parse_laws
from elastic_arm.identification.result import Comparison, Estimate, Identification, chi_square, compare
from elastic_arm.identification.stream import Identifier

__all__ = [
    "Comparison",
    "Estimate",
    "Identification",
    "Identifier",
    "chi_square",
    "compare",
    "differentiate",
    "identifier_of",
    "identify",
    "identify_with",
    "law_columns",
    "parse_laws",
]
