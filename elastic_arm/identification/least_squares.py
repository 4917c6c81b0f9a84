"""Least squares in constant memory: triangular factors of blocks of samples, and what follows from them.

A *group* is the rows of one equation of one joint. Each block of samples leaves one triangular factor per group,
R'R = [Phi y]'[Phi y]. At most :data:`MOST_BLOCKS` blocks are kept: when they are full, neighbours are merged by an
orthogonal transformation and blocks become twice as long. Nothing else is stored, however long the stream runs, and
still the scores of the blocks, Phi'(y - Phi Psi), are there for any Psi: they give standard deviations that hold for
coloured errors too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from elastic_arm.errors import IdentificationError

Array = NDArray[np.float64]

MOST_BLOCKS = 64
# Below this share of the largest singular value of the equilibrated columns a direction is not determined.
RANK_FLOOR = 1e-9
# A group's noise is not believed to be smaller than this share of its largest term: rounding, not data.
NOISE_FLOOR = 1e-6


def factor(rows: Array) -> Array:
    """Return triangular factors of rows.

    Parameters
    ----------
    rows
        (groups, N, width): regressor columns and, last, the measured side.

    Returns
    -------
    (groups, width, width), upper triangular.
    """
    width = rows.shape[-1]
    r: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    if r.shape[-2] < width:
        r = np.concatenate([r, np.zeros((*r.shape[:-2], width - r.shape[-2], width))], axis=-2)
    return r


@dataclass
class BlockFactors:
    """The accumulator: a bounded number of block factors.

    Parameters
    ----------
    groups
        Number of groups.
    width
        Columns, the measured side included.
    most
        Largest number of blocks kept, even.
    """

    groups: int
    width: int
    most: int = MOST_BLOCKS
    span: int = 1
    factors: list[Array] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    _open: int = 0

    def add(self, r: Array, count: int) -> None:
        """Add the factor (groups, width, width) of the next `count` samples."""
        if self._open:
            self.factors[-1] = factor(np.concatenate([self.factors[-1], r], axis=1))
            self.counts[-1] += count
        else:
            self.factors.append(r)
            self.counts.append(count)
        self._open = (self._open + 1) % self.span
        if len(self.factors) == self.most and not self._open:
            self._halve()

    @property
    def samples(self) -> int:
        """Samples in all blocks."""
        return sum(self.counts)

    def total(self) -> Array:
        """Return the factor (groups, width, width) of all samples."""
        if not self.factors:
            return np.zeros((self.groups, self.width, self.width))
        return factor(np.concatenate(self.factors, axis=1))

    def merged(self, other: BlockFactors) -> BlockFactors:
        """Return the blocks of both, as of two recordings."""
        both = BlockFactors(self.groups, self.width, self.most, max(self.span, other.span))
        both.factors, both.counts = self.factors + other.factors, self.counts + other.counts
        while len(both.factors) >= both.most:
            both._halve()
        return both

    def _halve(self) -> None:
        pairs = [slice(k, k + 2) for k in range(0, len(self.factors), 2)]
        self.factors = [factor(np.concatenate(self.factors[pair], axis=1)) for pair in pairs]
        self.counts = [sum(self.counts[pair]) for pair in pairs]
        self.span *= 2


@dataclass(frozen=True)
class Fit:
    """A least-squares estimate and its doubts.

    Parameters
    ----------
    Psi
        (P,) estimate.
    covariance
        (P, P), from the blocks' scores: holds for coloured errors.
    white_covariance
        (P, P), as if errors were white.
    noise
        (groups,) std of the residuals.
    weights
        (groups,) 1/noise, or ones.
    factor
        (P + 1, P + 1) weighted triangular factor of all rows: R Psi = z is the whole problem.
    condition
        Condition number of the equilibrated columns.
    undetermined
        (k, P) unit vectors, in units of the equilibrated columns, of what the data leave open.
    samples
        Number of samples.
    """

    Psi: Array
    covariance: Array
    white_covariance: Array
    noise: Array
    weights: Array
    factor: Array
    condition: float
    undetermined: Array
    samples: int

    @property
    def std(self) -> Array:
        """Standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(blocks: BlockFactors, weighted: bool = True, rounds: int = 4) -> Fit:
    """Solve the accumulated problem.

    Parameters
    ----------
    blocks
        The data.
    weighted
        Weigh every group by its noise, estimated from the residuals in `rounds` rounds; else ordinary least squares.

    Raises
    ------
    IdentificationError
        If there are fewer samples than parameters.
    """
    P = blocks.width - 1
    if blocks.samples * blocks.groups <= P:
        raise IdentificationError(
            f"{blocks.samples} samples do not determine {P} parameters", "Record some seconds of motion."
        )
    r = blocks.total()
    weights = np.ones(blocks.groups)
    for _ in range(rounds if weighted else 1):
        whole = factor((weights[:, None, None] * r).reshape(1, -1, P + 1))[0]
        Psi, condition, undetermined = _solve(whole)
        noise = _noise(r, Psi, blocks.samples)
        if weighted:
            weights = 1.0 / noise
    if weighted:
        whole = factor((weights[:, None, None] * r).reshape(1, -1, P + 1))[0]
        Psi, condition, undetermined = _solve(whole)
        noise = _noise(r, Psi, blocks.samples)
    robust, white = _covariances(blocks, Psi, weights, noise, whole)
    return Fit(Psi, robust, white, noise, weights, whole, condition, undetermined, blocks.samples)


