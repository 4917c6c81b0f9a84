"""Overlap-save convolution agrees with NumPy's, whatever the lengths and the thinning."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.estimation.convolution import convolve


@pytest.mark.parametrize("samples, taps", [(60, 11), (5000, 101), (40_000, 301)])
@pytest.mark.parametrize("every", [1, 2, 8])
def test_it_is_the_sum_of_plain_convolutions(samples: int, taps: int, every: int) -> None:
    """Two signals through two outputs' responses, added up, without the ends, one of `every` samples."""
    rng = np.random.default_rng(0)
    signals = list(rng.standard_normal((2, samples)))
    responses = rng.standard_normal((2, 2, taps))
    expected = [sum(np.convolve(s, r, "valid") for s, r in zip(signals, own, strict=True)) for own in responses]
    found = convolve(signals, responses, every)
    np.testing.assert_allclose(found, np.array(expected)[:, ::every], atol=1e-9 * np.sqrt(taps))
