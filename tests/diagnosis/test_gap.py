"""How large a gap is and how far it shrinks, on signals made up."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.gap import Gap, shrink

RATE, COUNT, CUTOFF = 100.0, 4000, 40.0
T = np.arange(COUNT) / RATE
NOISE = 0.1  # Nm, of white noise up to half the rate


def measured(*residuals: np.ndarray) -> Gap:
    """Return the gap of residuals (N,), one a row, whose sensors have white noise."""
    rows, f = len(residuals), np.linspace(0.0, RATE / 2, 50)
    pure = SimpleNamespace(
        f=f, covariance=np.tile(NOISE**2 * np.eye(rows), (len(f), 1, 1)), rate=RATE
    )
    band = SimpleNamespace(cutoff=CUTOFF, kept_rate=RATE)
    whole, parts = (
        [np.ones((len(residuals[0]), rows))],
        [SimpleNamespace(stretch=SimpleNamespace(band=band))],
    )
    more = {"band": band, "parts": parts, "seconds": len(residuals[0]) / RATE}
    data: Any = SimpleNamespace(
        layout=SimpleNamespace(rows=rows), pure=[pure], shares=lambda: whole, **more
    )
    return Gap.of(data, [np.stack(residuals, axis=1)])


def white(seed: int) -> np.ndarray:
    from elastic_arm.estimation.band import LowPass

    spectrum = np.fft.rfft(NOISE * np.random.default_rng(seed).standard_normal(COUNT))
    return np.fft.irfft(
        spectrum * LowPass(CUTOFF, RATE).gain(np.fft.rfftfreq(COUNT, 1.0 / RATE)), COUNT
    )


def test_noise_of_the_sensors_is_no_gap() -> None:
    """Of a hundred residuals of noise alone none has an octave beyond it, and there is nothing to
    shrink."""
    for seed in range(100):
        gap = measured(white(seed))
        assert not gap.significant.any()
    found = shrink(gap, gap)
    assert found.share is None and found.interval is None and np.isnan(found.by_row).all()


def test_powers_are_those_of_the_signal() -> None:
    """Over all octaves, power and noise are the mean squares of residual and sensors; rmse and peak
    are its own."""
    sine = 2.0 * np.sin(2 * np.pi * 3.0 * T)
    gap = measured(sine + white(1))
    assert gap.power.sum() == pytest.approx(2.0 + np.mean(white(1) ** 2), rel=0.02)
    assert gap.noise.sum() == pytest.approx(np.mean(white(1) ** 2), rel=0.1)
    assert gap.rmse[0] == pytest.approx(np.sqrt(np.mean((sine + white(1)) ** 2)))
    assert gap.peak[0] == np.abs(sine + white(1)).max()


def test_a_slow_effect_below_the_noise_of_the_band_is_plain_in_its_octave() -> None:
    """A third of the noise's size, at 0.3 Hz."""
    gap = measured(white(2) + NOISE / 3.0 * np.sin(2 * np.pi * 0.3 * T))
    assert gap.significant[0, 0] and not gap.significant[0, 2:].any()


def test_shrink_is_the_share_of_power_over_noise_that_is_gone() -> None:
    """Half the amplitude is three quarters of the power; rows count by their power; the interval
    holds the share."""
    sine, slow = 2.0 * np.sin(2 * np.pi * 3.0 * T), 1.0 * np.sin(2 * np.pi * 0.7 * T)
    before = measured(sine + white(3), slow + white(4), white(5))
    found = shrink(before, measured(sine / 2 + white(3), slow + white(4), white(5)))
    assert found.share == pytest.approx(1.5 / 2.5, abs=0.01)
    assert found.by_row[:2] == pytest.approx([0.75, 0.0], abs=0.01) and np.isnan(found.by_row[2])
    assert found.interval is not None and found.interval[0] < 0.6 < found.interval[1]
    all_gone = shrink(before, measured(white(3), white(4), white(5)))
    assert all_gone.share == pytest.approx(1.0, abs=0.01) and all_gone.interval is not None
    assert all_gone.interval[1] <= 1.0
