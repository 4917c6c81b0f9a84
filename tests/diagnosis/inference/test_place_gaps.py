"""The gap of every joint and side by itself, on residuals made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.inference.place_gaps import place_gaps
from elastic_arm.diagnosis.settings import DiagnosisSettings

SETTINGS = DiagnosisSettings()
LEFT = SETTINGS.judgement.place_explained
DATA: Any = SimpleNamespace(
    band=SimpleNamespace(kept_rate=100.0, cutoff=20.0),
    layout=SimpleNamespace(rows=3),
    # White noise of one, as much of it as each low pass leaves.
    noise_std=lambda low_pass: np.full(3, 0.74 * np.sqrt(low_pass.cutoff / 20.0)),
    noise_breadth=lambda low_pass: None,
)


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    """Half a minute of white noise in three residuals."""
    return np.random.default_rng(0).standard_normal((3000, 3))


def test_a_small_joint_counts_as_much_as_a_large_one(noise: np.ndarray) -> None:
    """With nearly all Nm² gone at the first residual, the second, untouched, keeps its gap open."""
    found = place_gaps(DATA, [noise + np.array([100.0, 3.0, 0.0])], [noise + np.array([1.0, 3.0, 0.0])], SETTINGS)
    shares = [place.shrink for place in found]
    assert shares[0] == pytest.approx(0.9999, abs=1e-4) and shares[1] == pytest.approx(0.0, abs=1e-9)
    assert shares[2] is None
    assert [place.is_open(LEFT) for place in found] == [False, True, False]


def test_what_looks_like_noise_is_closed_whatever_its_share(noise: np.ndarray) -> None:
    """A gap of which nothing significant is left is closed."""
    found = place_gaps(DATA, [noise + np.array([3.0, 3.0, 3.0])], [noise], SETTINGS)
    assert not any(place.is_open(LEFT) for place in found)


def test_a_gap_that_causes_make_is_open(noise: np.ndarray) -> None:
    """A residual that had no gap and has one with the causes has no share, and is open."""
    found = place_gaps(DATA, [noise], [noise + np.array([0.0, 0.0, 3.0])], SETTINGS)
    assert [place.shrink for place in found] == [None, None, None]
    assert [place.is_open(LEFT) for place in found] == [False, False, True]
