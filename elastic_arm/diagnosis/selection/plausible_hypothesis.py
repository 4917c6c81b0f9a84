"""Whether a hypothesis is possible: signs and sizes of its parameters, and what its effects need beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.hypothesis import misfit
from elastic_arm.diagnosis.selection.plausible_size import PlausibleSizes
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import SearchSettings

Array = NDArray[np.float64]


def plausible(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    settings: SearchSettings,
    sizes: PlausibleSizes | None = None,
    given: Sequence[Candidate] = (),
) -> bool:
    """Whether every parameter has a sign and a size that its effect can have (no friction that drives).

    Parameters
    ----------
    library
        Of all columns.
    selected
        The candidates, fitted together.
    settings
        How far outside its plausible range a ratio may be, and what an effect gains by chance.
    sizes
        The largest plausible sizes; signs and ratios alone are judged where they are not known.
    given
        The effects that every hypothesis holds, at any values: nuisance parameters of their joints are alike in all.
    """
    known = {candidate.feature.key for candidate in given}
    joints = {candidate.feature.joint for candidate in selected if candidate.feature.key not in known}
    if any(turns_over(candidate, library.nuisance.turned_over) for candidate in selected):
        return False
    scaling = [c.feature for c in selected if c.feature.effect.scales_friction]
    if not all(any(feature.scales(other.feature) for other in selected) for feature in scaling):
        return False
    coefficients = library.coefficients(selected)
    if len(library.nuisance):
        values = library.nuisance_values(selected, np.concatenate([*coefficients, np.zeros(0)]))
        if not library.nuisance.possible(values, joints):
            return False
    fitted = zip(selected, coefficients, strict=True)
    judged = ((c, beta) for c, beta in fitted if not c.fixed and c.searched is not None)
    wrong = (c for c, beta in judged if not _possible(c, beta, settings.ratio_factor, sizes))
    # What every hypothesis holds may be nothing on this arm: then it comes out with either sign.
    return all(c.feature.key in known and _is_nothing(library, selected, c, settings.by_chance) for c in wrong)


def _is_nothing(library: RegressorLibrary, selected: Sequence[Candidate], which: Candidate, by_chance: float) -> bool:
    """Whether a hypothesis explains as much without one of its effects, to within what it gains by chance, nats."""
    gain = library.both(selected) - library.both([other for other in selected if other is not which])
    return gain < by_chance * misfit(library, selected)


def coefficient_bounds(selected: Sequence[Candidate], ratio_factor: float) -> Array:
    """Return between which values (2, p) the coefficients of all columns of candidates must lie, by sign and ratio.

    Infinite where another condition decides, or none.

    Parameters
    ----------
    selected
        The candidates.
    ratio_factor
        How far outside its plausible range a ratio may be.
    """
    bounds = np.full((2, sum(len(candidate.index) for candidate in selected)), np.inf)
    bounds[0] = -np.inf
    first = 0
    for candidate in selected:
        feature = candidate.feature
        if not candidate.fixed and candidate.searched is not None:
            if feature.fixed:
                bounds[0, first] = 0.0
            elif feature.phase is None and feature.linear[0].from_coefficient is None:
                believable = feature.linear[0].believable_range(ratio_factor)
                bounds[:, first] = np.array(believable) - (feature.linear[0].neutral or 0.0)
        first += len(candidate.index)
    return bounds


def turns_over(candidate: Candidate, slowest: Mapping[str, float]) -> bool:
    """Whether an effect is friction that dies out below the speed (rad/s, by joint) where dry friction turns over."""
    feature = candidate.feature
    below = slowest.get(feature.joint or "", 0.0)
    numbers = [p for p in feature.searched for _ in range(p.size)]
    speeds = [v for p, v in zip(numbers, candidate.searched or (), strict=False) if p.unit == "rad/s"]
    return feature.effect.friction and any(0.0 < speed < below for speed in speeds)


def _possible(candidate: Candidate, beta: Array, ratio_factor: float, sizes: PlausibleSizes | None) -> bool:
    feature = candidate.feature
    if feature.fixed:
        return bool(beta[0] > 0)
    first = feature.linear[0]
    size = float(np.hypot(*beta)) if feature.phase is not None else first.value_of(float(beta[0]))
    if sizes is not None and not sizes.allows(feature, first, np.array([size])):
        return False
    if feature.phase is not None:
        return True
    return first.believable(first.value_of(float(beta[0])), ratio_factor)
