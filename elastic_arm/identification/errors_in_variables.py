"""What the encoders' noise does to a regressor, and so to the sums that a fit is made of.

Noise in positions and accelerations stands in Phi itself, not only in the equations' residuals: on the average it
adds to Phi'Phi and draws weak parameters toward zero (errors in variables; W. A. Fuller, Measurement Error Models,
1987). The smoother knows the covariance of what it lets through, so the average is known too and can be taken off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.identification.derivatives import Motion
from elastic_arm.identification.equations import Equations

Array = NDArray[np.float64]

# Motion changes little from one sample to the next: one sample speaks for so many.
EVERY = 256
# Steps of the differences, relative to the size of the channel; never below the noise itself.
STEP = 1e-3
_RATES = ("", "d", "dd")


def noise_sums(equations: Equations, motion: Motion) -> Array | None:
    """Return what the noise of `motion` adds on the average to [Phi y]'[Phi y] of all groups.

    Parameters
    ----------
    equations
        Whose rows are meant. Laws that were filtered with the motion are taken for exact.
    motion
        A run of samples.

    Returns
    -------
    (groups, B + 1, B + 1), or None where the motion is taken for exact.

    Notes
    -----
    To second order E[G(x + e)] - G(x) = 1/2 sum_jk C_jk d²G / dx_j dx_k, G = [Phi y]'[Phi y]; with directions v that
    make up C, 1/2 sum_v d²G/dv².
    """
    directions = _directions(motion)
    if not directions:
        return None
    count = -(-len(motion) // EVERY)
    middles = np.minimum(np.arange(count) * EVERY + EVERY // 2, len(motion) - 1)
    share = np.full(count, float(EVERY))
    share[-1] = len(motion) - (count - 1) * EVERY
    thin = motion[middles]
    moved = [thin]
    for step, changes in directions:
        moved += [_moved(thin, changes, step), _moved(thin, changes, -step)]
    rows = equations.rows(Motion.joined(moved))
    rows = rows.reshape(rows.shape[0], len(moved), count, rows.shape[-1])
    middle, ahead, behind = rows[:, :1], rows[:, 1::2], rows[:, 2::2]
    steps = np.array([step for step, _ in directions])[:, None, None]
    slope = ((ahead - behind) / (2.0 * steps) * np.sqrt(share)[:, None]).reshape(len(rows), -1, rows.shape[-1])
    bend = np.sum((ahead + behind - 2.0 * middle) / steps**2, axis=1) * share[:, None]
    curved = 0.5 * middle[:, 0].transpose(0, 2, 1) @ bend
    return np.asarray(slope.transpose(0, 2, 1) @ slope + curved + curved.transpose(0, 2, 1))


def _directions(motion: Motion) -> list[tuple[float, dict[tuple[str, int], float]]]:
    """Return step lengths and directions, (channel, joint) -> part, that make up the covariance of the states."""
    if motion.noise is None:
        return []
    found = []
    for side, covariances in (("q", motion.noise.link), ("theta", motion.noise.motor)):
        if covariances is None:
            continue
        sizes = np.stack([np.std(getattr(motion, rate + side), axis=0) for rate in _RATES], axis=1)
        for joint, covariance in enumerate(covariances):
            std = np.sqrt(np.diag(covariance))
            if not std.all():
                continue
            values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
            for direction in (vectors * np.sqrt(np.maximum(values, 0.0))).T * std:
                share = np.max(np.abs(direction) / np.maximum(sizes[joint], std))
                parts = {(rate + side, joint): float(part) for rate, part in zip(_RATES, direction, strict=True)}
                found.append((max(1.0, STEP / share), parts))
    return found


def _moved(motion: Motion, changes: dict[tuple[str, int], float], step: float) -> Motion:
    values = {channel: getattr(motion, channel).copy() for channel, _ in changes}
    for (channel, joint), part in changes.items():
        values[channel][:, joint] += step * part
    return replace(motion, **values)
