"""The parameters that act nonlinearly: from the best value tried to the best value there is.

For each value the coefficients of all columns follow by linear least squares, so only the searched parameters of one
feature at a time are left to SciPy's optimisers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from elastic_arm.diagnosis.selection.candidates import largest_value
from elastic_arm.diagnosis.selection.gram_fits import first_row, orthonormal_basis
from elastic_arm.diagnosis.selection.hypothesis import tie_of
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.searched_points import monomials
from elastic_arm.diagnosis.settings import RefinementSettings
from elastic_arm.effects.parameters import Parameter
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]

# First steps and tolerance of the Nelder-Mead search; numerical.
WIDE_STEP, SMALL_STEP = 0.2, 0.02  # of half a range: first steps from its middle, and from a value that was tried
NEAR = 2e-3  # of half a range: how near the optimum a search over several numbers ends
GRID = 9  # values of each of several numbers from which a search starts, where one costs next to nothing
RANK = 1e-5  # relative singular value below which a combination of columns is not determined; numerical
PROJECTIONS_KEPT = 4  # of each library; bounds the memory
Cost = Callable[[Sequence[float]], float]


def refine(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    which: Candidate,
    settings: RefinementSettings,
    plausible: Callable[[Sequence[Candidate]], bool] = lambda _: True,
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
    plausible
        Whether a hypothesis is possible; where that of the best value is not, the next best optimum is taken.
    """
    feature, start = which.feature, which.searched
    if feature.effect.regressor is not None and feature.linear:
        feature, start = _whole(library, selected, which)
    free = [p for p in feature.searched for _ in range(p.size)]
    if not free or any(p.integer for p in free):
        return which
    others = [candidate for candidate in selected if candidate is not which]
    project = _projection(library, others)

    scaled = feature.fixed and not which.fixed and feature.scalable
    provisional = scaled or start is None or feature is not which.feature
    now = np.inf if provisional else project.cost(library.matrix(0, which.index), fixed=feature.fixed)

    def cost(point: Sequence[float]) -> float:
        return project.cost(library.columns(0, feature, tuple(float(v) for v in point)), fixed=feature.fixed)

    def refined(values: tuple[float, ...], left: float) -> Candidate:
        # Where any value explains as much, as any rest angle of a spring does beside a wrong zero, rounding would
        # choose one.
        return which if left > now - tie_of(library) else _added(library, feature, values)

    if len(free) > 1:
        tried = start
        if _is_polynomial(feature):
            costs = _polynomial_costs(library, feature, project)
            # Where an evaluation costs next to nothing, the best of many is the start: there may be several optima.
            tried = start or _best_on_grid(costs, free)
            cost = lambda point: float(costs(np.asarray(point)[None])[0])  # noqa: E731
        return refined(*_together(cost, free, tried, SMALL_STEP if start is tried else WIDE_STEP))
    assert start is not None

    def costs_each(values: Array) -> Array:
        columns = [library.columns(0, feature, (float(v),)).sum(axis=1) for v in values]
        return project.fixed_each(np.array(columns).T)

    axis = _Axis.of(free[0], settings.range_factor, largest_value(feature, free[0], library.sets))
    found = []
    for place, width in _starts(costs_each, axis, start[0], settings, wide=scaled):
        found.append(refined(*_scalar(cost, axis, place, width, settings)))
        if plausible([*others, found[-1]]):
            return found[-1]
    return found[0]


def is_provisional(candidate: Candidate) -> bool:
    """Whether columns are not yet an effect: they span a neighbourhood, were scaled, or hold to first order only."""
    feature = candidate.feature
    scaled = feature.fixed and not candidate.fixed
    return candidate.searched is None or scaled or (feature.effect.regressor is not None and not feature.fixed)


def _is_polynomial(feature: Feature) -> bool:
    """Whether the column of a feature is a polynomial of second degree: then an evaluation costs next to nothing."""
    return feature.quadratic and feature.count == 1 and not feature.fixed


def _polynomial_costs(library: RegressorLibrary, feature: Feature, project: _Projection) -> Callable[[Array], Array]:
    """Return half the sums of squares (M,) that are left, as a function of M points (M, k) of such a feature."""
    target, gram = project.products(library.monomial_columns(feature))
    least = feature.linear[0].least

    def costs(points: Array) -> Array:
        terms = monomials(points)
        product, square = terms @ target, np.sum((terms @ gram) * terms, axis=1)
        # No mass is negative.
        return project.left_each(np.where(product > least * square, product, 0.0), square)

    return costs


