"""The columns of known effects and candidates at an expansion of the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.expansion import Expansion
from elastic_arm.diagnosis.calibration.problem import CalibrationProblem
from elastic_arm.diagnosis.selection.library_building import beside_friction, build_library
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Linearised:
    """An expansion with the columns of known effects and candidates.

    Parameters
    ----------
    expansion
        Model, residuals and their derivatives.
    library
        Columns of known effects and candidates.
    given
        The known effects.
    """

    expansion: Expansion
    library: RegressorLibrary
    given: tuple[Candidate, ...]

    @property
    def values(self) -> Array:
        """Values (k,) of the nuisance parameters, in standard deviations of their priors."""
        return self.expansion.values


def linearise(
    problem: CalibrationProblem,
    expansion: Expansion,
    candidates: Sequence[Feature],
    extra: Sequence[Candidate] = (),
    noise: float = 1.0,
) -> tuple[Linearised, list[Candidate]]:
    """Add the columns of effects to an expansion; return them and `extra` among them.

    Parameters
    ----------
    problem
        What is calibrated.
    expansion
        Where it is linearised.
    candidates
        What competes; with none, only the known effects are evaluated.
    extra
        Candidates of another linearisation.
    noise
        Variance at which the whitened residuals count as white noise.
    """
    nuisance = None if expansion.nuisance is None else replace(expansion.nuisance, noise=noise)
    equations = ArmEquations(expansion.model.robot, problem.model)
    moved = [feature.at(equations) for feature in candidates]
    library = build_library(*expansion.data, moved, problem.settings.candidates, nuisance)
    given = [
        _given(library, feature.at(equations), instance)
        for feature, instance in zip(problem.features, problem.known, strict=True)
    ]
    again = [library.add(c.feature.at(equations), c.searched, fixed=c.fixed) for c in extra]
    library.compete(*given, *again)
    library.close()
    return Linearised(expansion, library, tuple(given)), again


def _given(library: RegressorLibrary, feature: Feature, instance: EffectInstance) -> Candidate:
    values = [np.atleast_1d(instance.parameters[p.name]) for p in feature.searched]
    searched = tuple(float(v) for v in np.concatenate([*values, np.zeros(0)]))
    if feature.effect.scales_friction:
        feature = beside_friction(library, feature)
    return library.add(feature, searched, fixed=feature.fixed)
