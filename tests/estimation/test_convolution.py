"""Convolution agrees with NumPy's, whatever the lengths and the thinning."""

import numpy as np
import pytest

from elastic_arm.estimation.convolution import FEW, circular_gains, convolve, filtered_circularly


@pytest.mark.parametrize(
    "samples, taps", [(60, 11), (60, 60), (5000, 101), (5003, 96), (40_000, 301)]
)
@pytest.mark.parametrize("every", [1, 2, 8])
def test_it_is_the_sum_of_plain_convolutions(samples: int, taps: int, every: int) -> None:
    """Two signals of three columns through two outputs' responses, added up, without the ends, one
    of `every`."""
    rng = np.random.default_rng(0)
    signals = list(rng.standard_normal((2, samples, 3)))
    responses = rng.standard_normal((2, 2, taps))
    expected = [
        [
            sum(np.convolve(s, r, "valid") for s, r in zip(column, own, strict=True))[::every]
            for own in responses
        ]
        for column in np.transpose(signals, (2, 0, 1))
    ]
    found = convolve(signals, responses, every)
    np.testing.assert_allclose(found.transpose(2, 0, 1), expected, atol=1e-13 * np.sqrt(taps))


@pytest.mark.parametrize("samples", [439, 600, 1084])
def test_a_circular_filter_is_that_of_transforms_of_the_signals_own_length(samples: int) -> None:
    """And the samples that count have the products of the harmonics' coordinates.

    Lengths with a large prime factor, without one, and even; columns that act in many rows, in few,
    in none.
    """
    rng = np.random.default_rng(1)
    count, rows, edge = samples // 3, FEW + 2, 10
    shape = (count, rows, rows)
    gains = np.tril(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    gains[0] = gains[0].real
    values = rng.standard_normal((samples, rows, 40))
    values[:, 0, 5:], values[:, 2:, 10:30], values[:, 2, :30], values[:, :, 39] = 0.0, 0.0, 0.0, 0.0
    expected = np.fft.irfft(gains @ np.fft.rfft(values, axis=0)[:count], samples, axis=0)[
        edge:-edge
    ].T
    prepared = circular_gains(gains, samples, edge)
    found = filtered_circularly(values, prepared)
    products = expected.reshape(40, -1) @ expected.reshape(40, -1).T
    flat = found.reshape(40, -1)
    np.testing.assert_allclose(flat @ flat.T, products, atol=1e-13 * np.abs(products).max())
