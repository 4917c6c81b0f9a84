"""Columns of nuisance parameters."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis.calibration.columns import _turnover


@pytest.mark.parametrize("acceleration", [0.4, -0.4, 2.5])
def test_friction_that_turns_over_late_has_the_impulse_of_one_shape(acceleration: float) -> None:
    """A velocity 8e-4 rad/s off at reversals shifts friction in time: below the band that is the impulse of one column.

    The ratio of the two impulses is 8e-4 over the width, whatever the acceleration.
    """
    t = np.arange(-0.2, 0.2, 1e-5)
    w, early, width = acceleration * t, 8e-4, 2e-3
    shifted = np.sign(w + early * np.sign(acceleration)) - np.sign(w)
    column = _turnover(w, t, (width,))
    assert shifted.sum() / column.sum() == pytest.approx(early / width, rel=0.01)


def test_friction_that_turns_over_gradually_has_no_impulse() -> None:
    """The shapes between two widths of the sign function are odd in the velocity."""
    t = np.linspace(-0.2, 0.2, 4001)
    column = _turnover(0.7 * t, t, (5e-4, 2e-3))
    assert abs(column.sum()) < 1e-9 * np.abs(column).sum()
