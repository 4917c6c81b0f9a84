"""What a diagnosis worked on, kept for figures and for going on from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.hypothesis import Key
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.dynamics import Model
from elastic_arm.effects import EffectInstance
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData

if TYPE_CHECKING:
    from elastic_arm.diagnosis.inference.estimates import Agreement

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DiagnosisContext:
    """The validation data with the residuals before and after.

    Parameters
    ----------
    model
        That of residuals and columns.
    fitted
        The same at the numbers that were found beside the causes at last.
    validate
        WhitenedData of the validation recordings.
    before, after
        Residuals (N', R) of each stretch.
    selected
        The causes as they were fitted.
    alone
        Residuals of each stretch with one cause alone added, by position in the causes.
    regimes
        (R,) share of each residual's power that follows each regime, before.
    library
        The columns of all effects on both data sets.
    seen
        The observed recordings that causes were fitted on, and those that judged, or the last third of each.
    faults
        Nuisance parameters that are causes, recording by recording; nothing of a single recording.
    late
        By how much channels of these were moved back, (n,) s; their torques are without the gains that they state.
    held_back
        Whether the last third of each recording judged.
    given, known
        What counted as part of the model, as candidates and as the simulator takes it.
    unseen
        Known effects that act in no recorded equation.
    rivals
        What competes with each cause, by position in the causes, most probable first.
    settings
        All thresholds.
    """

    model: Model
    fitted: Model
    validate: WhitenedData
    before: list[Array]
    after: list[Array]
    selected: tuple[Candidate, ...]
    alone: tuple[list[Array], ...]
    regimes: tuple[dict[str, float], ...]
    library: RegressorLibrary
    seen: tuple[tuple[Observation, ...], tuple[Observation, ...]]
    faults: Mapping[Key, Agreement]
    late: Mapping[str, Array]
    held_back: bool
    given: tuple[Candidate, ...]
    known: tuple[EffectInstance, ...]
    unseen: tuple[EffectInstance, ...]
    rivals: tuple[tuple[Candidate, ...], ...]
    settings: DiagnosisSettings

    @property
    def everything(self) -> list[Candidate]:
        """All that was fitted together: the tilt of an arm that is mounted otherwise is known, and a cause, too."""
        return [*self.given, *(candidate for candidate in self.selected if candidate not in self.given)]
