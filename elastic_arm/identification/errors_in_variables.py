"""The effect of encoder noise on a regressor, and on the sums from which a fit is computed.

    E[Phi'Phi] = Phi_true'Phi_true + E[dPhi'dPhi]

On average, noise in positions and accelerations reduces the estimates of weak parameters (W. A.
Fuller, Measurement Error Models, 1987). The covariance of the noise after the smoother is known, so
its average effect can be subtracted.
"""

import functools
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.noise import WHITE, StateNoise
from elastic_arm.identification.base_regression import BaseRegression

# Over steps of this size in position, velocity and acceleration (rad, rad/s, rad/s²) a regressor is
# next to straight, and rounding has no say. Steps are never below the noise itself.
STEPS = np.array([1e-4, 1e-3, 1e-2])
_RATES = ("", "d", "dd")
# Of the noise that would leave nothing of the sums in some direction, so much is taken off at the
# most.
MOST_TAKEN_OFF = 0.9
# Singular values below this share of the largest are rounding.
SMALLEST = 1e-12
# Coefficients of a spectrum per sample from which the level of white noise is estimated.
WHITE_SHARE = WHITE[1] - WHITE[0]


def noise_sums(equations: BaseRegression, motion: Motion, every: int, first: int) -> Array | None:
    """Return the average contribution of noise to [Phi y]'[Phi y], (groups, B + 1, B + 1).

    None if the motion counts as exact. To second order E[G(x + e)] - G(x) = 1/2 sum_jk C_jk d²G /
    dx_j dx_k, with G = [Phi y]'[Phi y]; with directions v that make up C, 1/2 sum_v d²G/dv².
    """
    if motion.noise is None:
        return None
    steps, offsets = _directions(motion.noise)
    chosen = np.arange(first, len(motion), every)
    if not len(steps) or not len(chosen):
        return None
    rows = equations.rows(_moved(motion[chosen], offsets))
    rows = rows.reshape(rows.shape[0], -1, len(chosen), rows.shape[-1])
    middle = rows[:, :1]
    ahead = rows[:, 1::2]
    behind = rows[:, 2::2]
    steps = steps[:, None, None]
    slope = ahead - behind
    slope /= 2.0 * steps
    slope = slope.reshape(len(rows), -1, rows.shape[-1])
    bend = ahead + behind
    bend -= 2.0 * middle
    bend /= steps**2
    curved = 0.5 * middle[:, 0].transpose(0, 2, 1) @ bend.sum(axis=1)
    sloped = slope.transpose(0, 2, 1) @ slope
    return every * (sloped + curved + curved.transpose(0, 2, 1))


@functools.lru_cache(maxsize=8)
def _directions(noise: StateNoise) -> tuple[Array, dict[str, Array]]:
    """Return directions that make up the covariance of the states, at most three a joint and side.

    How many standard deviations differences along each of them (V,) reach, and by channel what they
    add to it, (1 + 2 V, n): nothing, then a step ahead and one back in each direction.
    """
    found: list[tuple[str, int, Array, float]] = []
    for side, covariances in (("q", noise.link), ("theta", noise.motor)):
        for joint, covariance in enumerate(() if covariances is None else covariances):
            std = np.sqrt(np.diag(covariance))
            if not std.all():
                continue
            values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
            for direction in (vectors * np.sqrt(np.maximum(values, 0.0))).T * std:
                step = max(1.0, float(1.0 / np.max(np.abs(direction) / STEPS)))
                found.append((side, joint, direction, step))
    offsets: dict[str, Array] = {}
    for side, covariances in (("q", noise.link), ("theta", noise.motor)):
        if covariances is not None:
            for rate in _RATES:
                offsets[rate + side] = np.zeros((1 + 2 * len(found), len(covariances)))
    for k, (side, joint, direction, step) in enumerate(found):
        for rate, part in zip(_RATES, direction, strict=True):
            offsets[rate + side][[1 + 2 * k, 2 + 2 * k], joint] = step * part, -step * part
    return np.array([step for *_, step in found]), offsets


def _moved(thin: Motion, offsets: dict[str, Array]) -> Motion:
    """Return the samples unchanged, and once for each step."""
    times = len(next(iter(offsets.values())))
    moved: dict[str, Any] = {}
    for name, values in thin.channels().items():
        copies = np.broadcast_to(values, (times, *values.shape))
        if name in offsets:
            copies = copies + offsets[name][:, None]
        moved[name] = copies.reshape(-1, *values.shape[1:])
    return Motion(**moved, lacking=thin.lacking)


def without_noise(whole: Array, noise: Array) -> Array:
    """Return rows (k, width) whose square is that of the rows `whole` (width, width) minus `noise`.

    At most :func:`correction_share` of `noise` is subtracted. With whole = U F and F' E F the
    noise, the square is F'(1 - E)F.
    """
    forward, inside = _among_rows(whole, noise)
    left = np.eye(len(inside)) - _share(inside) * inside
    return np.linalg.cholesky(left).T @ forward


def correction_share(whole: Array, noise: Array) -> float:
    """Return the share of the noise that may be subtracted from sums so that they remain positive.

    If the sums contain only noise in some direction, its scatter decides whether the difference is
    positive or negative there. As in Fuller's modified estimator (section 2.5 there), at most
    :data:`MOST_TAKEN_OFF` of the amount that would leave nothing is subtracted.
    """
    return _share(_among_rows(whole, noise)[1])


def _share(inside: Array) -> float:
    largest = float(np.linalg.eigvalsh(inside)[-1])
    return min(1.0, MOST_TAKEN_OFF / max(largest, 1e-300))


def _among_rows(whole: Array, noise: Array) -> tuple[Array, Array]:
    """Return F (k, width), with orthogonal rows and the square of `whole`, and E (k, k) such that
    F' E F is the noise."""
    size = np.linalg.norm(whole, axis=0)
    live = size > 0
    _, s, right = np.linalg.svd(whole[:, live] / size[live])
    s = np.maximum(s, SMALLEST * s[0])
    forward = np.zeros((len(s), len(size)))
    forward[:, live] = s[:, None] * right * size[live]
    back = right.T / s / size[live, None]
    return forward, back.T @ noise[np.ix_(live, live)] @ back


def covariance_left(
    noise: Array, whole: Array, Psi: Array, described: Array, samples: int
) -> Array:
    """Return the covariance (B + 1, B + 1) of the unknown part of the noise.

    It refers to the right side of the sums.
    """
    total = noise.sum(axis=0)
    level = noise @ np.append(-Psi, 1.0) / np.sqrt(WHITE_SHARE * samples)
    likely = np.where(np.abs(described) > np.abs(Psi), described, Psi)
    remaining = (1.0 - correction_share(whole, total)) * (total @ np.append(-likely, 1.0))
    return level.T @ level + np.outer(remaining, remaining)
