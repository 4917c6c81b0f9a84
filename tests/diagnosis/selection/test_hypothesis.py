"""Choices that explain equally much are taken in their order."""

from __future__ import annotations

import numpy as np

from elastic_arm.diagnosis.selection.hypothesis import best_first, first_best


def test_equal_choices_keep_their_order() -> None:
    """Differences below the tie decide nothing, larger ones do, whatever the rounding of each score."""
    scores = np.array([1.0, 3.0, 2.0, 3.0, 1.0, 3.0])
    for seed in range(20):
        rounded = scores + 1e-7 * np.random.default_rng(seed).standard_normal(len(scores))
        assert best_first(rounded, 1e-5).tolist() == [1, 3, 5, 2, 0, 4]
        assert first_best("abcdef", lambda letter, own=rounded: own["abcdef".index(letter)], 1e-5) == "b"


def test_no_choice_has_no_order() -> None:
    """Where nothing is left to choose from, there is nothing to put in order."""
    assert best_first(np.zeros(0), 1e-5).tolist() == []
