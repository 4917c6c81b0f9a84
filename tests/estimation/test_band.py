"""One zero-phase low pass for every term: what lies in the band stays, what lies above goes, and
instants are kept."""

import numpy as np
import pytest

from elastic_arm.estimation.band import Band, LowPass

RATE = 500.0
T = np.arange(4000) / RATE


def wave(f: float) -> np.ndarray:
    return np.sin(2 * np.pi * f * T)[:, None]


@pytest.mark.parametrize("f", [1.0, 10.0, 19.0])
def test_a_motion_in_the_band_passes_without_delay(f: float) -> None:
    """Thinned samples are those of the wave at the instants that the band keeps."""
    band = Band(20.0, RATE)
    kept = band.apply(wave(f))[:, 0]
    np.testing.assert_allclose(kept, np.sin(2 * np.pi * f * band.times(T)), atol=2e-3)


def test_what_lies_above_the_band_does_not_fold_into_it() -> None:
    """From twice the cutoff on 70 dB are taken off."""
    band = Band(20.0, RATE)
    assert band.step > 1 and band.kept_rate == RATE / band.step
    assert np.abs(band.apply(wave(45.0))).max() < 10 ** (-69 / 20)


def test_the_gain_is_the_response() -> None:
    """What `gain` states is what `apply` does, for both filters."""
    for low_pass in (Band(20.0, RATE), LowPass(20.0, RATE)):
        f = 22.0
        measured = np.std(low_pass.apply(wave(f))) / np.std(wave(f))
        assert measured == pytest.approx(abs(low_pass.gain(np.array([f]))[0]), abs=5e-3)


def test_too_short_a_stretch_gives_no_rows() -> None:
    """A stretch shorter than the filter has no sample whose neighbours are all known."""
    assert len(Band(20.0, RATE).apply(np.ones((10, 2)))) == 0


@pytest.mark.parametrize(
    ("cutoff", "rate"), [(1.7, 200.0), (3.0, 200.0), (20.0, 1000.0), (40.0, 100.0), (40.0, 250.0)]
)
def test_rows_are_those_of_the_plain_convolution(cutoff: float, rate: float) -> None:
    """By products of matrices and by spectra, narrow and wide bands give what the taps give, to
    rounding."""
    band, values = (
        Band(cutoff, rate),
        np.cumsum(np.random.default_rng(0).standard_normal((2011, 9)), axis=0),
    )
    kept = band.apply(values)
    first = -(-(len(band.taps) - 1) // band.step) * band.step
    plain = np.stack(
        [np.convolve(column, band.taps)[first : len(column) : band.step] for column in values.T],
        axis=1,
    )
    assert kept.shape == plain.shape == (len(band.times(np.arange(len(values)) / rate)), 9)
    assert np.abs(kept - plain).max() < 1e-13 * np.abs(values).max()
