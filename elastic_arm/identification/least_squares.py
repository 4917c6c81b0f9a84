"""Least squares in constant memory: triangular factors of blocks of samples, and what follows from
them.

    Psi = argmin sum w_g² |y_g - Phi_g Psi|² over groups g,    w_g = 1 / std(y_g - Phi_g Psi)

A group is the rows of one equation of one joint. Each block of samples leaves a triangular factor R
of each group's rows, R'R = [Phi y]'[Phi y] (QR), so that nothing is lost by squaring. At most
:data:`MOST_BLOCKS` are kept: when they are full, neighbours are put together. The scores of the
blocks, Phi'(y - Phi Psi), give standard deviations for coloured errors too.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular

from elastic_arm.arrays import Array
from elastic_arm.errors import IdentificationError
from elastic_arm.identification import deviations
from elastic_arm.identification.errors_in_variables import covariance_left, without_noise
from elastic_arm.identification.triangular import triangular

MOST_BLOCKS = 64
# With fewer long blocks than this there is nothing to tell the errors' colour by.
FEWEST_LONG_BLOCKS = 8
# Below this share of the largest singular value of the equilibrated columns a direction is not
# determined.
RANK_FLOOR = 1e-9
# What a rigid arm's model misses is no noise: joints with the smallest residuals would decide on
# masses that others show better. Weights of 1/sqrt(rms) make the sum of the joints' rms residuals
# least (those of 1/rms their product, equal ones the sum of squares), whose slope in each joint's
# sum of squares is 1/(2 rms).
MISFIT_POWER = 0.5
# What has no more than this share in such a direction is determined: the direction itself is only
# known so well.
OPEN_SHARE = 1e-3
# An equation is not believed to close better than this share of its largest term, in a way that no
# number of samples averages out: an arm with exact sensors, sampled at 1 kHz, closes its own to
# 2e-10 where its torques are smooth and to 3e-9 where its drives hold their commands for a sample,
# which leaves faster motion than the samples can show.
CLOSURE = 3e-9


@dataclass
class Blocks:
    """The accumulator: a bounded number of blocks, each a factor of its rows for each group."""

    groups: int  # Number of groups
    width: int  # Columns, the measured side included
    most: int = MOST_BLOCKS  # Largest number of blocks kept, even
    span: int = 1  # Units of samples that make a block; it doubles whenever the blocks are full
    # R (groups, width, width) of each block, R'R = [Phi y]'[Phi y]
    factors: list[Array] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)  # Samples of each block
    # (groups, width, width) of each block: what noise in Phi is known to add to R'R, on the average
    known_noise: list[Array] = field(default_factory=list)
    # of each group's rows, (groups,), those that count; others are zero
    share: Array = field(default_factory=lambda: np.ones(()))
    _units: int = 0

    @property
    def begun(self) -> int:
        """Units in the last block, if it takes more."""
        return self._units

    @property
    def room(self) -> int:
        """Units that the last block still takes."""
        return self.span - self._units

    def add(
        self, factor: Array, count: int, units: int = 1, known_noise: Array | None = None
    ) -> None:
        """Add the factors of the next `count` samples, which are `units` units.

        There are at most :attr:`room`.
        """
        noise = np.zeros_like(factor) if known_noise is None else known_noise
        if self._units:
            self.factors[-1] = triangular(np.concatenate([self.factors[-1], factor], axis=1))
            self.counts[-1] += count
            self.known_noise[-1] = self.known_noise[-1] + noise
        else:
            self.factors.append(factor)
            self.counts.append(count)
            self.known_noise.append(noise)
        self._units = (self._units + units) % self.span
        if len(self.factors) == self.most and not self._units:
            self._halve()

    @property
    def samples(self) -> int:
        """Samples in all blocks."""
        return sum(self.counts)

    @property
    def noisy(self) -> bool:
        """Whether any noise in Phi is known."""
        return any(noise.any() for noise in self.known_noise)

    def noise(self) -> Array:
        """Return what noise in Phi is known to add to all samples, (groups, width, width)."""
        return np.sum(self.known_noise, axis=0)

    def total(self) -> Array:
        """Return the triangular factors (groups, width, width) of all samples."""
        none = np.zeros((self.groups, 0, self.width))
        return triangular(np.concatenate([none, *self.factors], axis=1))

    def corrected(self, weights: Array, factors: Array) -> Array:
        """Return the triangular factor (width, width) of all weighted rows.

        Known noise in Phi is taken off.
        """
        whole = triangular((weights[:, None, None] * factors).reshape(-1, self.width))
        if not self.noisy:
            return whole
        return triangular(without_noise(whole, np.tensordot(weights**2, self.noise(), 1)))

    def transformed(self, change: Array) -> Blocks:
        """Return the blocks of rows [Phi y] C, for C `change` (groups, width, width)."""
        back = change.transpose(0, 2, 1)
        factors = [factor @ change for factor in self.factors]
        noise = [back @ known @ change for known in self.known_noise]
        return replace(self, factors=factors, counts=list(self.counts), known_noise=noise)

    def copy(self) -> Blocks:
        """Return blocks that go their own way from here."""
        return replace(
            self,
            factors=list(self.factors),
            counts=list(self.counts),
            known_noise=list(self.known_noise),
        )

    def _halve(self) -> None:
        pairs = [slice(k, k + 2) for k in range(0, len(self.factors), 2)]
        self.factors = [triangular(np.concatenate(self.factors[pair], axis=1)) for pair in pairs]
        self.counts = [sum(self.counts[pair]) for pair in pairs]
        self.known_noise = [np.sum(self.known_noise[pair], axis=0) for pair in pairs]
        self.span *= 2


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters before the recording."""

    mean: Array  # (P,) values
    # (P, P) triangular or not: the information is factor' factor; zero columns where nothing is
    # known
    factor: Array
    # how many times larger the errors of `mean` are than `factor` weighs them, of all rows or (P,):
    # a prior that is chosen so that it predicts well may be narrower than its own errors, and those
    # count in the deviations
    excess: float | Array = 1.0

    def rows(self) -> Array:
        """Return rows (P, P + 1) below those of the data, in units of the data's noise."""
        return np.column_stack([self.factor, self.factor @ self.mean])


