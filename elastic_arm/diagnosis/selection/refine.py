"""The parameters that act nonlinearly: from the best value tried to the best value there is.

For each value the coefficients of all columns follow by linear least squares, so only the searched parameters of one
feature at a time are left to SciPy's optimisers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.effects.model import Parameter

Array = NDArray[np.float64]

EVALUATIONS = 18  # of one parameter; its optimum is then known to some 0.1 %
BEYOND = 3.0  # how far outside its plausible range a parameter may be found


def refine(library: RegressorLibrary, selected: Sequence[Candidate], which: Candidate) -> Candidate:
    """Return one of the selected with its searched parameters optimised on the identification data.

    Whole orders stay as they are. The others stay at their coefficients' best for every value tried.
    """
    feature = which.feature
    if not feature.searched or any(p.name == "order" for p in feature.searched):
        return which
    others = [candidate for candidate in selected if candidate is not which]
    project = _Projection(library, others)

    def cost(point: Sequence[float]) -> float:
        return project.cost(library.columns(0, feature, tuple(float(v) for v in point)), fixed=feature.fixed)

    size = sum(p.size for p in feature.searched)
    if size > 1:
        start = np.zeros(size) if which.searched is None else np.array(which.searched)
        simplex = np.vstack([start, start + (0.1 if which.searched is None else 0.01) * np.eye(size)])
        options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 0.5, "maxfev": 90}
        best = tuple(float(v) for v in minimize(cost, start, method="Nelder-Mead", options=options).x)
    else:
        assert which.searched is not None
        best = (_scalar(cost, feature.searched[0], which.searched[0], wide=feature.fixed and not which.fixed),)
    refined = library.add(feature, best, fixed=feature.fixed)
    library.close()
    return refined


def _scalar(cost, parameter: Parameter, start: float, *, wide: bool) -> float:  # type: ignore[no-untyped-def]
    low, high = np.log(parameter.low / BEYOND), np.log(parameter.high * BEYOND)
    if wide:
        # A scaled column told the shape, not the size: look at the whole range first.
        tried = np.linspace(low, high, EVALUATIONS)
        centre = tried[int(np.argmin([cost((float(np.exp(v)),)) for v in tried]))]
        width = 1.5 * (tried[1] - tried[0])
    else:
        centre, width = np.log(start), 1.2 * (high - low) / 7
    bounds = (max(low, centre - width), min(high, centre + width))
    options = {"maxiter": EVALUATIONS, "xatol": 1e-4}
    found = minimize_scalar(lambda v: cost((float(np.exp(v)),)), bounds=bounds, method="bounded", options=options)
    return float(np.exp(found.x))


class _Projection:
    """Least squares on the identification data with some columns always there."""

    def __init__(self, library: RegressorLibrary, others: Sequence[Candidate]) -> None:
        y = library.matrix(0, [0])[:, 0]
        for candidate in others:
            if candidate.fixed:
                y = y - library.matrix(0, candidate.index).sum(axis=1)
        free = [candidate.index for candidate in others if not candidate.fixed]
        columns = library.matrix(0, np.concatenate(free)) if free else np.zeros((len(y), 0))
        # Null columns and repeated ones would make the basis meaningless.
        u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
        self._basis = u[:, s > 1e-5 * s[0]] if len(s) else u
        self._y = self._clean(y)

    def _clean(self, values: Array) -> Array:
        return values - self._basis @ (self._basis.T @ values)

    def cost(self, columns: Array, *, fixed: bool) -> float:
        """Half the sum of squares that is left with these columns added."""
        cleaned = self._clean(columns)
        if fixed:
            return 0.5 * float(np.sum((self._y - cleaned.sum(axis=1)) ** 2))
        scaled = cleaned / np.maximum(np.linalg.norm(cleaned, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(scaled, full_matrices=False)
        u = u[:, s > 1e-5 * max(s[0], 1e-300)]
        return 0.5 * float(self._y @ self._y - np.sum((u.T @ self._y) ** 2))
