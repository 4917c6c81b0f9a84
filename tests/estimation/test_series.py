"""Fourier series fitted to a periodic motion: period, analytic derivatives, standard deviations of coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.resampling import Grid
from elastic_arm.estimation.series import FourierFit, find_period, fourier_motion

RATE, PERIOD = 250.0, 4.0
T = np.arange(int(5 * PERIOD * RATE)) / RATE
W = 2 * np.pi / PERIOD


def angles(derivative: int = 0) -> np.ndarray:
    """Three harmonics of one joint, or a derivative of them (N, 1)."""
    parts = [
        a * (k * W) ** derivative * np.sin(k * W * T + 0.3 * k + derivative * np.pi / 2)
        for k, a in ((1, 0.5), (2, 0.2), (5, 0.05))
    ]
    return np.sum(parts, axis=0)[:, None]


def grid(std: float, seed: int = 0) -> Grid:
    noise = std * np.random.default_rng(seed).standard_normal((len(T), 1))
    return Grid(T, RATE, theta=angles() + noise, tau_m=angles())


def test_the_period_is_found() -> None:
    """To a small part of a sample, under noise."""
    found = find_period(np.asarray(grid(1e-4).theta), RATE)
    assert found == pytest.approx(PERIOD, rel=1e-5)


def test_derivatives_are_analytic() -> None:
    """Without noise the accelerations of the series are those of the motion."""
    motion, _, series = fourier_motion(grid(1e-7), None, np.array([1e-7]), PERIOD)
    assert series is not None
    inside = np.searchsorted(T, motion.t)
    np.testing.assert_allclose(motion.dtheta, angles(1)[inside], atol=1e-5)
    np.testing.assert_allclose(motion.ddtheta, angles(2)[inside], atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_a_start_that_no_sample_shows_bends_no_series(seed: int) -> None:
    """A soft start that dies away into the encoders' noise is left out: angles are off by the noise of means alone.

    The period that its autocorrelation has is a few samples off, which hid the end of the start.
    """
    rng = np.random.default_rng(seed)
    start = -0.5 * np.exp(-T / 0.4)[:, None]
    sides = {name: angles() + start + 1e-4 * rng.standard_normal((len(T), 1)) for name in ("q", "theta")}
    motion, link, motor = fourier_motion(Grid(T, RATE, **sides, tau_m=angles()), *[np.array([1e-4])] * 2)
    assert link is not None and motor is not None and len(link.sine) == len(motor.sine)
    inside = np.searchsorted(T, motion.t)
    assert motion.theta is not None
    assert np.std(motion.theta - angles()[inside]) < 1.5e-5


def test_a_motion_that_does_not_repeat_has_no_period() -> None:
    """A chirp is refused."""
    with pytest.raises(IdentificationError):
        find_period(np.sin(0.3 * T**2)[:, None], RATE)


def test_covariance_of_a_series_state_is_that_of_its_coefficients() -> None:
    """At any time the variances of position, velocity and acceleration are what the coefficients' variances make."""
    rng = np.random.default_rng(0)
    sine, cosine = rng.standard_normal((2, 5, 2))
    fit = FourierFit(2.0, np.zeros(2), sine, cosine, np.array([0.1, 0.2]), samples=1000, velocity_weight=0.05)
    bases = np.stack(fit.bases(np.array([0.37])))[:, 0]
    for joint, found in enumerate(fit.state_covariances()):
        np.testing.assert_allclose(found, (bases * fit.variances()[:, joint]) @ bases.T, atol=1e-12)
