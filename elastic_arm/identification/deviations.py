"""Standard deviations that are valid for errors of any colour.

    cov(Psi) = H S H',    H = (Phi'Phi)^-1
    S = sum of s s' over blocks,    s = Phi'(y - Phi Psi) of a block

This is the sandwich estimate, clustered by blocks that are longer than the correlation of the
errors: blocks whose scores s resemble those of their neighbours are joined (D. Andrews,
Econometrica 59 (1991) 817). With few blocks S is too small, which three corrections remedy:

- The score of each block is corrected for the block's share in the fit (jackknife).
- S is shrunk towards white errors of the size of all scores together, by the share that is closest
  to the truth on average (O. Ledoit and M. Wolf, Journal of Multivariate Analysis 88 (2004) 365).
- Deviations are widened by Student's distribution, with degrees of freedom from the blocks' shares
  in a parameter (R. Bell and D. McCaffrey, Survey Methodology 28 (2002) 169), along directions in
  which white errors have unit size. Parameters that share one torque scale to seven digits thus
  keep sharing it.
"""

from collections.abc import Iterable

import numpy as np
from scipy.special import stdtrit

from elastic_arm.arrays import Array

# With a single block, which has no scatter, errors count as white.
FEWEST_BLOCKS = 2
# Smallest share of a block's score that its share in the fit leaves.
LEAST_OWN = 1e-3
# Smallest share of the data in the information along a direction that they determine; below is
# rounding.
LEAST_SHARE = 1e-6
# Smallest noise of a group, as a share of its largest term; below is rounding.
NOISE_FLOOR = 1e-6
COVERED = 0.975
NORMAL = 1.96


def scattered(
    blocks: Iterable[tuple[Array, Array]],
    Psi: Array,
    weights: Array,
    back: Array,
    prior: Array | None = None,
) -> Array:
    """Return the covariance (P, P) of an estimate from its blocks' scores.

    blocks: factors of [Phi y] (groups, P + 1, P + 1), and the contribution of noise in Phi to their
    squares; back: (P, k) from whitened coordinates to parameters, so that `back @ back.T` is the
    covariance at unit noise; prior: rows [F, F mean].
    """
    solution = np.append(-Psi, 1.0)
    known = None
    pull = np.zeros(back.shape[1])
    if prior is not None:
        known = prior[:, :-1] @ back
        # The scores add up to minus the pull of the prior, which is not an error of the data. A
        # block that alone shows a parameter would otherwise answer for all of it, so the scores are
        # those at the estimate without the pull.
        pull = known.T @ (prior @ solution)
    to_unit, from_unit = _unit_errors(back.shape[1], known)
    each = []
    for factor, noise_in_phi in blocks:
        rows = (weights[:, None, None] * factor).reshape(-1, len(solution))
        noise = np.tensordot(weights**2, noise_in_phi, 1)
        score = back.T @ (rows.T @ (rows @ solution) - noise @ solution)[:-1]
        gram = (rows.T @ rows - noise)[:-1, :-1]
        each.append((gram, score + back.T @ gram @ back @ pull))
    joined = resembling(np.array([score for _, score in each]) @ to_unit.T)
    scores = []
    squares = np.zeros((len(to_unit),) * 2)
    for first in range(0, len(each), joined):
        gram, score = (sum(parts) for parts in zip(*each[first : first + joined], strict=True))
        shares, vectors = np.linalg.eigh(back.T @ gram @ back)
        corrected = (vectors.T @ score) / np.maximum(1.0 - shares, LEAST_OWN)
        scores.append(to_unit @ vectors @ corrected)
        own = (to_unit @ vectors * np.maximum(shares, 0.0)) @ vectors.T @ to_unit.T
        squares += own @ own
    meat, target, share = shrunk(np.array(scores))
    wide = back @ from_unit @ widening(squares, np.sqrt(1.0 - share))
    mixed = (1.0 - share) * meat + share * target * np.eye(len(meat))
    return wide @ mixed @ wide.T


