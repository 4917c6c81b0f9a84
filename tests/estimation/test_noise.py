"""The encoders' noise, estimated from a motion that is not known."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.estimation.noise import estimate_noise, wiener_filtered

RATE = 1000.0
T = np.arange(12_000) / RATE


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Two joints, angles and rates, up to 1.6 Hz."""
    w = 2 * np.pi * np.array([0.4, 0.9, 1.6])
    size = np.array([[0.5, 0.2, 0.1], [0.3, 0.3, 0.05]])
    phase = w * T[:, None]
    return np.sin(phase) @ size.T, (w * np.cos(phase)) @ size.T


@pytest.mark.parametrize("std", [1e-5, 1e-4])
def test_white_noise_of_positions_is_found(std: float) -> None:
    """Standard deviations come out within a few per cent, and the bandwidth above the motion's."""
    q, _ = motion()
    noise = std * np.random.default_rng(0).standard_normal(q.shape)
    found = estimate_noise(q + noise, None, RATE)
    np.testing.assert_allclose(found.position_std, std, rtol=0.1)
    np.testing.assert_allclose(found.white_position, std, rtol=0.1)
    assert found.velocity_std is None and found.cutoff > 2 * np.pi * 1.6


def test_both_channels_have_a_noise_of_their_own() -> None:
    """Position and velocity noise are told apart."""
    rng = np.random.default_rng(1)
    q, dq = motion()
    found = estimate_noise(q + 1e-4 * rng.standard_normal(q.shape), dq + 3e-3 * rng.standard_normal(dq.shape), RATE)
    np.testing.assert_allclose(found.position_std, 1e-4, rtol=0.1)
    assert found.velocity_std is not None
    np.testing.assert_allclose(found.velocity_std, 3e-3, rtol=0.1)


def test_a_regression_on_a_filtered_signal_is_not_biased_by_its_noise() -> None:
    """On a signal in as much noise a coefficient comes out half as large; on the filtered one it is right to 3 %."""
    rng, f = np.random.default_rng(2), np.linspace(0.0, 500.0, 200)
    signal = sum(np.sin(2 * np.pi * k * T + k * k) for k in np.linspace(1.0, 9.0, 17))
    noise = rng.standard_normal(len(T)) * np.std(signal)
    seen = signal + noise

    def coefficient(column: np.ndarray) -> float:
        return float(column @ signal / (column @ column))

    assert coefficient(seen) < 0.55
    filtered = wiener_filtered(seen, RATE, f, np.full(len(f), np.var(noise)))
    assert abs(coefficient(filtered) - 1.0) < 0.03
    np.testing.assert_allclose(
        wiener_filtered(signal, RATE, f, np.zeros(len(f)))[2000:-2000], signal[2000:-2000], atol=0.02
    )
