"""Spectra of whitened columns without the ends of a stretch, from harmonics."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

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


def test_a_constant_column_has_no_spectrum() -> None:
    """The mean does not count, and the rounding that is left of a constant is no direction of its own."""
    harmonics, rate = Harmonics.of(301, 80, 5), 50.0
    constant = np.fft.rfft(np.ones(301))[:80] * harmonics.scale
    wave = np.fft.rfft(np.sin(np.arange(301)))[:80] * harmonics.scale
    columns = harmonics.coordinates(np.stack([constant, wave])).T
    noise = SimpleNamespace(whitener=lambda f: np.ones((len(f), 1, 1)))
    data = SimpleNamespace(
        layout=SimpleNamespace(rows=1, torque_coefficients={"tau_m": np.ones((1, 1))}),
        white=columns[:, 0],
        parts=[SimpleNamespace(noise=noise)],
        harmonics=[harmonics],
        band=SimpleNamespace(kept_rate=rate, cutoff=12.0),
    )
    prepared: Any = SimpleNamespace(library=SimpleNamespace(sets=[data]))
    (found,) = noise_colour._spectra(prepared, 0, [columns])
    assert not found.values[:, :, 0].any() and found.values[:, :, 1].all()
