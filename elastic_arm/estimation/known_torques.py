"""The load of each joint, as well as model and encoders know it: what a torque channel's filter acts on.

A model predicts it from accelerations, of which the noise grows with the square of the frequency; the deflection of the
drive measures it with noise that is the same at all frequencies. Up to some 10 Hz the model knows it better, above the
deflection.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.effects.library.torque_filters import low_pass_error
from elastic_arm.estimation.motion import CompletedMotion, drive_constants
from elastic_arm.estimation.noise import reduced_to, wiener_filtered
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]

TINY = 1e-300  # numerical


def wound_under(torque: Array, t: Array, model: Model) -> Array:
    """Return the deflections (N, n) rad of springs and dampers that carry torques (N, n) Nm at times t (N,) s.

    The damper lets a deflection lag behind its torque by D / K. A law of the deflection that neglects it, as that of a
    nonlinear stiffness, would take a part of the damping with it.

    Parameters
    ----------
    torque
        (N, n) Nm.
    t
        (N,) s.
    model
        Its stiffness and damping are taken.
    """
    found = torque.copy()
    for j, (K, D) in enumerate(zip(*drive_constants(model), strict=True)):
        if K > 0.0 and D > 0.0:
            found[:, [j]] += low_pass_error(t, torque[:, [j]], K / (2.0 * np.pi * D))
    return found / drive_constants(model)[0]


def true_load(
    model: Model,
    observation: Observation,
    motion: CompletedMotion,
    load: Array,
    laws: Array,
    f: Array,
    noise: Array | None,
) -> Array:
    """Return the load (N, n) Nm of each joint with as little noise as both ways to know it allow.

    Parameters
    ----------
    model
        Of the arm.
    observation
        Holds the noise of the encoders.
    motion
        The quiet motion, its deflections without the noise that shows in their spectra.
    load
        (N, n) Nm, as the model predicts it.
    laws
        (N, n) Nm, what known laws of the drive carry beside the deflection as the encoders read it.
    f, noise
        (F,) Hz, and the noise (F, n) of that with angles of the finer encoder of each joint, Nm²; 1 is white noise of
        1 Nm a sample.
    """
    assert noise is not None
    K, D = drive_constants(model)
    gain = observation.quiet_gain(f)[:, None] ** 2
    link, motor = (observation.position_spectrum(side, f) * gain for side in ("link", "motor"))
    measured = K**2 * (link + motor)
    wound = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq) + laws
    # As far as the deflection shows, the link's angles have the noise of their own encoder, be the motor's the finer.
    predicted = noise * np.maximum(link / np.maximum(observation.quiet_link_spectrum(f), TINY), 1.0)
    both = (K > 0.0) & link.any(axis=0) & motor.any(axis=0)
    share = np.where(both, measured / np.maximum(measured + predicted, TINY), 1.0)
    left, found = np.where(both, share * predicted, noise), np.empty_like(load)
    for j in range(model.n):
        known = load[:, j]
        if both[j]:
            known = wound[:, j] + reduced_to(load[:, j] - wound[:, j], observation.rate, f, share[:, j])
        found[:, j] = wiener_filtered(known, observation.rate, f, left[:, j])
    return found
