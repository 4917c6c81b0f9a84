"""Dry friction that turns over within a distance."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from elastic_arm.equations.dry_friction import (
    BENDS,
    LAWS,
    Curve,
    functions_of_speed,
)
from elastic_arm.estimation.turnover import over_distance

T = np.linspace(0.0, 4.0, 2001)
ANGLE = 0.3 * np.sin(2.0 * T) + 0.02 * np.sin(11.0 * T)
SPEED = 0.6 * np.cos(2.0 * T) + 0.22 * np.cos(11.0 * T)


@pytest.mark.parametrize("distance", [1e-3, 1e-2, 0.1])
def test_dry_friction_turns_over_as_dahls_equation_has_it(distance: float) -> None:
    """An integrator that has only the differential equation finds the same course."""

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        speed = 0.6 * np.cos(2.0 * t) + 0.22 * np.cos(11.0 * t)
        return (speed - z * abs(speed)) / distance

    true = solve_ivp(rate, (0.0, 4.0), [1.0], "LSODA", T, rtol=1e-8, atol=1e-10, max_step=1e-3)
    found = over_distance(ANGLE, np.sign(SPEED), distance)
    # At a reversal the samples miss a part of the way: at most that of one step.
    step = np.abs(np.diff(ANGLE, 2)).max()
    np.testing.assert_allclose(found, true.y[0], atol=2.0 * min(1.0, step / distance) + 1e-5)


def test_an_angle_that_stays_keeps_its_friction() -> None:
    """Friction that holds a load at rest stays as it was when the joint stopped."""
    angle = np.concatenate([np.linspace(0.0, 0.004, 50), np.full(50, 0.004)])
    found = over_distance(angle, np.ones(100), 0.01)
    np.testing.assert_array_equal(found[50:], found[49])


def test_curves_of_friction_bend_where_stribeck_friction_falls() -> None:
    """The functions together have a variance of about one at all speeds, and a sum of them beside
    dry and viscous friction follows a law that falls within a third of a decade."""
    w = np.geomspace(0.015, 1.5, 200)
    phi = functions_of_speed(w, 1.5)
    variance = (phi**2).sum(axis=0)
    assert variance.min() > 0.8
    assert variance.max() < 1.05
    laws = np.vstack([phi, np.ones_like(w), w]).T
    stribeck = np.exp(-((w / 0.12) ** 2))
    size = np.linalg.lstsq(laws, stribeck)[0]
    assert np.sqrt(np.mean((laws @ size - stribeck) ** 2)) < 0.05


def left_of(column: np.ndarray, by: np.ndarray) -> float:
    """Return the share of a column's power that no sum of others (rows, k) makes."""
    rest = column - by @ np.linalg.lstsq(by, column)[0]
    return float(rest @ rest / (column @ column))


def test_no_bend_of_the_curve_stands_for_viscous_friction_in_slow_rows() -> None:
    """Slow rows tell most: what is no viscous friction in the samples may be all of it there."""
    t = np.arange(0.0, 22.0, 0.01)
    w = np.cos(0.7 * t) + 0.5 * np.cos(1.5 * t + 1.0) + 0.3 * np.cos(2.9 * t + 2.0)
    sign = np.sign(w)
    free = Curve.over(np.abs(w), np.ones_like(w))
    bends, sides = free.shapes(np.abs(w), np.ones_like(w), 2.0 * t / t[-1] - 1.0)
    laws = np.array([sign, w])
    columns = np.vstack([sign * bends, sides, laws]).T
    slow = np.fft.rfft(columns, axis=0)[1:30]
    rows = np.vstack([slow.real, slow.imag])
    curve = free.of_rows(rows)
    dry, viscous = rows[:, -LAWS:].T
    beside = slice(BENDS)
    alone = left_of(viscous, dry[:, None])
    with_bends = left_of(viscous, np.column_stack([dry, curve.less(rows)[:, beside]]))
    assert left_of(viscous, np.column_stack([dry, rows[:, beside]])) < 0.5 * alone
    assert with_bends == pytest.approx(alone, rel=1e-6)
