"""The description as a prior, used if a recording alone predicts other motion badly.

    Psi = argmin sum w_g² |y_g - Phi_g Psi|² + |F (Psi - Psi_described)|² / width²

Errors of a short or slow recording dominate base parameters that it hardly determines; the prior
constrains them (ridge regression; A. Hoerl and R. Kennard, Technometrics 12 (1970) 55). Its width
is the one that predicts left-out parts of the fitted recordings best: the narrowest within one
standard error of the best (T. Hastie, R. Tibshirani, J. Friedman, The Elements of Statistical
Learning, 2009, 7.10), where the standard error is that of the difference part by part. Without a
clear gain there is no prior, except for a wide one of rigid arms.
"""

import functools
from collections.abc import Sequence

import numpy as np

from elastic_arm.arrays import Array, Indices
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.consistent import description_covariance
from elastic_arm.identification.least_squares import Blocks, Fit, Prior
from elastic_arm.identification.verdict import natural_scales

# Relative errors of the description that are tried, wide to narrow.
WIDTHS = tuple(np.geomspace(10.0, 0.03, 12).tolist())
# Relative errors of the description that are compared by their likelihood.
ERRORS = tuple(np.geomspace(0.01, 10.0, 31).tolist())
# Beside its relative error every base parameter may be off by this share of what is usual for its
# body: descriptions hold placeholders that are far too small.
PLACEHOLDER = 0.3
# Few parameters that are determined hardly show how far the others are off: what counts in the
# deviations is the upper end of the interval of 95 %, by the loss of log-likelihood (half of
# chi-squared with one degree of freedom, one side).
DOUBT = 1.35
FOLDS = 5
# A prior has to lower the error of left-out parts by this share.
GAIN = 0.05


def prior_of(
    equations: BaseRegression,
    width: float,
    error: float = 0.0,
    laws: Array | None = None,
    correlated: float = 1.0,
) -> Prior:
    """Return the description as a prior with relative error `width`.

    Laws beyond the model are free up to a size.

    `error` is the known relative error of the description; it counts in the standard deviations if
    it exceeds `width`. Variances are `correlated` times those of white errors, for which the rows
    of the data are weighted.
    """
    base = equations.base
    own, covariance = description_errors(equations)
    factor = np.zeros((len(base),) * 2)
    factor[np.ix_(own, own)] = np.linalg.inv(np.linalg.cholesky(covariance)) / width
    excess = np.full(len(base), max(error / width, 1.0))
    if laws is not None:
        sized = np.flatnonzero(np.isfinite(laws))
        excess[sized] = np.where(np.isfinite(_ordinary(equations)[sized]), np.sqrt(correlated), 1.0)
        factor[sized, sized] = excess[sized] / laws[sized]
    return Prior(equations.described, factor, excess)


def law_sizes(blocks: Blocks, equations: BaseRegression) -> Array:
    """Return the standard deviations (B,) of the priors of laws; NaN for other parameters.

    For a law it is the ordinary size, if stated, and otherwise the size at which the law causes all
    the torque of its joint. At a joint that never reverses, friction and the zero of its torque are
    the same constant, and any two numbers with the right sum would fit.
    """
    squares = np.sum(np.square(blocks.total()), axis=1)
    columns = squares[:, :-1]
    torques = squares[:, -1:]
    whole = np.sum(np.where(columns > 0.0, torques, 0.0), axis=0)
    law = np.array(
        [":" in name and not name.startswith("link_encoder:") for name in equations.base.names]
    )
    # What holds parameters of the arm, too, has their prior.
    law &= ~np.isfinite(natural_scales(equations))
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.sqrt(whole / columns.sum(axis=0))
    ordinary = _ordinary(equations)
    sizes = np.where(np.isfinite(ordinary), ordinary, sizes)
    return np.where(law & np.isfinite(sizes) & (sizes > 0.0), sizes, np.nan)


def _ordinary(equations: BaseRegression) -> Array:
    """Return the ordinary size (B,) of each base parameter of a law; NaN if none is stated."""
    stated = {
        column.name: column.ordinary for column in equations.columns if column.ordinary is not None
    }
    return np.array([stated.get(name, np.nan) for name in equations.base.names])


@functools.lru_cache(maxsize=1)  # asked for at every width that is tried
def description_errors(equations: BaseRegression) -> tuple[Indices, Array]:
    """Return which base parameters belong to the arm, and the covariance of their description for a
    relative error of 1."""
    base = equations.base
    scales = natural_scales(equations)
    own = np.flatnonzero(np.isfinite(scales))
    held = [0.0] * (len(equations.names) - len(equations.columns)) + [
        c.ordinary or 0.0 for c in equations.columns
    ]
    spread = description_covariance(equations) + np.diag(held) ** 2
    covariance = (base.T @ spread @ base.T.T)[np.ix_(own, own)]
    return own, covariance + np.diag((PLACEHOLDER * scales[own]) ** 2)