def _best_on_grid(costs: Callable[[Array], Array], free: Sequence[Parameter]) -> tuple[float, ...]:
    """Return the best of values that span the ranges of several numbers."""
    axes = np.meshgrid(*(np.linspace(p.low, p.high, GRID) for p in free), indexing="ij")
    points = np.stack(axes, axis=-1).reshape(-1, len(free))
    return tuple(float(value) for value in points[np.argmin(costs(points))])


def _whole(
    library: RegressorLibrary, selected: Sequence[Candidate], which: Candidate
) -> tuple[Feature, tuple[float, ...]]:
    """Return the whole effect, and its parameters by the columns of its law; the law alone where that is enough."""
    feature = which.feature
    (beta,) = (b for c, b in zip(selected, library.coefficients(selected), strict=True) if c is which)
    values = feature.parameters([float(b) for b in beta], which.searched or ())
    flat = np.concatenate([np.atleast_1d(values[p.name]) for p in feature.effect.parameters])
    ordinary, rate = feature.effect.ordinary, library.sets[0].band.rate
    # What every arm has is too little to differ from its law.
    if ordinary is not None and abs(values[ordinary.parameter]) <= ordinary.most(rate):
        return feature, which.searched or ()
    return feature.whole(), tuple(float(v) for v in flat)


def _added(library: RegressorLibrary, feature: Feature, values: tuple[float, ...]) -> Candidate:
    refined = library.add(feature, values, fixed=feature.fixed)
    library.close()
    return refined


def _together(
    cost: Cost, free: Sequence[Parameter], start: tuple[float, ...] | None, step: float = SMALL_STEP
) -> tuple[tuple[float, ...], float]:
    """Return the best values of several numbers and their cost, from those tried or the middle of their ranges."""
    axes = [_Axis.of(p) for p in free]
    half = np.array([(axis.high - axis.low) / 2 for axis in axes])
    first = np.array([(axis.low + axis.high) / 2 for axis in axes])
    if start is not None:
        first = np.array([axis.at(value) for axis, value in zip(axes, start, strict=True)])

    def values(point: Array) -> tuple[float, ...]:
        return tuple(axis.value(float(v)) for axis, v in zip(axes, point, strict=True))

    simplex = np.vstack([first, first + np.diag((WIDE_STEP if start is None else step) * half)])
    options = {"initial_simplex": simplex, "xatol": NEAR * half.min(), "fatol": 0.5, "maxfev": 90}
    found = minimize(lambda point: cost(values(point)), first, method="Nelder-Mead", options=options)
    return values(found.x), float(found.fun)


def _starts(
    costs: Callable[[Array], Array], axis: _Axis, start: float, settings: RefinementSettings, *, wide: bool
) -> list[tuple[float, float]]:
    """Return where on the axis to look for an optimum, and how far around it, the best first.

    Parameters
    ----------
    costs
        At several values at once.
    axis, settings
        The parameter's range and in how many steps it is gone through.
    start
        Value that was tried.
    wide
        Whether the whole range is gone through.
    """
    if not wide:
        return [(axis.at(start), 1.2 * (axis.high - axis.low) / 7)]
    # Only the shape of a scaled column was fitted, not its size: evaluate the whole range first.
    tried = np.linspace(axis.low, axis.high, settings.evaluations)
    found = costs(np.array([axis.value(v) for v in tried]))
    around = np.concatenate([[np.inf], found, [np.inf]])
    optima = np.flatnonzero((found <= around[:-2]) & (found <= around[2:]))
    width = 1.5 * float(tried[1] - tried[0])
    return [(float(tried[k]), width) for k in optima[np.argsort(found[optima])]]


def _scalar(
    cost: Cost, axis: _Axis, centre: float, width: float, settings: RefinementSettings
) -> tuple[tuple[float], float]:
    """Return the best value of a number within some distance of a place on its axis, and its cost."""
    # What a column's coefficient means may lie far outside the range.
    centre = min(max(centre, axis.low), axis.high)
    bounds = (max(axis.low, centre - width), min(axis.high, centre + width))
    tolerance = 1e-4 if axis.logarithmic else 1e-4 * (axis.high - axis.low)
    options = {"maxiter": settings.evaluations, "xatol": tolerance}
    found = minimize_scalar(lambda v: cost((axis.value(v),)), bounds=bounds, method="bounded", options=options)
    return (axis.value(found.x),), float(found.fun)