@dataclass(frozen=True)
class Fit:
    """A least-squares estimate and its doubts."""

    Psi: Array  # (P,) estimate
    covariance: Array  # (P, P), from the blocks' scores: holds for coloured errors
    white_covariance: Array  # (P, P), as if errors were white
    noise: Array  # (groups,) std of the residuals
    weights: Array  # (groups,) a power of 1/noise; weighted residuals have a mean square of one
    # (P + 1, P + 1) weighted triangular factor of all rows: R Psi = z is the whole problem
    factor: Array
    condition: float  # Condition number of the equilibrated columns
    # (k, P) unit vectors, in units of the equilibrated columns, of what the data leave open
    undetermined: Array
    samples: int  # Number of samples
    fixed: tuple[
        int, ...
    ] = ()  # Places of parameters that were not estimated: they are those of the description

    @property
    def std(self) -> Array:
        """Standard deviations (P,); infinite along directions that the data leave open."""
        left_open = np.any(np.abs(self.undetermined) > OPEN_SHARE, axis=0)
        left_open[list(self.fixed)] = True
        return np.where(left_open, np.inf, np.sqrt(np.diag(self.covariance)))


def fit(blocks: Blocks, power: float = 1.0, rounds: int = 4, prior: Prior | None = None) -> Fit:
    """Solve the accumulated problem.

    Groups are weighed by 1/noise to a `power`, estimated in `rounds` rounds.

    Raises an IdentificationError if there are fewer samples than parameters.
    """
    P = blocks.width - 1
    rows = blocks.samples * blocks.groups
    if rows <= P:
        raise IdentificationError(
            f"{rows} equations do not determine {P} parameters", "Record several seconds of motion."
        )
    r = blocks.total()
    live = np.any(r[..., -1] != 0.0, axis=-1)
    weights = np.ones(blocks.groups)
    for _ in range(rounds if power else 1):
        Psi, *_ = _solve(blocks.corrected(weights, r))
        noise = deviations.residual_std(r, Psi, blocks.samples * blocks.share)
        weights = noise**-power
        weights /= np.sqrt(np.mean((weights * noise)[live] ** 2)) if live.any() else 1.0
    whole = blocks.corrected(weights, r)
    known = whole if prior is None else triangular(np.vstack([whole, prior.rows()]))
    Psi, number, undetermined, back = _solve(known)
    noise = deviations.residual_std(r, Psi, blocks.samples * blocks.share)
    robust, white = _covariances(blocks, (Psi, weights, noise), back, r, prior)
    if prior is not None:
        own = _prior_covariance(known, prior)
        robust = robust + own
        white = white + own
    return Fit(Psi, robust, white, noise, weights, whole, number, undetermined, blocks.samples)


