"""The load of a joint, as well as model and encoders know it."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.known_torques import KnownTorques, true_load
from elastic_arm.estimation.motion import drive_constants
from elastic_arm.robot import load_robot

RATE, STD, INERTIA = 1000.0, 1e-6, 30.0  # Hz, rad of either encoder, kg m²


def test_the_load_is_known_better_than_by_model_or_deflection_alone() -> None:
    """Slowly the model knows it, and fast the deflection: with both, each band is about as quiet as
    the better."""
    model, rng = build_model(load_robot(None), "mod3"), np.random.default_rng(3)
    K, _ = drive_constants(model)
    t = np.arange(20000) / RATE
    true = np.outer(100 * np.sin(2 * np.pi * t) + 10 * np.sin(2 * np.pi * 15 * t), np.ones(model.n))
    link, motor = STD * rng.standard_normal((2, *true.shape))
    f, w = np.fft.rfftfreq(len(t), 1 / RATE), 2 * np.pi * np.fft.rfftfreq(len(t), 1 / RATE)
    inertial = np.fft.irfft(
        (INERTIA * w**2 * (f < 40.0))[:, None] * np.fft.rfft(link, axis=0), len(t), axis=0
    )
    zeros = np.zeros_like(true)
    motion: Any = SimpleNamespace(theta=true / K + motor, q=link, dtheta=zeros, dq=zeros)
    spectrum = lambda f: np.full((len(f), model.n), STD**2)  # noqa: E731
    observation: Any = SimpleNamespace(
        rate=RATE,
        quiet_gain=np.ones_like,
        position_spectrum=lambda _, f: spectrum(f),
        quiet_link_spectrum=spectrum,
    )
    at = np.linspace(0.0, 40.0, 400)
    noise = (INERTIA * (2 * np.pi * at) ** 2 * STD)[:, None] ** 2 * np.ones(model.n)
    signals: Any = None
    known = KnownTorques(motion, signals, true + inertial, zeros, zeros)
    found, clear = true_load(model, observation, known, at, noise)

    def left(load: np.ndarray) -> np.ndarray:
        power = np.abs(np.fft.rfft((load - true)[2000:-2000], axis=0)) ** 2
        at = np.fft.rfftfreq(len(true) - 4000, 1 / RATE)
        return np.array([power[at < 4.0].sum(axis=0), power[(at > 12.0) & (at < 18.0)].sum(axis=0)])

    by_model, by_deflection = left(true + inertial), left(K * (motion.theta - motion.q))
    assert np.all(left(found) < 1.2 * np.minimum(by_model, by_deflection))
    assert np.all(left(found)[0] < 0.1 * by_deflection[0]) and np.all(
        left(found)[1, :2] < 0.9 * by_model[1, :2]
    )

    def above(load: np.ndarray) -> np.ndarray:
        power = np.abs(np.fft.rfft(load[2000:-2000], axis=0)) ** 2
        return np.asarray(power[np.fft.rfftfreq(len(load) - 4000, 1 / RATE) > 20.0].sum(axis=0))

    # Beyond the motion there is only noise, and next to nothing of it passes.
    assert np.all(above(found) < 0.02 * above(true + inertial))
    assert np.all(above(clear) <= above(found))
