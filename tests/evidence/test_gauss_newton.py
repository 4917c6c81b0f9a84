"""Sets linearised about themselves, on made-up nonlinear regressions with one number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.evidence.fit import Fit, LinearModel
from elastic_arm.evidence.gauss_newton import QUARTER, about_itself, at_lags, is_far
from tests.evidence.made_up import HARMONICS, Array, model, quiet

SIGNAL = 3.0  # of the column, in deviations of the noise of a row


@dataclass(frozen=True)
class Curve:
    """y = f(nu) u + noise at one value of nu: the part of a linearisation that the steps use."""

    f: Callable[[float], float]
    y: Array  # (rows,)
    u: Array  # (rows,)
    at: float
    acting: tuple[Any, ...] = ()

    @property
    def values(self) -> Array:
        """The number (1,)."""
        return np.array([self.at])

    @property
    def problem(self) -> Any:
        """The number, as the lag of a channel in units of its prior, and the band."""
        lag = SimpleNamespace(limit=10.0, is_lag=True, channel="motor_torque", prior_std=1.0)
        return SimpleNamespace(numbers=[lag], band=SimpleNamespace(cutoff=QUARTER / 0.5))

    @property
    def cache(self) -> dict[str, LinearModel]:
        """Residual and column at this value, by central differences."""
        step = 1e-6
        slope = (self.f(self.at + step) - self.f(self.at - step)) / (2 * step)
        residual = self.y - self.f(self.at) * self.u
        return {"model": model(residual, slope * self.u[:, None], mean=-self.values)}

    def moved(self, values: Array, _acting: Any) -> Curve:
        """Return it at another value."""
        return Curve(self.f, self.y, self.u, float(values[0]))

    def fit(self) -> Fit:
        """Return the posterior of the number alone."""
        return self.cache["model"].fit([])


def curve(f: Callable[[float], float], true: float, start: float) -> Any:
    """Return a curve whose record was made at one value, linearised at another one."""
    rng = np.random.default_rng(5)
    u = SIGNAL * rng.standard_normal(2 * 2 * HARMONICS)
    return Curve(f, f(true) * u + quiet(rng), u, start)


@pytest.fixture(autouse=True)
def _no_known_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of these regressions has an effect that is known to be there."""
    monkeypatch.setattr("elastic_arm.evidence.gauss_newton.known_terms", lambda _: ([], []))


def test_a_number_is_found_where_the_curve_is_far_from_its_first_tangent() -> None:
    start = curve(lambda nu: np.expm1(nu), true=1.5, start=0.0)
    fit = start.fit()
    found, own = about_itself(start, fit, fit.frame)
    assert not is_far(own)
    assert found.at + own.numbers[0] == pytest.approx(1.5, abs=0.1)


def test_an_unchanged_score_does_not_end_steps_that_overshoot() -> None:
    """Newton's steps for the arc tangent change the sign of the number and hardly its size from a
    start of 1.39, and the score of both is the same."""
    start = curve(np.arctan, true=0.0, start=1.39)
    fit = start.fit()
    found, own = about_itself(start, fit, fit.frame)
    assert not is_far(own)
    assert found.at + own.numbers[0] == pytest.approx(0.0, abs=0.1)


def test_a_set_that_does_not_settle_counts_by_the_lowest_of_its_later_scores() -> None:
    """Each step for the cube root overshoots by twice the number, whose score grows with it."""
    start = curve(np.cbrt, true=0.0, start=1e-3)
    fit = start.fit()
    found, own = about_itself(start, fit, fit.frame)
    there = found.fit().compared_in(fit.frame)
    assert is_far(own)
    assert fit.score < own.score < there.score - 1.0


def test_a_lag_is_found_in_steps_where_its_tangent_says_nothing() -> None:
    """The tangent far from a steep step is too flat to lead there."""
    true = 2.2
    start = curve(lambda nu: np.tanh(2.0 * (nu - true)), true, start=-0.3)
    fit = start.fit()
    lost, alone = about_itself(start, fit, fit.frame)
    assert lost.at + alone.numbers[0] != pytest.approx(true, abs=0.5)
    near, begun = at_lags(start, fit, fit.frame)
    found, own = about_itself(near, begun, fit.frame)
    assert not is_far(own)
    assert found.at + own.numbers[0] == pytest.approx(true, abs=0.1)


def test_steps_end_at_once_where_nothing_tells_of_a_lag() -> None:
    start = curve(lambda _: 1.0, true=0.0, start=0.0)
    fit = start.fit()
    near, begun = at_lags(start, fit, fit.frame)
    assert near is start
    assert begun is fit


def test_no_lag_is_chosen_for_what_its_column_promises() -> None:
    """Far from zero, the arc tangent is so flat that a step leads anywhere: the score at its end
    is as good as that of the true lag, and the residual at the lag that is tried is not."""
    start = curve(np.arctan, true=0.0, start=0.0)
    fit = start.fit()
    near, begun = at_lags(start, fit, fit.frame)
    assert near is start
    assert begun is fit
