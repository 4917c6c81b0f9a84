"""The parameters that act nonlinearly: from the best value tried to the best value there is.

For each value the coefficients of all columns follow by linear least squares, so only the searched parameters of one
feature at a time are left to SciPy's optimisers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import RefinementSettings
from elastic_arm.effects.parameters import Parameter

Array = NDArray[np.float64]

# First steps and tolerance of the Nelder-Mead search; numerical.
WIDE_STEP, SMALL_STEP = 0.2, 0.02  # of half a range: first steps from its middle, and from a value that was tried
NEAR = 2e-3  # of half a range: how near the optimum a search over several numbers ends
Cost = Callable[[Sequence[float]], float]


def refine(
    library: RegressorLibrary, selected: Sequence[Candidate], which: Candidate, settings: RefinementSettings
) -> Candidate:
    """Return one candidate with its nonlinear parameters optimised on the identification data.

    Integer parameters stay as they are. The other candidates have their best coefficients at every value tried
    (variable projection, Golub and Pereyra 1973).

    Parameters
    ----------
    library
        Of all columns; the refined candidate is added to it.
    selected
        The hypothesis that holds the candidate.
    which
        The candidate.
    settings
        Range and number of evaluations.
    """
    feature = which.feature
    free = [p for p in feature.searched for _ in range(p.size)]
    if not free or any(p.integer for p in free):
        return which
    others = [candidate for candidate in selected if candidate is not which]
    project = _Projection(library, others)

    def cost(point: Sequence[float]) -> float:
        return project.cost(library.columns(0, feature, tuple(float(v) for v in point)), fixed=feature.fixed)

    if len(free) > 1:
        best = _together(cost, free, which.searched)
    else:
        assert which.searched is not None
        scaled = feature.fixed and not which.fixed
        best = (_scalar(cost, free[0], which.searched[0], settings, wide=scaled),)
    refined = library.add(feature, best, fixed=feature.fixed)
    library.close()
    return refined


def _together(cost: Cost, free: Sequence[Parameter], start: tuple[float, ...] | None) -> tuple[float, ...]:
    """Return the best values of several numbers, from the best of those tried or the middle of their ranges."""
    axes = [_Axis.of(p) for p in free]
    half = np.array([(axis.high - axis.low) / 2 for axis in axes])
    first = np.array([(axis.low + axis.high) / 2 for axis in axes])
    if start is not None:
        first = np.array([axis.at(value) for axis, value in zip(axes, start, strict=True)])

    def values(point: Array) -> tuple[float, ...]:
        return tuple(axis.value(float(v)) for axis, v in zip(axes, point, strict=True))

    simplex = np.vstack([first, first + np.diag((WIDE_STEP if start is None else SMALL_STEP) * half)])
    options = {"initial_simplex": simplex, "xatol": NEAR * half.min(), "fatol": 0.5, "maxfev": 90}
    return values(minimize(lambda point: cost(values(point)), first, method="Nelder-Mead", options=options).x)


def _scalar(cost: Cost, parameter: Parameter, start: float, settings: RefinementSettings, *, wide: bool) -> float:
    axis = _Axis.of(parameter, beyond=settings.range_factor)
    low, high = axis.low, axis.high
    if wide:
        # Only the shape of a scaled column was fitted, not its size: evaluate the whole range first.
        tried = np.linspace(low, high, settings.evaluations)
        centre = tried[int(np.argmin([cost((axis.value(v),)) for v in tried]))]
        width = 1.5 * (tried[1] - tried[0])
    else:
        centre, width = axis.at(start), 1.2 * (high - low) / 7
    bounds = (max(low, centre - width), min(high, centre + width))
    options = {"maxiter": settings.evaluations, "xatol": 1e-4 if axis.logarithmic else 1e-4 * (high - low)}
    found = minimize_scalar(lambda v: cost((axis.value(v),)), bounds=bounds, method="bounded", options=options)
    return axis.value(found.x)


@dataclass(frozen=True)
class _Axis:
    """A parameter's range as the optimiser moves in it: the number, or its logarithm."""

    low: float
    high: float
    logarithmic: bool

    @staticmethod
    def of(p: Parameter, beyond: float = 1.0) -> _Axis:
        """Take a parameter's range, widened by a factor."""
        if p.logarithmic:
            return _Axis(float(np.log(p.low / beyond)), float(np.log(p.high * beyond)), True)
        middle, half = (p.low + p.high) / 2, beyond * (p.high - p.low) / 2
        return _Axis(middle - half, middle + half, False)

    def at(self, value: float) -> float:
        """Return where a value lies."""
        return float(np.log(value)) if self.logarithmic else value

    def value(self, place: float) -> float:
        """Return the value at a place."""
        return float(np.exp(place)) if self.logarithmic else float(place)


class _Projection:
    """Least squares on the identification data with some columns always there."""

    def __init__(self, library: RegressorLibrary, others: Sequence[Candidate]) -> None:
        y = library.matrix(0, [0])[:, 0]
        for candidate in others:
            if candidate.fixed:
                y = y - library.matrix(0, candidate.index).sum(axis=1)
        free = [candidate.index for candidate in others if not candidate.fixed]
        columns = library.matrix(0, np.concatenate(free)) if free else np.zeros((len(y), 0))
        self._library = library
        columns, y = library.marginalised(columns), library.marginalised(y[:, None], residual=True)[:, 0]
        # Null columns and repeated ones would make the basis meaningless.
        u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
        self._basis = u[:, s > 1e-5 * s[0]] if len(s) else u
        self._y = self._clean(y)

    def _clean(self, values: Array) -> Array:
        return values - self._basis @ (self._basis.T @ values)

    def cost(self, columns: Array, *, fixed: bool) -> float:
        """Half the sum of squares that is left with these columns added."""
        cleaned = self._clean(self._library.marginalised(columns))
        if fixed:
            return 0.5 * float(np.sum((self._y - cleaned.sum(axis=1)) ** 2))
        scaled = cleaned / np.maximum(np.linalg.norm(cleaned, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(scaled, full_matrices=False)
        u = u[:, s > 1e-5 * max(s[0], 1e-300)]
        return 0.5 * float(self._y @ self._y - np.sum((u.T @ self._y) ** 2))
