"""What is asked of recordings."""

from __future__ import annotations

from dataclasses import dataclass, field

from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import EFFECTS, Effect, EffectInstance
from elastic_arm.robot import Robot


@dataclass(frozen=True)
class Question:
    """What is asked of the recordings.

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
        The catalogue that may explain the gap.
    settings
        All thresholds.
    """

    robot: Robot
    model: str = "mod3"
    refit: bool = False
    given: tuple[EffectInstance, ...] = ()
    effects: tuple[Effect, ...] = field(default_factory=lambda: tuple(EFFECTS.values()))
    settings: DiagnosisSettings = field(default_factory=DiagnosisSettings)
