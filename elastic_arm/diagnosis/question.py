"""The question of a diagnosis: arm, model, known effects, catalogue and priors."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from elastic_arm.effects import Catalogue, Effect, EffectInstance
from elastic_arm.effects.text import known_effects, read_effects
from elastic_arm.evidence.priors import Priors
from elastic_arm.robot import Robot, require_robot


@dataclass(frozen=True)
class Question:
    """The model with which recordings are compared, and the settings of the comparison.

    Parameters
    ----------
    robot
        The nominal arm.
    model
        mod1, mod2 or mod3.
    refit
        Exclude the trust `as measured`.
    given
        Known effects with unknown sizes, also as text ("coulomb_friction").
    effects
        Effects that may explain the gap, or their ids; the whole catalogue if None.
    catalogue
        Catalogue of the effects in the description.
    priors
        Ordinary deviations of the numbers of arm and sensors.
    """

    robot: Robot
    model: str = "mod3"
    refit: bool = False
    given: Sequence[EffectInstance | str] = ()
    effects: Sequence[Effect | str] | None = None
    catalogue: Catalogue = field(default_factory=Catalogue.default)
    priors: Priors = field(default_factory=Priors)

    def __post_init__(self) -> None:
        require_robot(self.robot)
        known = read_effects(
            self.given, lambda text: known_effects([text], self.robot, self.catalogue)
        )
        object.__setattr__(self, "given", known)
        if self.effects is not None:
            found = tuple(self.catalogue.find(e) if isinstance(e, str) else e for e in self.effects)
            object.__setattr__(self, "effects", found)

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """Effects that may explain the gap."""
        asked = (
            [e for e in self.catalogue.values() if e.searched]
            if self.effects is None
            else self.effects
        )
        return tuple(e for e in asked if isinstance(e, Effect))

    @property
    def known(self) -> tuple[EffectInstance, ...]:
        """Known effects."""
        return tuple(i for i in self.given if isinstance(i, EffectInstance))
