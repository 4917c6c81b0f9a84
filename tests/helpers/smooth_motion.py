"""A motion with known derivatives and with the torques that a model gives it, noise-free."""

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.estimation.motion import Motion, drive_constants

Array = NDArray[np.float64]


def smooth_motion(model: Model, samples: int = 500, period: float = 2e-3, seed: int = 0) -> Motion:
    """Sums of three sines on q and theta (they move independently of each other); tau_J, tau_m by
    the model."""
    rng = np.random.default_rng(seed)
    t = period * np.arange(samples)
    q, theta = _sines(rng, t, model.n, 1.0), _sines(rng, t, model.n, 1e-3)
    theta = [a + b for a, b in zip(q, theta, strict=True)]
    n = model.n
    left = model.inverse_dynamics(*(np.hstack(pair) for pair in zip(q, theta, strict=True)))
    K, D = drive_constants(model)
    tau_J = K * (theta[0] - q[0]) + D * (theta[1] - q[1])
    return Motion(t, *q, *theta, tau_J, left[:, n : 2 * n])


def _sines(rng: np.random.Generator, t: Array, n: int, size: float) -> list[Array]:
    w = rng.uniform(1.0, 6.0, (3, n))
    a, phase = size * rng.uniform(0.2, 0.5, (3, n)), rng.uniform(0, 2 * np.pi, (3, n))
    angle = w * t[:, None, None] + phase
    return [
        np.sum(a * np.sin(angle), axis=1),
        np.sum(a * w * np.cos(angle), axis=1),
        np.sum(-a * w**2 * np.sin(angle), axis=1),
    ]
