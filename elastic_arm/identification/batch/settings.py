"""What an identification is asked for, for commands and callers alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elastic_arm.effects import Catalogue, EffectInstance


@dataclass(frozen=True)
class IdentificationSettings:
    """How an arm is identified.

    Parameters
    ----------
    model
        mod1, mod2 or mod3.
    effects
        Laws identified beside the model's own parameters (:func:`elastic_arm.effects.text.parse_laws`), and beside
        those that the description states.
    consistent
        Also find all parameters, physically consistent and close to the nominal where the data determine nothing.
    catalogue
        Where the ids of the description's effects are looked up; the default one when None.
    """

    model: str = "mod3"
    effects: Sequence[EffectInstance] = ()
    consistent: bool = True
    catalogue: Catalogue | None = None


USUAL = IdentificationSettings()
