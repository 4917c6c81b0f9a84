"""What an identification is asked for, for commands and callers alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from elastic_arm.effects import Catalogue, EffectInstance
from elastic_arm.effects.text import parse_laws, read_effects
from elastic_arm.robot import Robot


@dataclass(frozen=True)
class IdentificationSettings:
    """How an arm is identified.

    Parameters
    ----------
    model
        mod1, mod2 or mod3.
    effects
        Laws identified in addition to the model's own parameters and to those that the description states, as text
        ("coulomb_friction", on every joint) or as :func:`elastic_arm.effects.text.parse_laws` reads them.
    consistent
        Also find all parameters, physically consistent and close to the nominal where the data determine nothing.
    catalogue
        Where the ids of the description's effects are looked up; the default one when None.
    """

    model: str = "mod3"
    effects: Sequence[EffectInstance | str] = ()
    consistent: bool = True
    catalogue: Catalogue | None = None

    def laws(self, robot: Robot) -> tuple[EffectInstance, ...]:
        """Return the laws on the joints of an arm."""
        return read_effects(self.effects, lambda text: parse_laws([text], robot, self.catalogue))


USUAL = IdentificationSettings()
