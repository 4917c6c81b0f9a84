"""The period of a motion, by its autocorrelation."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.estimation.period import find_period

RATE, PERIOD = 250.0, 4.0
T = np.arange(int(5 * PERIOD * RATE)) / RATE


def test_the_period_is_found() -> None:
    """Of three harmonics to the sample, under noise."""
    angle = sum(a * np.sin(2 * np.pi * k * T / PERIOD + 0.3 * k) for k, a in ((1, 0.5), (2, 0.2), (5, 0.05)))
    noise = 1e-4 * np.random.default_rng(0).standard_normal((len(T), 1))
    assert find_period(np.asarray(angle)[:, None] + noise, RATE) == pytest.approx(PERIOD, rel=1e-5)


def test_a_motion_that_does_not_repeat_has_no_period() -> None:
    """As a chirp."""
    assert find_period(np.sin(0.3 * T**2)[:, None], RATE) is None