@dataclass(frozen=True)
class _Axis:
    """A parameter's range as the optimiser moves in it: the number, or its logarithm."""

    low: float
    high: float
    logarithmic: bool

    @staticmethod
    def of(p: Parameter, beyond: float = 1.0, most: float = np.inf) -> _Axis:
        """Take a parameter's range, widened by a factor, up to what recordings allow."""
        if p.logarithmic:
            low, high = p.low / beyond, p.high * beyond
            return _Axis(float(np.log(low)), float(np.log(max(min(high, most), low))), True)
        middle, half = (p.low + p.high) / 2, beyond * (p.high - p.low) / 2
        return _Axis(middle - half, max(min(middle + half, most), middle - half), False)

    def at(self, value: float) -> float:
        """Return where a value lies; one of the wrong sign at the end of the range."""
        if not self.logarithmic:
            return value
        return float(np.log(value)) if value > 0.0 else self.low

    def value(self, place: float) -> float:
        """Return the value at a place."""
        return float(np.exp(place)) if self.logarithmic else float(place)


def _projection(library: RegressorLibrary, others: Sequence[Candidate]) -> _Projection:
    """Return the projection beside some candidates; one candidate after the other is refined beside the same ones."""
    kept, key = _PROJECTIONS.setdefault(library, {}), tuple(others)
    if key not in kept:
        if len(kept) >= PROJECTIONS_KEPT:
            kept.clear()
        kept[key] = _Projection(library, others)
    return kept[key]


class _Projection:
    """Least squares on the identification data with some columns and the nuisance parameters always there."""

    def __init__(self, library: RegressorLibrary, others: Sequence[Candidate]) -> None:
        y = library.matrix(0, [0])[:, 0]
        for candidate in others:
            if candidate.fixed:
                y = y - library.matrix(0, candidate.index).sum(axis=1)
        free = [candidate.index for candidate in others if not candidate.fixed]
        columns = library.matrix(0, np.concatenate(free)) if free else np.zeros((len(y), 0))
        rows = len(y)
        columns, y = library.marginalised(columns), library.marginalised(y[:, None], residual=True)[:, 0]
        basis = orthonormal_basis(columns, RANK)
        y = y - basis @ (basis.T @ y)
        # Further columns are zero in the rows of the priors, so only the rows of the data are needed of either.
        self._bases = [part[:rows] for part in (library.nuisance_basis, basis) if part.shape[1]]
        self._y, self._square = y[:rows], float(y @ y)

    def cost(self, columns: Array, *, fixed: bool) -> float:
        """Half the sum of squares that is left with these columns added."""
        if fixed:
            return float(self.fixed_each(columns.sum(axis=1, keepdims=True))[0])
        return self.left(*self.products(columns))

    def fixed_each(self, columns: Array) -> Array:
        """Half the sums of squares (M,) that are left with each of M columns (rows, M) added as it is."""
        begin = first_row(columns)
        columns = columns[begin:]
        square = np.sum(columns**2, axis=0)
        for basis in self._bases:
            square -= np.sum((basis[begin:].T @ columns) ** 2, axis=0)
        return np.asarray(0.5 * (self._square - 2.0 * columns.T @ self._y[begin:] + square))

    def products(self, columns: Array) -> tuple[Array, Array]:
        """Return products (m,), (m, m) of columns (rows, m) with the residual and each other, less what is there."""
        begin = first_row(columns)
        columns = columns[begin:]
        target, gram = columns.T @ self._y[begin:], columns.T @ columns
        for basis in self._bases:
            part = basis[begin:].T @ columns
            gram = gram - part.T @ part
        return target, gram

    def left(self, target: Array, gram: Array) -> float:
        """Half the sum of squares that is left beside columns with these products, fitted."""
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        acts = values > 1e-10 * max(values[-1], 1e-300)
        shown = vectors[:, acts].T @ (target / scale)
        return 0.5 * (self._square - float(np.sum(shown**2 / values[acts])))

    def left_each(self, target: Array, square: Array) -> Array:
        """Half the sums of squares (M,) that are left beside one column each with these products (M,), fitted."""
        return 0.5 * (self._square - np.where(square > 0.0, target**2 / np.maximum(square, 1e-300), 0.0))


_PROJECTIONS: WeakKeyDictionary[RegressorLibrary, dict[tuple[Candidate, ...], _Projection]] = WeakKeyDictionary()
