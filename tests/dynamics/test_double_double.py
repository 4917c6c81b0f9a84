"""Triangular factors in twice the working precision: the same in C and in NumPy."""

import numpy as np
import pytest

from elastic_arm.codegen.compiler import find_compiler
from elastic_arm.dynamics import double_double
from elastic_arm.dynamics.double_double import Pair, cholesky
from elastic_arm.dynamics.gram import gram


def grams(rng: np.random.Generator, groups: int, width: int) -> Pair:
    """Gram matrices of 50 rows, with a column of zeros, one that depends on others, and one that
    nearly does."""
    rows = rng.standard_normal((groups, 50, width))
    rows[..., 3], rows[..., 4] = 0.0, rows[..., 1] + rows[..., 2]
    rows[..., 5] = rows[..., 1] * (1.0 + 1e-9 * rows[..., 2])
    parts = [gram(group) for group in rows]
    return np.stack([hi for hi, _ in parts]), np.stack([lo for _, lo in parts])


@pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler")
@pytest.mark.parametrize(("groups", "width"), [(1, 7), (6, 27), (3, 70)])
def test_factors_with_and_without_a_compiler_are_the_same_to_the_last_bit(
    groups: int, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    matrices = grams(np.random.default_rng(width), groups, width)
    compiled = cholesky(matrices)
    assert double_double._compiled() is not None
    monkeypatch.setattr(double_double, "_compiled", lambda: None)
    assert np.array_equal(compiled, cholesky(matrices))


@pytest.mark.parametrize("compiled", [True, False])
def test_a_factor_gives_the_matrix_back_and_leaves_it_as_it_was(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not compiled:
        monkeypatch.setattr(double_double, "_compiled", lambda: None)
    hi, lo = grams(np.random.default_rng(1), 4, 12)
    kept = hi.copy(), lo.copy()
    R = cholesky((hi, lo))
    np.testing.assert_allclose(R.transpose(0, 2, 1) @ R, hi, rtol=0, atol=1e-12 * np.max(hi))
    assert np.array_equal(R, np.triu(R))
    assert not R[:, 3].any()
    assert np.max(np.abs(R[:, 4, 4])) < 1e-9
    assert np.array_equal(hi, kept[0])
    assert np.array_equal(lo, kept[1])