def resembling(scores: Array) -> int:
    """Return the number of neighbouring blocks whose scores (blocks, k) resemble each other, 1 or
    more.

    It is Andrews' bandwidth of Bartlett's window for a first-order autoregressive process.
    """
    neighbours = float(np.sum(scores[1:] * scores[:-1]))
    share = max(neighbours / max(float(np.sum(scores**2)), 1e-300), 0.0)
    width = 1.1447 * (4.0 * share**2 / (1.0 - share**2) ** 2 * len(scores)) ** (1.0 / 3.0)
    return max(1, min(round(width), len(scores) // FEWEST_BLOCKS))


def _unit_errors(k: int, known: Array | None) -> tuple[Array, Array]:
    """Return matrices from k whitened coordinates to m coordinates in which white errors give
    scores of unit size, and back.

    They are not unit matrices under a prior: there the scores of white errors are as large as the
    share of the data in the information. Shrinking them towards a multiple of the unit matrix would
    mistake parameters that the prior determines for a lack of errors. Directions that the data do
    not determine are left out.
    """
    if known is None:
        return np.eye(k), np.eye(k)
    shares, axes = np.linalg.eigh(np.eye(k) - known.T @ known)
    shown = shares > LEAST_SHARE
    size = np.sqrt(shares[shown])
    axes = axes[:, shown]
    return (axes / size).T, axes * size


def shrunk(scores: Array) -> tuple[Array, float, float]:
    """Return the covariance (k, k) of a sum of scores (blocks, k), the factor of the unit matrix
    towards which it is shrunk, and the share of the latter.

    Ledoit and Wolf's estimate: the mixture of both that is closest to the true covariance on
    average.
    """
    blocks, k = scores.shape
    meat = scores.T @ scores
    target = float(np.trace(meat)) / max(k, 1)  # with a prior, the data may determine no direction
    apart = np.sum((meat - target * np.eye(k)) ** 2)
    scatter = np.sum(np.sum(scores**2, axis=1) ** 2) - np.sum(meat**2) / blocks
    return meat, target, 1.0 if scatter >= apart else float(scatter / apart)


def widening(squares: Array, own: float = 1.0) -> Array:
    """Return the matrix (k, k) that widens whitened errors because there are few blocks.

    Satterthwaite's degrees of freedom along each eigenvector are the number of blocks if all
    contribute equally, and fewer if some dominate; one is lost to the estimate itself.

    squares: sum (k, k) of the squares of each block's share in the information; own: sensitivity of
    the variance to the scatter of the scores, 1 without shrinkage. The target of the shrinkage
    hardly scatters, but may be wrong, so the square root of the scatter's share is a compromise.
    """
    values, vectors = np.linalg.eigh(squares)
    freedom = np.maximum(1.0 / np.maximum(values, 1e-12) - 1.0, 1.0) / max(own, 1e-6)
    return (vectors * (stdtrit(freedom, COVERED) / NORMAL)) @ vectors.T


def white(r: Array, weights: Array, noise: Array, back: Array) -> Array:
    """Return the covariance (P, P) for white errors of this size."""
    phi = ((weights**2 * noise)[:, None, None] * (r[..., :-1] @ back)).reshape(-1, back.shape[1])
    return back @ (phi.T @ phi) @ back.T


def residual_norms(r: Array, Psi: Array) -> Array:
    """Return |y - Phi Psi| of every group, (groups,), from factors (groups, width, width)."""
    return np.linalg.norm(r[..., -1] - r[..., :-1] @ Psi, axis=-1)


def residual_std(r: Array, Psi: Array, samples: Array | float) -> Array:
    """Return the std (groups,) of the residuals, Nm, never below rounding."""
    active = np.count_nonzero(np.linalg.norm(r[..., :-1], axis=-2), axis=-1)
    freedom = np.maximum(samples - active / max(len(r) / len(Psi), 1.0), 1.0)
    largest = largest_terms(r, Psi)
    floor = NOISE_FLOOR * np.maximum(largest, np.max(largest) * 1e-6) + np.finfo(float).tiny
    return np.maximum(residual_norms(r, Psi), floor) / np.sqrt(freedom)


def largest_terms(r: Array, Psi: Array) -> Array:
    """Return the norm over all samples of each group's largest term, (groups,)."""
    terms: Array = np.linalg.norm(r, axis=-2) * np.append(np.abs(Psi), 1.0)
    return np.max(terms, axis=-1)


def inflation(robust: Array, white: Array) -> float:
    """Return the median ratio of variances to those of white errors."""
    by_scatter = np.diag(robust)
    by_noise = np.diag(white)
    known = np.isfinite(by_scatter) & np.isfinite(by_noise) & (by_noise > 0)
    return float(np.median(by_scatter[known] / by_noise[known])) if known.any() else 1.0
