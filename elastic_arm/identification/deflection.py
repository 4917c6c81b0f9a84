"""Fits in which the deflection of the drives is a measured quantity: two encoders, motor torque, no
torque sensor.

    r = tau_l - K d - D d' + a q' + b,    minimised: r / K

The link's row r is zero for no mass and no spring at all; as an equation for what was measured, the
deflection d, it is r / K, which no small parameters make small. It is bilinear in 1 / K and the
other parameters; Gauss-Newton from the description solves it (J. Nocedal and S. Wright, Numerical
Optimization, 2006, ch. 10). Rows of its linearisation are combinations of the columns of the row,
so the sums of the recording are all that it takes.

Zeros of link encoders may differ between recordings: an offset that all share is a column of the
regression, and what differs is taken off beforehand.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.dynamics import Model
from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.motion import Motion
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Blocks, Fit, Prior, condition, fit

MOST_STEPS = 40
# Parameters that change by less than this share of their standard deviation, or of themselves,
# stand.
SETTLED = 1e-3
# A step changes a stiffness by no more than this factor.
LONGEST_STEP = 3.0
# A spring whose deviation exceeds this share of it, or that no spring can have, stays with the
# description.
UNKNOWN = 0.5

# A shift counts from so many standard deviations, and from so many radians.
CERTAIN = 6.0
SMALLEST = 1e-5
# Independent samples of a recording, at the least: what the regression leaves is coloured.
INDEPENDENT = 100


class Deflections:
    """The link rows of summed regressions as equations for deflections."""

    def __init__(self, equations: BaseRegression) -> None:
        # groups of the link's rows: the joints whose deflection both encoders show
        self.rows = equations.wound
        # (k,) places of their K and D among the base parameters
        self.stiffness, self.damping = np.array(equations.drive_columns, dtype=np.intp).T
        self.nominal = equations.described

    def transform(self, Psi: Array, fixed: Mapping[int, float], groups: int) -> Array:
        """Return the map (groups, B + 1, B + 1) from rows [Phi y] to the problem linearised at
        `Psi`."""
        width = len(Psi) + 1
        found = np.broadcast_to(np.eye(width), (groups, width, width)).copy()
        for row, k in zip(self.rows, self.stiffness, strict=True):
            share = self.nominal[k] / Psi[k]
            torque = np.append(-Psi, 1.0)
            torque[k] = 0.0
            # r = share (y - Phi Psi): its derivative by K, and what is left at Psi plus the
            # derivatives times Psi.
            found[row] *= share
            found[row][:, -1] += share * torque
            found[row][k, -1] -= share * Psi[k]
            found[row][:, k] = share / Psi[k] * torque
        for place, value in fixed.items():
            found[:, :, -1] -= value * found[:, :, place]
            found[:, :, place] = 0.0
        return found

    def stepped(self, Psi: Array, solved: Array) -> Array:
        """Return the next point; the step is exact in 1 / K, in which rows are linear."""
        new = solved.copy()
        K = Psi[self.stiffness]
        softening = np.clip(2.0 - solved[self.stiffness] / K, 1.0 / LONGEST_STEP, LONGEST_STEP)
        new[self.stiffness] = K / softening
        return new

    def unknown(self, found: Fit) -> list[int]:
        """Return the springs that are not determined, or that have impossible values."""
        places = [*self.stiffness.tolist(), *self.damping.tolist()]
        Psi = found.Psi
        std = found.std
        return [
            k
            for k in places
            if not (Psi[k] > 0 and std[k] < UNKNOWN * max(Psi[k], self.nominal[k]))
        ]


def fit_deflections(blocks: Blocks, rows: Deflections, prior: Prior | None = None) -> Fit:
    """Solve the accumulated problem with deflections as measured quantities.

    A damping or stiffness that the recording does not determine, or that is estimated as negative,
    keeps the described value, with an infinite standard deviation.
    """
    fixed: dict[int, float] = {}
    found = _settled(blocks, rows, fixed, prior)
    # What is least known goes first: without it the others may be known, or lose what seemed to
    # determine them.
    while unknown := [k for k in rows.unknown(found) if k not in fixed]:
        first = [k for k in unknown if k in rows.damping] or unknown
        fixed |= {k: float(rows.nominal[k]) for k in first}
        found = _settled(blocks, rows, fixed, prior)
    return found


def _settled(
    blocks: Blocks, rows: Deflections, fixed: Mapping[int, float], prior: Prior | None
) -> Fit:
    """Return the fit at which the Gauss-Newton iteration has converged."""
    Psi = rows.nominal.copy()
    for _ in range(MOST_STEPS):
        linear = fit(blocks.transformed(rows.transform(Psi, fixed, blocks.groups)), prior=prior)
        solved = linear.Psi.copy()
        solved[list(fixed)] = list(fixed.values())
        new = rows.stepped(Psi, solved)
        size = np.minimum(np.sqrt(np.diag(linear.covariance)), np.abs(new))
        done = np.all(np.abs(new - Psi) <= SETTLED * size + 1e-12 * np.abs(new))
        Psi = new
        if done:
            break
    estimated = np.setdiff1d(np.arange(len(Psi)), list(fixed))
    open_still = linear.undetermined[
        ~np.any(np.abs(linear.undetermined[:, list(fixed)]) > 0.5, axis=1)
    ]
    return replace(
        linear,
        Psi=Psi,
        fixed=tuple(sorted(fixed)),
        condition=condition(linear.factor[:, estimated]),
        undetermined=open_still,
    )


def zeros(motions: Sequence[Motion], model: Model) -> tuple[Array, Array]:
    """Return the deflection at zero load and speed, and its standard deviation, (n,) rad each."""
    values = np.zeros(model.n)
    stds = np.zeros(model.n)
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
    """Return the correction of the link angles (n,) rad that gives them the zeros of the first
    recording."""
    apart = found[0] - first[0]
    certain = np.abs(apart) > np.maximum(CERTAIN * np.hypot(found[1], first[1]), SMALLEST)
    return np.where(certain, apart, 0.0)


def _regressors(motion: Motion, model: Model) -> tuple[Array, Array, Array]:
    """Return deflection, speed and the nominal torque of the springs, (N, n) each: rad, rad/s,
    Nm."""
    if motion.q is None or motion.dq is None or motion.ddq is None or motion.theta is None:
        raise IdentificationError("one of the two encoders was not recorded", "Record both sides.")
    # Without a deflection the springs' own torque is none, and what is left of the link's row is
    # the load.
    x = np.hstack([motion.q, motion.q])
    dx = np.hstack([motion.dq, motion.dq])
    ddx = np.hstack([motion.ddq, motion.ddq])
    return motion.theta - motion.q, motion.dq, model.inverse_dynamics(x, dx, ddx)[:, : model.n]
