"""The posterior of a set of terms in closed form, and its evidence.

H_b, b_b and c_b are the products of band b, N(m, P^-1) is the prior, and v_b the noise power:

    A = P + sum_b H_b / v_b,   x = A^-1 (P m + sum_b b_b / v_b),   rss_b = c_b - 2 b_b'x + x'H_b x
    ln p = -1/2 sum_b (n_b ln v_b + rss_b / v_b) - 1/2 |x - m|²_P
           + 1/2 ln |P| - 1/2 ln |A| - 1/2 sum_{v_b > 1} ln n_b
    v_b  = max(1, rss_b / (n_b - tr(A^-1 H_b) / v_b))                              (MacKay 1992)

v_b is estimated at places where a noise spectrum of their own increases the evidence, and is 1
elsewhere. Residuals that no term explains thus count as noise and do not bias the terms. A
truncated prior multiplies the evidence by the posterior mass within its bounds over the prior mass.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.special import log_ndtr

from elastic_arm.arrays import Array, Indices

STEPS = 60  # iterations of the noise powers; numerical
SETTLED = 0.01  # change of their logarithms that counts as zero; numerical
JITTER = 1e-13  # share of the diagonal of the precision; numerical


class Products(NamedTuple):
    """Products of a set of terms, B bands and p coefficients."""

    half: Array  # (B, p (p + 1) / 2) lower half of H, row by row
    b: Array  # (B, p)
    yy: Array  # (B,)


@dataclass(frozen=True)
class Prior:
    """Gaussian priors of p coefficients, each truncated to an interval."""

    mean: Array
    std: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Posterior:
    """The posterior of coefficients at the most probable noise."""

    # x, S: (p,) and (p, p) mean and covariance
    x: Array
    S: Array
    v: Array  # (B,) noise power by band
    left: Array  # (B,) remaining sum of squares by band
    evidence: float  # ln p(y), up to a constant of the data


def posterior(
    products: Products,
    n: Array,
    prior: Prior,
    place: Indices,
    coloured: float,
    start: Array | None = None,
) -> Posterior:
    """Return the posterior of a set of terms.

    n: number of rows of each band (B,); place: place of each band (B,); coloured: ln of the prior
    odds that the noise of a place has a spectrum of its own; start: initial noise powers (B,).
    """
    half, b, yy = products
    P = prior.std**-2.0
    row, column = np.tril_indices(b.shape[1])
    twice = np.where(row == column, 1.0, 2.0)  # weights of the lower half in sums over both halves
    v = np.ones(len(n)) if start is None else start
    for _ in range(STEPS):
        w = 1.0 / v
        A = np.zeros((len(P), len(P)))
        A[row, column] = w @ half
        x, S, logdet = _solve(A, w @ b, P, prior.mean)
        left = np.maximum(yy - 2.0 * (b @ x) + half @ (x[row] * x[column] * twice), 0.0)
        used = w * (half @ (S[row, column] * twice))
        new = np.maximum(left / np.maximum(n - used, 1.0), 1.0)
        # A place has a spectrum of its own if the evidence outweighs the prior.
        worth = 0.5 * (left - n * np.log(new) - left / new - np.where(new > 1.0, np.log(n), 0.0))
        own = np.bincount(place, worth)[place] + coloured > 0.0
        new = np.where(own, new, 1.0)
        change = float(np.max(np.abs(np.log(new / v))))
        if change < SETTLED:
            break
        v = new
    S = S + np.tril(S, -1).T
    of_data = np.sum(n * np.log(v) + left / v)
    of_prior = np.sum(P * (x - prior.mean) ** 2)
    evidence = -0.5 * float(of_data + of_prior + logdet - np.sum(np.log(P)))
    louder = v > 1.0
    evidence += coloured * len(np.unique(place[louder])) - 0.5 * float(np.sum(np.log(n[louder])))
    std = np.sqrt(np.diag(S))
    bounded = np.isfinite(prior.low) | np.isfinite(prior.high)
    if bounded.any():
        bounds = prior.low[bounded], prior.high[bounded]
        after = mass(x[bounded], std[bounded], *bounds)
        before = mass(prior.mean[bounded], prior.std[bounded], *bounds)
        evidence += float(np.sum(after - before))
    return Posterior(x, S, v, left, evidence)


def _solve(A: Array, rhs: Array, P: Array, mean: Array) -> tuple[Array, Array, float]:
    """Return the mean, the lower half of the covariance, and ln |A|, with the prior added.

    A: lower half of the precision by the data.
    """
    diagonal = np.einsum("ii->i", A)
    diagonal += P
    diagonal *= 1.0 + JITTER
    # The transpose has the memory order of LAPACK.
    U, _ = lapack.dpotrf(A.T, lower=0, overwrite_a=1)
    logdet = 2.0 * float(np.sum(np.log(np.diag(U))))
    S = lapack.dpotri(U, lower=0, overwrite_c=1)[0].T
    rhs = rhs + P * mean
    return S @ rhs + rhs @ S - np.diag(S) * rhs, S, logdet


def mass(mean: Array, std: Array, low: Array, high: Array) -> Array:
    """Return ln of the probability mass (k,) of Gaussians within their bounds."""
    below = log_ndtr((low - mean) / std)
    above = log_ndtr((mean - high) / std)
    inside = -np.expm1(np.logaddexp(below, above))
    # If nearly all mass is outside, the nearer tail decides.
    tail = np.maximum(log_ndtr((mean - low) / std), -1e4)
    other = np.maximum(log_ndtr((high - mean) / std), -1e4)
    return np.where(inside > 1e-6, np.log(np.maximum(inside, 1e-300)), np.minimum(tail, other))
