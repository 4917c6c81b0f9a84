"""The question of a diagnosis: arm, model, known effects, catalogue and thresholds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import Catalogue, Effect, EffectInstance
from elastic_arm.robot import Robot, require_robot


@dataclass(frozen=True)
class Question:
    """What recordings are compared with, and how.

    Parameters
    ----------
    robot
        The nominal arm.
    model
        mod1, mod2 or mod3.
    refit
        Fit the model's own parameters first.
    given
        Effects that the user knows: like those of the arm file they count as part of the model, their sizes are fitted.
    effects
        What may explain the gap; all of the catalogue when None.
    catalogue
        Where the ids of the description's effects are looked up.
    settings
        All thresholds.
    commissioned
        Whether the model's own parameters, where they are fitted, are those of an arm that was calibrated before.
    """

    robot: Robot
    model: str = "mod3"
    refit: bool = False
    given: tuple[EffectInstance, ...] = ()
    effects: tuple[Effect, ...] | None = None
    settings: DiagnosisSettings = field(default_factory=DiagnosisSettings)
    catalogue: Catalogue = field(default_factory=Catalogue.default)
    commissioned: bool = False

    def __post_init__(self) -> None:
        require_robot(self.robot)

    def of_commissioned_arm(self) -> Question:
        """Return it with a description that is nearly right everywhere, instead of exact."""
        settings = replace(self.settings, priors=self.settings.priors.commissioned())
        return replace(self, refit=True, commissioned=True, settings=settings)

    @property
    def candidates(self) -> tuple[Effect, ...]:
        """What may explain the gap; of errors of the model's own parameters a refit leaves nothing."""
        effects = tuple(e for e in self.catalogue.values() if e.searched) if self.effects is None else self.effects
        return tuple(effect for effect in effects if not (self.refit and effect.model_parameter))
