"""The load of each joint, as well as model and encoders know it: what a torque channel's filter acts on.

A model predicts it from accelerations, of which the noise grows with the square of the frequency; the deflection of the
drive measures it with noise that is the same at all frequencies. Up to some 10 Hz the model knows it better, above the
deflection.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.estimation.motion import CompletedMotion, drive_constants
from elastic_arm.estimation.noise import reduced_to, wiener_filtered
from elastic_arm.estimation.observation import Observation

Array = NDArray[np.float64]


class LoadNoise(Protocol):
    """Noise of the load that a model predicts."""

    f: Array
    rate: float
    load: Array | None


def true_load(model: Model, observation: Observation, motion: CompletedMotion, load: Array, noise: LoadNoise) -> Array:
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
    noise
        Of that.
    """
    assert noise.load is not None
    f, (K, D) = noise.f, drive_constants(model)
    link, motor = (observation.position_spectrum(side, f) for side in ("link", "motor"))
    wound = K * (motion.theta - motion.q) + D * (motion.dtheta - motion.dq)
    measured = K**2 * (link + motor) * observation.quiet_gain(f)[:, None] ** 2
    # As far as the deflection shows, the link's angles have the noise of their own encoder, be the motor's finer or not.
    finer = np.maximum(observation.quiet_link_spectrum(f), 1e-300)
    predicted = noise.load * np.maximum(link * observation.quiet_gain(f)[:, None] ** 2 / finer, 1.0)
    found = np.empty_like(load)
    for j in range(model.n):
        if not (K[j] and link[:, j].any() and motor[:, j].any()):
            found[:, j] = wiener_filtered(load[:, j], noise.rate, f, noise.load[:, j])
            continue
        share = measured[:, j] / np.maximum(measured[:, j] + predicted[:, j], 1e-300)
        found[:, j] = wound[:, j] + reduced_to(load[:, j] - wound[:, j], noise.rate, f, share)
    return found
