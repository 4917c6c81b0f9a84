"""Identification: base parameters, least squares in batch and stream, consistency, verdict.

Names are loaded when they are first used: commands that only name parameters import no estimator.
"""

from typing import TYPE_CHECKING

from elastic_arm.lazy_names import lazily

if TYPE_CHECKING:
    from elastic_arm.effects.text import parse_laws
    from elastic_arm.identification.batch.derivatives import DerivativeStage
    from elastic_arm.identification.batch.identify import identify, identify_with
    from elastic_arm.identification.batch.selection import IdentificationSettings, identifier_of
    from elastic_arm.identification.result import Estimate, Identification
    from elastic_arm.identification.stream import Identifier

__all__ = [
    "DerivativeStage",
    "Estimate",
    "Identification",
    "IdentificationSettings",
    "Identifier",
    "identifier_of",
    "identify",
    "identify_with",
    "parse_laws",
]

_MODULES = {
    **dict.fromkeys(("Estimate", "Identification"), f"{__name__}.result"),
    **dict.fromkeys(("identify", "identify_with"), f"{__name__}.batch.identify"),
    **dict.fromkeys(("IdentificationSettings", "identifier_of"), f"{__name__}.batch.selection"),
    "DerivativeStage": f"{__name__}.batch.derivatives",
    "Identifier": f"{__name__}.stream",
    "parse_laws": "elastic_arm.effects.text",
}

__getattr__, __dir__ = lazily(__name__, _MODULES)
