"""Spectra of whitened columns without the ends of a stretch, from harmonics."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis.noise import colour as noise_colour
from elastic_arm.estimation.convolution import Harmonics


def test_long_stretches_have_the_spectra_of_short_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """By transforms of the columns, and by the spectra of single harmonics."""
    harmonics, rate, cutoff = Harmonics.of(301, 80, 5), 50.0, 12.0
    coordinates = np.random.default_rng(0).standard_normal((4, harmonics.size))
    f, transform = noise_colour._transform(harmonics, rate, cutoff)
    monkeypatch.setattr(noise_colour, "LONG", 0)
    same, direct = noise_colour._transform(harmonics, rate, cutoff)
    np.testing.assert_array_equal(f, same)
    assert f[0] > 0.0 and f[-1] <= cutoff
    np.testing.assert_allclose(transform(coordinates), direct(coordinates), atol=1e-12)
    signals = harmonics.signals(coordinates)
    whole = np.fft.rfft(signals, axis=1) / np.sqrt(signals.shape[1])
    kept = np.searchsorted(np.fft.rfftfreq(signals.shape[1], 1.0 / rate), f)
    np.testing.assert_allclose(direct(coordinates), whole[:, kept], atol=1e-12)
