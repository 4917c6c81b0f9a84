"""Residual statistics, on residuals made up."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.inference.excess import (
    ResidualStatistics,
    contribution,
    place_contribution,
    residual_statistics,
    shrink,
)
from elastic_arm.diagnosis.settings import DiagnosisSettings

SETTINGS = DiagnosisSettings()
DATA: Any = SimpleNamespace(
    band=SimpleNamespace(kept_rate=100.0, cutoff=20.0),
    noise_std=lambda low_pass: np.array([0.74]),
    noise_breadth=lambda low_pass: None,
)


def statistics(values: np.ndarray, settings: DiagnosisSettings = SETTINGS) -> Any:
    return residual_statistics(DATA, [values[:, None]], 20.0, settings, 0)


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    """Half a minute of white noise: the low pass of 20 Hz leaves 0.74 of its standard deviation."""
    return np.random.default_rng(0).standard_normal(3000)


def test_noise_is_not_significant_and_a_slow_offset_is(noise: np.ndarray) -> None:
    """Noise as large as stated holds no excess worth the name; an offset of the noise's size is significant."""
    assert not statistics(noise).significant.any()
    found = statistics(noise + 0.7)
    assert found.significant.all() and found.excess[0] == pytest.approx(0.49, rel=0.25)


def test_significance_follows_its_thresholds(noise: np.ndarray) -> None:
    """What is significant at the usual guard is not if the noise may be ten times as strong."""
    guarded = replace(SETTINGS, significance=replace(SETTINGS.significance, noise_guard=10.0))
    assert not statistics(noise + 0.7, guarded).significant.any()


def test_half_of_an_offset_is_three_quarters_of_the_excess(noise: np.ndarray) -> None:
    """Excess is a power: with half the amplitude gone a quarter is left, and the interval holds the share."""
    before, after = statistics(noise + 2.0), statistics(noise + 1.0)
    share, (low, high) = shrink(before, after, SETTINGS.resampling, np.random.default_rng(1))
    assert share == pytest.approx(0.75, abs=0.03) and low < share < high
    assert contribution(before, before, after) == pytest.approx(0.75, abs=0.03)


def test_a_small_joints_own_gap_counts_beside_a_large_one() -> None:
    """Half of a wrist's excess is 1 in 20,000 of the whole, and half of its own."""

    def sizes(*squares: float) -> ResidualStatistics:
        blocks, none = np.tile(squares, (10, 1)), np.zeros(2)
        return ResidualStatistics(10.0, np.sqrt(squares), none, none, 100.0, blocks, np.array([True, True]))

    before, without, after = sizes(1e4, 1.0), sizes(1.0, 1.0), sizes(1.0, 0.5)
    assert contribution(before, without, after) == pytest.approx(5e-5, rel=0.01)
    assert place_contribution(before, without, after) == pytest.approx(0.5)