def description_error(fit: Fit, equations: BaseRegression, doubt: float = 0.0) -> float:
    """Return the relative error of the description according to the parameters that the data
    determine.

    It is the width of the prior of the estimate of `fit` minus the description, by maximum
    likelihood (empirical Bayes; B. Efron, Large-Scale Inference, 2010, 1), parameter by parameter.
    The width that predicts best is not the error of the description: for a parameter that the data
    do not show, any narrow prior predicts as well.
    """
    own, covariance = description_errors(equations)
    seen = np.isfinite(fit.std[own])
    off = (fit.Psi - equations.described)[own][seen]
    described = np.diag(covariance)[seen]
    noise = fit.std[own][seen] ** 2
    variances = noise + np.square(ERRORS)[:, None] * described
    likelihoods = -0.5 * np.sum(np.log(variances) + off**2 / variances, axis=1)
    best = int(np.argmax(likelihoods))
    if not doubt:
        return ERRORS[best]
    unlikely = np.flatnonzero(likelihoods[best] - likelihoods > doubt)
    return ERRORS[min(unlikely[unlikely > best].tolist(), default=-1)]


def chosen_width(
    blocks: Blocks, fit: Fit, equations: BaseRegression, correlated: float = 1.0
) -> float | None:
    """Return the width of the prior according to cross-validation.

    None if no prior predicts clearly better.
    """
    if len(blocks.factors) < 2 * FOLDS:
        return None
    laws = law_sizes(blocks, equations)
    loose, *priors = (
        prior_of(equations, width, laws=laws, correlated=correlated) for width in (np.inf, *WIDTHS)
    )
    parts = [
        _gram(blocks, part, fit.weights)
        for part in np.array_split(np.arange(len(blocks.factors)), FOLDS)
    ]
    plain = _left_out_errors(parts, loose)
    whole = np.sum(parts, axis=0)
    solution = np.append(-solved(whole, loose), 1.0)
    if (1.0 - GAIN) * plain.sum() <= solution @ whole @ solution:
        # Nothing predicts left-out parts much better than it fits them.
        return None

    def standard_error(summands: Array) -> float:
        return float(np.std(summands, ddof=1) * np.sqrt(len(summands)))

    errors = np.array([plain, *(_left_out_errors(parts, prior) for prior in priors)])
    total = errors.sum(axis=1)
    best = int(np.argmin(total))
    gain = errors[0] - errors[best]
    if total[best] > (1.0 - GAIN) * total[0] or gain.sum() < standard_error(gain):
        return None
    near = [
        k
        for k in range(1, len(errors))
        if total[k] - total[best] <= standard_error(errors[k] - errors[best])
    ]
    return WIDTHS[max(near, default=best) - 1]


def _gram(blocks: Blocks, part: Indices, weights: Array) -> Array:
    """Return the weighted sums (B + 1, B + 1) of some blocks."""
    found = np.zeros((blocks.width, blocks.width))
    for k in part.tolist():
        rows = (weights[:, None, None] * blocks.factors[k]).reshape(-1, blocks.width)
        found += rows.T @ rows - np.tensordot(weights**2, blocks.known_noise[k], 1)
    return found


def _left_out_errors(parts: Sequence[Array], prior: Prior | None) -> Array:
    """Return the squared weighted errors of each part, predicted from the others, (folds,)."""
    whole = np.sum(parts, axis=0)
    solutions = [np.append(-solved(whole - part, prior), 1.0) for part in parts]
    return np.array(
        [solution @ part @ solution for solution, part in zip(solutions, parts, strict=True)]
    )


def solved(gram: Array, prior: Prior | None) -> Array:
    """Return the parameters (B,) from sums, at unit length of the columns."""
    total = gram if prior is None else gram + prior.rows().T @ prior.rows()
    scale = np.sqrt(np.maximum(np.diag(total)[:-1], 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    normal = total[:-1, :-1] / np.outer(scale, scale)
    return np.asarray(
        np.linalg.pinv(normal, rcond=1e-13, hermitian=True) @ (total[:-1, -1] / scale) / scale
    )


def described_width(width: float, judge: str) -> str:
    """Return in words how far the description is trusted as a prior, and why."""
    prior = f"a prior of {100 * width:.2g} % of it"
    return f"regularised towards the description, with {prior}, which predicts {judge} best"
