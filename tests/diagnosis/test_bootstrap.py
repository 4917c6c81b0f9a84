"""The block bootstrap."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis.bootstrap import KEPT, block_counts, block_weights, interval, lower_bound
from elastic_arm.diagnosis.settings import ResamplingSettings


def test_every_resample_draws_as_many_blocks_as_there_are() -> None:
    """Counts add up to the number of blocks, weights to one."""
    assert (block_counts(12, 50, 0).sum(axis=1) == 12).all()
    np.testing.assert_allclose(block_weights(12, 50, 0).sum(axis=1), 1.0)


@pytest.mark.parametrize("blocks", [12, KEPT + 1])
def test_all_hypotheses_are_compared_on_the_same_resamples(blocks: int) -> None:
    """Weights of one seed are alike at every call, of another seed others, and nobody can change them."""
    first = block_weights(blocks, 5, 0)
    np.testing.assert_array_equal(first, block_weights(blocks, 5, 0))
    assert (first != block_weights(blocks, 5, 1)).any()
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1.0


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution() -> None:
    """Of many independent blocks the bootstrap's interval is the mean plus or minus 1.96 standard errors."""
    values = np.random.default_rng(1).standard_normal(400) + 0.3
    settings = ResamplingSettings()
    low = lower_bound(values, settings, 2)
    assert low == pytest.approx(values.mean() - 1.96 * values.std() / 20.0, abs=0.01)
    assert interval(np.arange(101.0), 0.9) == pytest.approx((5.0, 95.0))
