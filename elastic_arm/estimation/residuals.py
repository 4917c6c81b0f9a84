"""Residuals of a recording: what the measured torques exceed the model by, three a joint.

Rows are ordered equation by equation: [link of all joints, drive of all joints, motor of all joints].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_opening

from elastic_arm.dynamics import Model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.motion import CompletedMotion, completed, drive_constants
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]

SLOWEST = 5e-4  # rad/s: slower than this a joint counts as standing, whatever the noise
SLOW = 0.005  # of a joint's highest speed, below which it sticks if it is as slow for as long as STICKING
STICKING = 0.03  # s
LEAST_MOVING = 0.5  # of a stretch, below which each equation is left out by itself
MOST_STICKING = 0.3  # of a stretch; a joint that sticks longer is one that stands still


def raw_residuals(model: Model, motion: CompletedMotion) -> Array:
    """Residuals (N, 3 n) Nm of completed motion at the recording's rate."""
    n = model.n
    if not model.robot.elastic:
        # A torque sensor at the joint does not feel the armature, which is in the motor's row.
        motor = armatures(model) * motion.ddq
        link = model.inverse_dynamics(motion.q, motion.dq, motion.ddq) - motor
        return np.hstack([motion.tau_J - link, np.zeros_like(link), motion.tau_m - motion.tau_J - motor])
    K, D = drive_constants(model)
    spring = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq)
    left = model.inverse_dynamics(*(motion.coordinates(rate) for rate in ("", "d", "dd")))
    # The left side of (1) holds the spring in both rows; the residuals have the sensor's torque in its place.
    link = motion.tau_J - (left[:, :n] + spring)
    motor = motion.tau_m - (left[:, n : 2 * n] - spring) - motion.tau_J
    return np.hstack([link, motion.tau_J - spring, motor])


def armatures(model: Model) -> Array:
    """Return the armatures (n,) kg m² of an arm without transmissions; zero where its description states none."""
    found = np.zeros(model.n)
    for spin in model.bodies.spins:
        found[spin.gears[0][0]] += model.Psi[spin.parameter]
    return found


def predicted_torques(model: Model, motion: CompletedMotion) -> tuple[Array, Array]:
    """Return the joint torque and the motor torque (N, n) that the model predicts for a motion, Nm."""
    n, raw = model.n, raw_residuals(model, motion)
    load = motion.tau_J - raw[:, :n]
    return load, motion.tau_m - motion.tau_J - raw[:, 2 * n :] + load


@dataclass(frozen=True)
class Stretch:
    """Residuals of one stretch without holes, in the band, at the kept rate.

    Parameters
    ----------
    t
        (N',) s.
    values
        (N', R) Nm.
    motion
        The completed motion at the recording's rate that they were made of.
    quiet
        The same motion, smoothed further, for the columns of effects.
    kept
        Which of the rows that the band gives for the motion they are.
    """

    t: Array
    values: Array
    motion: CompletedMotion
    quiet: CompletedMotion
    kept: slice


def residuals(model: Model, observation: Observation, equations: EquationSet, band: Band) -> list[Stretch]:
    """Return the residuals of every stretch of a recording.

    Parameters
    ----------
    model
        The nominal model.
    observation
        The recording, smoothed.
    equations
        Usable equations, R rows.
    band
        In which the residuals are looked at.
    """
    stretches = []
    for piece, calm in zip(observation.pieces, observation.quiet, strict=True):
        motion, quiet = completed(piece, model), completed(calm, model)
        full = raw_residuals(model, motion) @ equations.transform.T
        t = band.times(motion.t)
        first, last = np.searchsorted(t, [motion.t[0] + observation.margin, motion.t[-1] - observation.margin])
        kept = slice(int(first), int(last))
        stretches.append(Stretch(t[kept], band.apply(full)[kept], motion, quiet, kept))
    return [s for s in stretches if len(s.t) > band.kept_rate]


def moving_rows(stretch: Stretch, band: Band, layout: EquationSet) -> Array:
    """Return weights of a stretch's rows: 0 where a joint sticks, as its friction takes any value there, else 1.

    One weight an instant (N',), for all equations. Where that would leave little, one an equation (N', R): a joint that
    sticks leaves out those equations that hold its motor's friction. A joint that hardly moves in the whole stretch
    does not count.

    Parameters
    ----------
    stretch
        Of residuals.
    band
        Its filter carries what sticks over to rows around.
    layout
        The usable equations.
    """
    t, speed = stretch.quiet.t, np.abs(stretch.quiet.dtheta)
    slow = speed < np.maximum(SLOW * speed.max(axis=0), 2.0 * SLOWEST)
    step = float(t[1] - t[0])
    sticks = np.stack([binary_opening(column, np.ones(max(1, round(STICKING / step)))) for column in slow.T], axis=1)
    sticks &= sticks.mean(axis=0) < MOST_STICKING
    around = round((0.5 * len(band.taps) / band.rate + STICKING) / step)
    at = np.clip(np.searchsorted(t, stretch.t), 0, len(t) - 1)

    def spread(stuck: NDArray[np.bool_]) -> Array:
        return np.asarray(1.0 - (binary_dilation(stuck, iterations=around) if stuck.any() else stuck)[at])

    together = spread(np.asarray(sticks.any(axis=1)))
    if together.mean() >= LEAST_MOVING:
        return together
    rubs = [equation.combination[2] != 0 for equation, _ in layout.entries]
    own = [spread(sticks[:, joint] & holds) for holds, (_, joint) in zip(rubs, layout.entries, strict=True)]
    return np.stack(own, axis=1)
