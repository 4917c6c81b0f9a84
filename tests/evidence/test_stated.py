"""Sizes that a description states, whose logarithms have the prior."""

import numpy as np
import pytest

from elastic_arm.evidence.terms.known import moved_by_logarithm


def test_a_stated_size_moves_by_its_logarithm() -> None:
    """A fit about 0.34 that wants less than nothing, as another term takes the rest, means 0.05:
    Newton's step of the logarithm. A larger size is taken as it is, and none stays free."""
    sizes = np.array([0.34, 0.34, 0.34, 0.0])
    wanted = np.array([-0.312, 0.3, 0.5, -2.0])
    moved = moved_by_logarithm(sizes, wanted)
    assert moved[0] == pytest.approx(0.34 * np.exp(-0.652 / 0.34))
    assert moved[1] == pytest.approx(0.34 * np.exp(-0.04 / 0.34))
    assert moved[2:].tolist() == [0.5, -2.0]


def test_repeated_steps_of_a_prior_alone_end_at_the_stated_size() -> None:
    """Where data tell nothing, the Gaussian about any size leads back to what is stated."""
    stated = 0.05
    size = np.array([0.34])
    for _ in range(12):
        mean = size * (1.0 - np.log(size / stated))
        size = moved_by_logarithm(size, mean)
    assert size[0] == pytest.approx(stated, rel=1e-6)
