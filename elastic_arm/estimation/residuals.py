"""Residuals of a recording: what the measured torques exceed the model by, three a joint.

Rows are ordered equation by equation: [link of all joints, drive of all joints, motor of all joints].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.motion import CompletedMotion, completed, drive_constants
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]


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
