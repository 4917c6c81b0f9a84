"""Deviations from few blocks: how many of them count, and intervals that hold the truth all the same."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.dynamics.gram import gram
from elastic_arm.identification.deviations import freedom
from elastic_arm.identification.least_squares import Blocks, fit


def test_blocks_that_share_alike_all_count() -> None:
    """Twelve equal blocks leave eleven degrees of freedom to every parameter."""
    np.testing.assert_allclose(freedom(np.ones((12, 3))), 11.0)


def test_a_parameter_that_two_blocks_determine_has_one_degree_of_freedom() -> None:
    """However many blocks there are besides; and one block alone leaves no fewer than one."""
    shares = np.full((40, 2), 1e-9)
    shares[:2, 0] = shares[0, 1] = 1.0
    np.testing.assert_allclose(freedom(shares), 1.0, rtol=1e-6)


@pytest.mark.parametrize("strong", [2, 4, 12])
def test_intervals_hold_the_truth_where_few_blocks_determine_a_parameter(strong: int) -> None:
    """Over 400 draws of 12 blocks, `strong` of which excite the first parameter: both are covered in 92 to 99.9 %."""
    hits = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        blocks = Blocks(1, 3)
        for k in range(12):
            phi = rng.standard_normal((40, 2)) * [1.0 if k < strong else 0.01, 1.0]
            # An error common to a block is what its scores show and white errors would not.
            y = phi @ [2.0, -1.0] + rng.standard_normal(40) + phi @ (0.3 * rng.standard_normal(2))
            blocks.add(tuple(part[None] for part in gram(np.column_stack([phi, y]))), 40)  # type: ignore[arg-type]
        found = fit(blocks)
        hits.append(np.abs(found.Psi - [2.0, -1.0]) < 1.96 * found.std)
    covered = np.mean(hits, axis=0)
    assert np.all((covered >= 0.92) & (covered <= 0.999)), covered
