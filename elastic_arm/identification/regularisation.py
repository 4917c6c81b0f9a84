"""The description as a prior, as wide as its error is that the recordings make probable.

    Psi = argmin sum w_g² |y_g - Phi_g Psi|² + |F (Psi - Psi_described)|² / error²

Base parameters that a short or slow recording hardly shows go wherever its errors send them; the prior holds them. The
relative error of the description is averaged over the evidence of each (:mod:`elastic_arm.evidence.posterior`).
"""

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.evidence import posterior as evidence
from elastic_arm.evidence.grams import Products
from elastic_arm.evidence.priors import TRUST
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.chart import chart_of
from elastic_arm.identification.deviations import inflation
from elastic_arm.identification.least_squares import Blocks, Fit, Prior
from elastic_arm.identification.stream import Identifier
from elastic_arm.identification.verdict import natural_scales

# Relative errors that a description may have: from those of a calibrated arm to three times itself, as guessed ones.
ERRORS = np.geomspace(1e-3, 3.0, 15)
# Beside its relative error every base parameter may be off by this share of what is usual for its body: descriptions
# hold placeholders that are far too small.
PLACEHOLDER = 0.3
# Laws beyond the model have no nominal: the standard deviation of their prior where nothing states another one.
LAW_WIDTH = 1e3
# Data finer than this, relative to the nominal, bind like an equality; finer would only spoil the solver's numbers.
STIFFEST = 1e5


@dataclass(frozen=True)
class Description:
    """The description as a prior of what recordings show."""

    equations: BaseRegression
    laws: Array  # (B,) sizes up to which laws beyond the model are free, NaN for the others
    correlated: float  # by how many times variances exceed those of white errors, for which the data's rows are weighed
    error: float = np.inf  # relative error of the description
    shown: Fit | None = None  # what the recordings show without it

    def prior(self, error: float | None = None) -> Prior:
        """Return the prior of this relative error of the description, or of another one.

        By how much the description is off as far as is known counts in the deviations where that is more.
        """
        own, spread = _spread(self.equations)
        width = self.error if error is None else error
        factor, excess = np.zeros(spread.shape), np.ones(len(spread))
        factor[np.ix_(own, own)] = np.linalg.inv(spread[np.ix_(own, own)]) / width
        excess[own] = max(self.error / width, 1.0) if np.isfinite(width) else 1.0
        sized = np.flatnonzero(np.isfinite(self.laws))
        excess[sized] = np.where(np.isfinite(_ordinary(self.equations)[sized]), np.sqrt(self.correlated), 1.0)
        factor[sized, sized] = excess[sized] / self.laws[sized]
        return Prior(self.equations.described, factor, excess)

    @property
    def words(self) -> str:
        """How far the description is off, as the recordings have it."""
        return f"the description is taken to be off by {100 * self.error:.2g} %, as is most probable by the recordings"


def described(identifier: Identifier, blocks: Blocks, correlated: float) -> Description:
    """Return the description with the error that the recordings show it to have."""
    equations = identifier.equations
    free = Description(equations, law_sizes(blocks, equations), correlated)
    shown = identifier.fit(free.prior())
    return replace(free, error=error_of(shown, free), shown=shown)


def law_sizes(blocks: Blocks, equations: BaseRegression) -> Array:
    """Return the standard deviations (B,) of priors of the laws beyond the model; NaN for the others.

    That of a law is what is ordinary of it, where that is stated, else the size at which it makes all the torque of its
    joint. A joint that never reverses shows friction and the zero of its torque as one and the same constant: any two
    numbers of the right sum would fit.
    """
    squares = np.diagonal(blocks.sums()[0][0], axis1=1, axis2=2)
    columns, torques = squares[:, :-1], squares[:, -1:]
    whole = np.sum(np.where(columns > 0.0, torques, 0.0), axis=0)
    # What holds parameters of the arm, too, has their prior.
    law = ~equations.of_arm & [not name.startswith("link_encoder:") for name in equations.base.names]
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.sqrt(whole / columns.sum(axis=0))
    ordinary = _ordinary(equations)
    sizes = np.where(np.isfinite(ordinary), ordinary, sizes)
    return np.where(law & np.isfinite(sizes) & (sizes > 0.0), sizes, np.nan)