def residual_norms(r: Array, Psi: Array) -> Array:
    """Return |y - Phi Psi| of every group, (groups,), from factors (groups, width, width)."""
    return np.linalg.norm(r[..., -1] - r[..., :-1] @ Psi, axis=-1)


def _noise(r: Array, Psi: Array, samples: int) -> Array:
    """Return the std of the residuals, never below rounding."""
    active = np.count_nonzero(np.linalg.norm(r[..., :-1], axis=-2), axis=-1)
    freedom = np.maximum(samples - active / max(len(r) / len(Psi), 1.0), 1.0)
    largest = np.max(np.linalg.norm(r, axis=-2) * np.append(np.abs(Psi), 1.0), axis=-1)
    floor = NOISE_FLOOR * np.maximum(largest, np.max(largest) * 1e-6) + np.finfo(float).tiny
    return np.maximum(residual_norms(r, Psi), floor) / np.sqrt(freedom)


def _equilibrated(whole: Array) -> tuple[Array, Array]:
    """Return the columns at unit length, and their lengths."""
    size = np.linalg.norm(whole[:, :-1], axis=0)
    scale = np.where(size > 0, size, 1.0)
    return whole[:, :-1] / scale, scale


def _solve(whole: Array) -> tuple[Array, float, Array]:
    """Solve R Psi = z; directions below the rank floor get no say (minimum norm in equilibrated units)."""
    columns, scale = _equilibrated(whole)
    u, s, vt = np.linalg.svd(columns, full_matrices=False)
    known = s > RANK_FLOOR * s[0]
    if known.all():
        P = len(scale)
        Psi = solve_triangular(columns[:P], whole[:P, -1]) / scale
    else:
        Psi = vt[known].T @ ((u[:, known].T @ whole[:, -1]) / s[known]) / scale
    return Psi, float(s[0] / s[-1]) if s[-1] > 0 else float("inf"), vt[~known]


def _covariances(blocks: BlockFactors, Psi: Array, weights: Array, noise: Array, whole: Array) -> tuple[Array, Array]:
    """Return the covariance from the blocks' scores, and that of white errors.

    The scores are mended for the share of each block in the fit (bias-reduced linearization, R. Bell and
    D. McCaffrey, Survey Methodology 28 (2002) 169), without which few blocks look too quiet.
    """
    columns, scale = _equilibrated(whole)
    _, s, vt = np.linalg.svd(columns, full_matrices=False)
    known = s > RANK_FLOOR * s[0]
    back = (vt[known].T / s[known]) / scale[:, None]  # whitened coordinates -> Psi
    white = back @ _white_meat(blocks, weights, noise, back) @ back.T
    if len(blocks.factors) < 8:
        return white, white
    square = weights[:, None, None] ** 2
    meat = np.zeros((back.shape[1],) * 2)
    for r in blocks.factors:
        phi = r[..., :-1] @ back
        error = r[..., -1] - r[..., :-1] @ Psi
        leverage = np.sum(square * (phi.transpose(0, 2, 1) @ phi), axis=0)
        score = np.einsum("g,gik,gi->k", weights**2, phi, error)
        values, vectors = np.linalg.eigh(leverage)
        mended = vectors @ ((vectors.T @ score) / np.sqrt(np.maximum(1.0 - values, 1e-3)))
        meat += np.outer(mended, mended)
    return back @ meat @ back.T, white


def _white_meat(blocks: BlockFactors, weights: Array, noise: Array, back: Array) -> Array:
    phi = blocks.total()[..., :-1] @ back
    return np.einsum("g,gik,gil->kl", (weights**2 * noise) ** 2, phi, phi)
