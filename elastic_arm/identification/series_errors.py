"""What the errors of fitted Fourier series do to the estimate.

A coefficient that is off by a little is off in every period alike: blocks of samples do not see it. But its standard
deviation is known, and so is what it does to the equations; the rest is propagation of errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.series import FourierFit
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Fit

Array = NDArray[np.float64]

# The sums run over about so many samples of the motion, which is smooth.
ENOUGH_SAMPLES = 3000
# Step of the difference quotient over the state, relative to its size.
STEP = 1e-4


def series_covariance(
    equations: BaseRegression, fit: Fit, motion: Motion, link: FourierFit | None, motor: FourierFit | None
) -> Array:
    """Return what the errors of the series add to the covariance (B, B) of the base parameters.

    Parameters
    ----------
    equations, fit
        What was estimated.
    motion
        From the series.
    link, motor
        The series of the two sides.
    """
    every = max(1, len(motion) // ENOUGH_SAMPLES)
    thin = motion[::every]
    weighted = equations.rows(thin)[..., :-1] * (fit.weights**2)[:, None, None]
    meat = np.zeros((len(fit.Psi),) * 2)
    for side, series in (("q", link), ("theta", motor)):
        if series is None:
            continue
        bases = series.bases(thin.t - motion.t[0])
        for j, variance in enumerate(series.variances().T):
            score = np.zeros((len(fit.Psi), len(variance)))
            for rate, basis in zip(("", "d", "dd"), bases, strict=True):
                change = _change(equations, fit.Psi, thin, rate + side, j)
                score += np.einsum("gnb,gn->nb", weighted, change).T @ basis
            score *= every
            meat += (score * variance) @ score.T
    r = fit.factor[:-1, :-1]
    size = np.linalg.norm(r, axis=0)
    scale = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv((r / scale).T @ (r / scale), rcond=1e-15, hermitian=True) / np.outer(scale, scale)
    return np.asarray(inverse @ meat @ inverse)


def _change(equations: BaseRegression, Psi: Array, motion: Motion, channel: str, j: int) -> Array:
    """Return the derivative of all predicted rows (groups, N) by a channel of joint j."""
    values: Array = getattr(motion, channel)
    step = STEP * float(np.std(values[:, j])) + 1e-9
    ahead, behind = (np.concatenate(list(_predicted(equations, Psi, motion, channel, j, h))) for h in (step, -step))
    return (ahead - behind) / (2.0 * step)


def _predicted(
    equations: BaseRegression, Psi: Array, motion: Motion, channel: str, j: int, step: float
) -> Iterator[Array]:
    values = getattr(motion, channel).copy()
    values[:, j] += step
    predicted = equations.predict(replace(motion, **{channel: values}), Psi)
    yield from (predicted[side].T for side in equations.sides)
