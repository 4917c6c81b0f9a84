"""Derivatives of candidates by their nonlinear parameters: with them these move while something else is fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.effects.parameters import Parameter

Array = NDArray[np.float64]

STEP = 1e-3  # of the derivatives by parameters, in units of their scales; numerical


def tangents(library: RegressorLibrary, selected: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates of the derivatives by free parameters, with coefficients to fit.

    Beside them nuisance parameters are as uncertain as they are, not as if the causes' numbers were known.

    Parameters
    ----------
    library
        Of all columns; the derivatives are added to it.
    selected
        Candidates. Of polished ones all numbers are searched; of others the linear ones have coefficients already.
    """
    found = []
    for candidate in selected:
        free = [] if candidate.searched is None else free_components(candidate)
        if free:
            blocks = [
                np.concatenate([_derivative(library, which, candidate, j) for j in free], axis=1)
                for which in range(len(library.sets))
            ]
            found.append(Candidate(candidate.feature, None, library.add_columns(blocks)))
    library.close()
    return found


def steps_along(
    library: RegressorLibrary, selected: Sequence[Candidate], candidates: Sequence[Candidate]
) -> list[Array]:
    """Return by how much the searched numbers (m,) of each candidate move for the best fit, to first order.

    No number moves by more than its own size, or to less than half of it. Of several linear columns each would want
    another step: they stay.

    Parameters
    ----------
    library
        Of all columns.
    selected
        All that is fitted: the candidates and their :func:`tangents` among it.
    candidates
        Those that may move.
    """
    coefficients = dict(zip(selected, library.coefficients(selected), strict=True))
    along = {one.feature: coefficients[one] for one in selected if one.searched is None}
    found = []
    for candidate in candidates:
        step = np.zeros(len(candidate.searched or ()))
        if candidate.feature in along and len(along[candidate.feature]) == len(free_components(candidate)):
            size = 1.0 if candidate.fixed else float(coefficients[candidate][0])
            scales = np.array([scale_of(candidate, j) for j in free_components(candidate)])
            share = along[candidate.feature] / (size if size else np.inf)
            values = np.array(candidate.searched)[free_components(candidate)]
            step[free_components(candidate)] = np.clip(
                scales * share, np.where(values > 0.0, -0.5, -1.0) * scales, np.where(values < 0.0, 0.5, 1.0) * scales
            )
        found.append(step)
    return found


def _derivative(library: RegressorLibrary, which: int, candidate: Candidate, j: int) -> Array:
    """Return the derivatives (rows, m) of a law, or of its m columns, by a component, in units of its scale."""
    ends = []
    for sign in (1.0, -1.0):
        values = list(candidate.searched or ())
        values[j] += sign * STEP * scale_of(candidate, j)
        columns = library.columns(which, candidate.feature, tuple(values))
        ends.append(columns.sum(axis=1, keepdims=True) if candidate.fixed else columns)
    return np.asarray((ends[0] - ends[1]) / (2.0 * STEP))


def free_components(candidate: Candidate) -> list[int]:
    """Return which components of the searched numbers of a candidate are no integers."""
    components = [p for p in candidate.feature.searched for _ in range(p.size)]
    return [j for j, p in enumerate(components) if not p.integer]


def scale_of(candidate: Candidate, j: int) -> float:
    """Size of a parameter: its own, or a hundredth of its plausible range where it is nearly nothing."""
    parameter, value = component(candidate, j), (candidate.searched or ())[j]
    neutral = parameter.neutral or 0.0
    if parameter.low > 0 and neutral == 0.0:
        return max(abs(value), 1e-3 * parameter.low)
    return max(abs(value - neutral), 1e-4 * (parameter.high - parameter.low))


def component(candidate: Candidate, j: int) -> Parameter:
    """Return the parameter to which component j of a cause's numbers belongs."""
    return [p for p in candidate.feature.searched for _ in range(p.size)][j]
