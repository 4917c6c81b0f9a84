"""The encoders' noise, estimated from a motion that is not known."""

import numpy as np
import pytest
import scipy

from elastic_arm.estimation.noise import Telegraph, estimate_noise, noise_filter, wiener_filter

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
    found = estimate_noise(
        q + 1e-4 * rng.standard_normal(q.shape), dq + 3e-3 * rng.standard_normal(dq.shape), RATE
    )
    np.testing.assert_allclose(found.position_std, 1e-4, rtol=0.1)
    assert found.velocity_std is not None
    np.testing.assert_allclose(found.velocity_std, 3e-3, rtol=0.1)


def test_a_regression_on_a_filtered_signal_is_not_biased_by_its_noise() -> None:
    """On a signal in as much noise a coefficient comes out half as large; on the filtered one it is
    right to 3 %."""
    rng, f = np.random.default_rng(2), np.linspace(0.0, 500.0, 200)
    signal = sum(np.sin(2 * np.pi * k * T + k * k) for k in np.linspace(1.0, 9.0, 17))
    noise = rng.standard_normal(len(T)) * np.std(signal)
    seen = signal + noise

    def coefficient(column: np.ndarray) -> float:
        return float(column @ signal / (column @ column))

    assert coefficient(seen) < 0.55
    filtered = wiener_filter(seen, RATE, f, np.full(len(f), np.var(noise)))(0.0)
    assert abs(coefficient(filtered) - 1.0) < 0.03
    np.testing.assert_allclose(
        wiener_filter(signal, RATE, f, np.zeros(len(f)))(0.0)[2000:-2000],
        signal[2000:-2000],
        atol=0.02,
    )


@pytest.mark.parametrize("stated", [1.0, 0.9])
def test_noise_above_the_signal_is_taken_off_whatever_its_chance_peaks(stated: float) -> None:
    """Ten seconds of a slow deflection in the noise of its encoders, which is stated 10 % too small
    besides."""
    rate, std = 1000.0, 3.5e-6
    t = np.arange(0.0, 10.0, 1.0 / rate)
    f = np.linspace(0.0, 55.0, 50)
    slow = 1e-4 * np.sin(2 * np.pi * 0.7 * t) + 3e-5 * np.sin(2 * np.pi * 5.0 * t)
    for seed in range(20):
        values = slow + std * np.random.default_rng(seed).standard_normal(len(t))
        left = noise_filter(values, rate, f, np.full(len(f), (stated * std) ** 2))(values)
        at, power = scipy.signal.welch(left, rate, nperseg=1024)
        above = (at > 10.0) & (at < 50.0)
        assert power[above].mean() < 0.02 * 2.0 * std**2 / rate, seed


def test_a_signal_up_to_the_highest_frequency_is_left_as_it_is() -> None:
    """Where the deflection outweighs its noise up to the highest frequency, nothing is taken
    off."""
    rate, std = 1000.0, 3.5e-6
    values = 10.0 * std * np.random.default_rng(1).standard_normal(10_000)
    f = np.linspace(0.0, 55.0, 50)
    np.testing.assert_array_equal(
        noise_filter(values, rate, f, np.full(len(f), std**2))(values), values
    )


def test_an_encoder_that_stands_half_of_the_time_has_slow_noise_beside_the_white_one() -> None:
    """From point to point with dwells, rounded to steps in which a slow structure rings: between 10
    and 40 Hz the noise is more than twice the white one in the mean square, and comes out within 40
    %."""
    rng, step = np.random.default_rng(3), 1.2e-5
    goals = np.repeat(rng.uniform(-0.5, 0.5, (13, 2)), 1500, axis=0)[: len(T) + 4000]
    angle = scipy.ndimage.gaussian_filter1d(goals, 150.0, axis=0)[2000 : 2000 + len(T)]
    ringing = scipy.signal.lfilter(
        [1.0], scipy.signal.iirpeak(6.0, 3.0, RATE)[1], rng.standard_normal(angle.shape), axis=0
    )
    angle = angle + 0.5 * step * ringing / ringing.std(axis=0)
    read = np.round(angle / step) * step
    side = estimate_noise(read, None, RATE)
    f, power = scipy.signal.welch(read - angle, RATE, "hann", 2000, axis=0)
    inside = (f > 10.0) & (f < 40.0)
    found = Telegraph.of(read, np.full(2, step), side, RATE).power(f[inside]) * side.position_std**2
    true = power[inside].mean(axis=0) * RATE / 2.0
    assert (true > 2.0 * step**2 / 12.0).all()
    np.testing.assert_allclose(found.mean(axis=0), true, rtol=0.4)


def test_an_encoder_that_hardly_stands_has_the_noise_of_its_rounding() -> None:
    """A servo at 50 Hz with 12 bits, whose friction makes harmonics of the motion up to the noise:
    below 8 Hz the noise comes out within a factor of two."""
    rng = np.random.default_rng(5)
    rate = 50.0
    step = 2.0 * np.pi / 4096
    t = np.arange(2000) / rate
    phases = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    f = np.array([0.11, 0.23, 0.37, 0.53, 0.71, 0.97])
    waves = np.sin(2.0 * np.pi * f[:, None] * t + phases[..., None].transpose(1, 0, 2))
    angle = 0.12 * waves.sum(axis=1).T
    # Friction jumps where a joint reverses: a spectrum that falls by f^-3.
    jumps = np.sign(np.gradient(angle, 1.0 / rate, axis=0))
    angle = angle - 0.02 * scipy.signal.lfilter([0.1], [1.0, -0.9], jumps, axis=0)
    read = np.round(angle / step) * step
    side = estimate_noise(read, None, rate)
    f = np.linspace(1.0, 8.0, 15)
    found = Telegraph.of(read, np.full(3, step), side, rate).power(f) * side.position_std**2
    ratio = found.mean(axis=0) / (step**2 / 12.0)
    assert (ratio > 0.5).all()
    assert (ratio < 2.0).all()


def test_a_joint_that_never_moves_has_noise_that_is_finite() -> None:
    """Its encoder reads zero in all samples: nothing of what is estimated is infinite."""
    still = np.stack([motion()[0][:, 0], np.zeros(len(T))], axis=1)
    side = estimate_noise(still, None, RATE)
    assert np.isfinite([side.position_std, *side.slow]).all()