def correlation(blocks: Blocks, found: Fit, samples: float) -> float:
    """Return the ratio of variances to those of white errors, by scatter of long blocks."""
    if len(blocks.factors) < FEWEST_LONG_BLOCKS:
        return float("inf")
    long = blocks.copy()
    fewest = 2 * FEWEST_LONG_BLOCKS
    while len(long.factors) >= fewest and long.samples < samples * len(long.factors):
        long._halve()
    *_, back = _solve(found.factor)
    robust, white = _covariances(
        long, (found.Psi, found.weights, found.noise), back, blocks.total()
    )
    return deviations.inflation(robust, white)


def _prior_covariance(known: Array, prior: Prior) -> Array:
    """Return what the prior's own errors add to the covariance (P, P), as far as the data leave
    parameters to it."""
    columns, scale = _equilibrated(known)
    inverse = np.linalg.pinv(columns.T @ columns, rcond=RANK_FLOOR**2, hermitian=True) / np.outer(
        scale, scale
    )
    passed = inverse @ (prior.factor.T * prior.excess)
    return passed @ passed.T


def condition(columns: Array) -> float:
    """Return the condition number of columns (rows, k) at unit length."""
    size = np.linalg.norm(columns, axis=0)
    s = np.linalg.svd(columns / np.where(size > 0, size, 1.0), compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0 else float("inf")


def _equilibrated(whole: Array) -> tuple[Array, Array]:
    """Return the columns at unit length, and their lengths."""
    size = np.linalg.norm(whole[:, :-1], axis=0)
    scale = np.where(size > 0, size, 1.0)
    return whole[:, :-1] / scale, scale


def _solve(whole: Array) -> tuple[Array, float, Array, Array]:
    """Solve R Psi = z; directions below the rank floor have no weight (minimum norm in equilibrated
    units).

    Returns Psi, the condition number, the undetermined directions, and the way from whitened
    coordinates to Psi.
    """
    columns, scale = _equilibrated(whole)
    u, s, vt = np.linalg.svd(columns, full_matrices=False)
    known = s > RANK_FLOOR * s[0]
    if known.all():
        P = len(scale)
        Psi = solve_triangular(columns[:P], whole[:P, -1]) / scale
    else:
        Psi = vt[known].T @ ((u[:, known].T @ whole[:, -1]) / s[known]) / scale
    back = (vt[known].T / s[known]) / scale[:, None]
    return Psi, float(s[0] / s[-1]) if s[-1] > 0 else float("inf"), vt[~known], back


def _covariances(
    blocks: Blocks,
    solved: tuple[Array, Array, Array],
    back: Array,
    r: Array,
    prior: Prior | None = None,
) -> tuple[Array, Array]:
    """Return the covariance from the blocks' scores, and that of white errors, for `solved`: Psi,
    weights and noise.

    Both include what :data:`CLOSURE` leaves open, where parameters differ by the last digits of an
    equation alone, and what is not known of the noise in Phi.
    """
    Psi, weights, noise = solved
    systematic = deviations.white(r, weights, CLOSURE * deviations.largest_terms(r, Psi), back)
    if blocks.noisy:
        known_noise = (weights**2)[:, None, None] * blocks.noise()
        rows = triangular((weights[:, None, None] * r).reshape(-1, blocks.width))
        described = np.zeros_like(Psi) if prior is None else prior.mean
        left = covariance_left(known_noise, rows, Psi, described, blocks.samples)[:-1, :-1]
        systematic = systematic + back @ back.T @ left @ back @ back.T
    white = deviations.white(r, weights, noise, back) + systematic
    if len(blocks.factors) < deviations.FEWEST_BLOCKS:
        return white, white
    scores = zip(blocks.factors, blocks.known_noise, strict=True)
    held = None if prior is None else prior.rows()
    return deviations.scattered(scores, Psi, weights, back, held) + systematic, white
