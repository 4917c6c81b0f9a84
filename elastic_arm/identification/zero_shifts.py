"""Zeros of link encoders that differ between recordings: after a restart an encoder may count from elsewhere.

An offset that all recordings share is a column of the regression. What differs between them is taken off beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion

Array = NDArray[np.float64]

# A shift counts from so many standard deviations, and from so many radians.
CERTAIN = 6.0
SMALLEST = 1e-5
# Independent samples of a recording, at the least: what the regression leaves is coloured.
INDEPENDENT = 100


def zeros(motions: Sequence[Motion], model: Model) -> tuple[Array, Array]:
    """Return the deflection at no load and no speed, and its standard deviation, (n,) rad each.

    Parameters
    ----------
    motions
        Runs of one recording, with both encoders.
    model
        The nominal arm: its torques are the load, up to a factor of each joint.
    """
    values, stds = np.zeros(model.n), np.zeros(model.n)
    runs = [_regressors(motion, model) for motion in motions]
    deflection, speed, load = (np.vstack(parts) for parts in zip(*runs, strict=True))
    for joint in range(model.n):
        columns = np.column_stack([np.ones(len(load)), speed[:, joint], load[:, joint]])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        solved = np.linalg.lstsq(columns / scale, deflection[:, joint], rcond=None)[0]
        left = deflection[:, joint] - columns / scale @ solved
        information = np.linalg.pinv((columns / scale).T @ (columns / scale))
        crowding = max(len(left) / INDEPENDENT, 1.0)
        values[joint] = solved[0] / scale[0]
        stds[joint] = np.sqrt(information[0, 0] * np.mean(left**2) * crowding) / scale[0]
    return values, stds


def shifts(found: tuple[Array, Array], first: tuple[Array, Array]) -> Array:
    """Return what to add to the link angles (n,) rad so that their zeros are those of the first recording.

    Parameters
    ----------
    found, first
        Zeros of this and of the first recording, from :func:`zeros`.
    """
    apart = found[0] - first[0]
    certain = np.abs(apart) > np.maximum(CERTAIN * np.hypot(found[1], first[1]), SMALLEST)
    return np.where(certain, apart, 0.0)


def shifted(motion: Motion, by: Array) -> Motion:
    """Return the motion with link angles moved by `by` (n,) rad."""
    return motion if motion.q is None or not by.any() else replace(motion, q=motion.q + by)


def _regressors(motion: Motion, model: Model) -> tuple[Array, Array, Array]:
    """Return deflection, speed and the nominal torque of the springs, (N, n) each: rad, rad/s, Nm."""
    if motion.q is None or motion.dq is None or motion.ddq is None or motion.theta is None:
        raise IdentificationError("one of the two encoders was not recorded", "Record both sides.")
    # Without a deflection the springs' own torque is none, and what is left of the link's row is the load.
    x, dx, ddx = (np.hstack([v, v]) for v in (motion.q, motion.dq, motion.ddq))
    return motion.theta - motion.q, motion.dq, model.inverse_dynamics(x, dx, ddx)[:, : model.n]