def _ordinary(equations: BaseRegression) -> Array:
    """Return the ordinary size (B,) of each base parameter that is a law's; NaN where none is stated."""
    stated = {column.name: column.ordinary for column in equations.columns if column.ordinary is not None}
    return np.array([stated.get(name, np.nan) for name in equations.base.names])


@functools.lru_cache(maxsize=1)  # asked for at every error that is tried
def _spread(equations: BaseRegression) -> tuple[NDArray[np.intp], Array]:
    """Return which base parameters are the arm's own, and (B, B) how unit errors of the description spread over them.

    Zero but for these.
    """
    base, scales = equations.base, natural_scales(equations)
    own = np.flatnonzero(equations.of_arm & np.isfinite(scales))
    held = [0.0] * (len(equations.names) - len(equations.columns)) + [c.ordinary or 0.0 for c in equations.columns]
    covariance = base.T @ (chart_of(equations).covariance() + np.diag(held) ** 2) @ base.T.T
    covariance = covariance[np.ix_(own, own)] + np.diag((PLACEHOLDER * scales[own]) ** 2)
    spread = np.zeros((len(base),) * 2)
    spread[np.ix_(own, own)] = np.linalg.cholesky(covariance)
    return own, spread


def whitened(fit: Fit, columns: Array, start: Array, correlated: float) -> tuple[Array, Array, float]:
    """Return A, b, c: the recording gives A x = b with unit noise and leaves a sum of squares c, at start + columns x.

    columns, start: (B, k) and (B,) of base parameters. Errors are coloured: their effect on the estimate is larger than
    white ones' by a factor known from the blocks, or from longer ones.
    """
    excess = np.sqrt(max(1.0, inflation(fit.covariance, fit.white_covariance), correlated))
    # Ordinary least squares has weights of one: its rows are still in Nm.
    scaled = fit.factor / (excess * np.sqrt(np.mean((fit.weights * fit.noise) ** 2)))
    A, b = scaled[:-1, :-1] @ columns, scaled[:-1, -1] - scaled[:-1, :-1] @ start
    u, s, vt = np.linalg.svd(A, full_matrices=False)
    known = s > 1e-12 * s[0]
    softened = np.minimum(s, STIFFEST)[known] / s[known]
    return softened[:, None] * s[known][:, None] * vt[known], softened * (u[:, known].T @ b), float(scaled[-1, -1] ** 2)


def error_of(fit: Fit, description: Description) -> float:
    """Return the relative error of the description, the root of its mean square under the evidence.

    The relative error that predicts best is none of the description's: where the data show nothing of a parameter, any
    narrow prior predicts as well.
    """
    chart, T = chart_of(description.equations), description.equations.base.T
    variances, laws = chart.variances(), np.zeros(len(chart.x0))
    laws[chart.free], laws[chart.held] = LAW_WIDTH**2, 1.0
    A, b, left = whitened(fit, T @ chart.G, T @ chart.Psi0, description.correlated)
    rows, columns = np.tril_indices(A.shape[1])
    products = Products((A.T @ A)[None, rows, columns], (A.T @ b)[None], np.array([b @ b + left]))
    n, place, odds = np.array([left + len(b)]), np.zeros(1, dtype=np.intp), float(np.log(TRUST["as built"].coloured))
    found = []
    for error in ERRORS:
        std = np.sqrt(np.where(laws > 0.0, laws, error**2 * variances))
        prior = evidence.Prior(0.0 * std, std, 0.0 * std - np.inf, 0.0 * std + np.inf)
        found.append(evidence.posterior(products, n, prior, place, odds).evidence)
    weights = np.exp(np.array(found) - max(found))
    return float(np.sqrt(weights @ ERRORS**2 / weights.sum()))
