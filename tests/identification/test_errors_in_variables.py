"""What the encoders' noise adds to sums is taken off as far as sums hold more than it."""

import numpy as np
import pytest

from elastic_arm.identification.errors_in_variables import (
    MOST_TAKEN_OFF,
    correction_share,
    without_noise,
)
from elastic_arm.identification.least_squares import Blocks, Fit, fit
from elastic_arm.identification.triangular import triangular


def noisy(signal: float, seed: int) -> Fit:
    """Fit y = 2 a - b from 12 blocks in which `a`, of size `signal`, is seen through noise of size
    one."""
    rng = np.random.default_rng(seed)
    blocks = Blocks(1, 3)
    for _ in range(12):
        phi = rng.standard_normal((60, 2)) * [signal, 1.0]
        y = phi @ [2.0, -1.0] + 0.1 * rng.standard_normal(60)
        seen = phi + rng.standard_normal((60, 1)) * [1.0, 0.0]
        known = np.zeros((1, 3, 3))
        known[0, 0, 0] = 60.0
        blocks.add(triangular(np.column_stack([seen, y])[None]), 60, known_noise=known)
    return fit(blocks)


@pytest.mark.parametrize("signal", [0.5, 1.0, 3.0])
def test_intervals_hold_the_truth_however_much_of_a_column_is_noise(signal: float) -> None:
    """Also where noise makes up four fifths of a column's sums, intervals of both parameters hold
    in 92 % and more."""
    found = [noisy(signal, seed) for seed in range(200)]
    held = np.array([np.abs(each.Psi - [2.0, -1.0]) < 1.96 * each.std for each in found])
    assert np.all(held.mean(axis=0) >= 0.92), held.mean(axis=0)


def test_no_more_noise_is_taken_off_than_leaves_something() -> None:
    """Of noise twice as large as the sums as much is taken off as leaves a tenth of these; little
    noise goes whole."""
    rows = triangular(np.random.default_rng(0).standard_normal((50, 4)))
    assert correction_share(rows, 0.5 * rows.T @ rows) == 1.0
    assert correction_share(rows, 2.0 * rows.T @ rows) == pytest.approx(MOST_TAKEN_OFF / 2.0)


def test_rows_without_noise_have_the_square_less_the_noise() -> None:
    """Also where a column is null and another one is a combination of others."""
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((50, 5))
    rows[:, 1] = 0.0
    rows[:, 3] = rows[:, 0] + rows[:, 2]
    whole = triangular(rows)
    noise = np.diag([3.0, 0.0, 0.0, 0.0, 5.0])
    share = correction_share(whole, noise)
    left = without_noise(whole, noise)
    np.testing.assert_allclose(left.T @ left, rows.T @ rows - share * noise, atol=1e-9)
