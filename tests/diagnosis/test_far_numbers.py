"""When a number of the arm, or a size that the description states, is beyond what is ordinary."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.far_numbers import (
    beyond,
    bounds_of,
    gain_beyond,
    gain_beyond_together,
    stated_beyond,
)
from elastic_arm.effects.text import parse
from elastic_arm.equations.numbers import Number
from elastic_arm.evidence.explanation import weighted
from elastic_arm.evidence.fit import KINDS, Fit
from elastic_arm.evidence.priors import WIDE, ZEROS, Assumed
from elastic_arm.evidence.terms.known import KnownTerm
from elastic_arm.evidence.terms.number import NumberTerm
from tests.evidence.made_up import HARMONICS, model
from tests.helpers.gap_recordings import ROBOT, motions, record
from tests.helpers.nightly import nightly

ROWS = 4 * HARMONICS
MASS = Number("link_mass", "joint_1", "1", 0.06, 1.0)
GAIN = Number("torque_scale", "joint_1", "1", 0.2, 1.0)


def fit_of(nu: float, judging: float | None = None) -> Fit:
    """Return a fit of one number at some deviations, another one in the judging half."""
    rng = np.random.default_rng(5)
    fitted = np.arange(ROWS) % (2 * HARMONICS) < HARMONICS
    column = 10.0 * rng.standard_normal(ROWS)
    value = np.where(fitted, nu, nu if judging is None else judging)
    y = 0.5 * rng.standard_normal(ROWS) + value * column
    return model(y, column[:, None], fitted_rows=fitted).fit([])


def test_a_ratio_is_as_far_below_as_above() -> None:
    """Three deviations of 20 % are a ratio of 1.6 or its inverse; of a mass, 18 % either way."""
    mass, gain = bounds_of((MASS, GAIN))
    assert mass == 3.0
    assert GAIN.value(gain) == pytest.approx(1.6)
    assert GAIN.value(-gain) == pytest.approx(1.0 / 1.6)


@pytest.mark.parametrize(
    ("nu", "is_beyond"), [(-4.0, True), (-2.0, False), (2.0, False), (4.0, True)]
)
def test_a_number_is_beyond_where_the_recordings_show_it(nu: float, is_beyond: bool) -> None:
    (p,) = beyond(fit_of(nu), np.zeros(1), (MASS,))
    assert (p > 0.99) == is_beyond and (p < 0.01) != is_beyond


def test_what_the_recordings_leave_open_is_not_beyond() -> None:
    data = model(np.random.default_rng(6).standard_normal(ROWS), np.full((ROWS, 1), 1e-9))
    (p,) = beyond(data.fit([]), np.zeros(1), (MASS,))
    assert p < 0.01


def test_a_number_that_only_the_fitted_recording_has_gains_nothing_on_the_other() -> None:
    for judging, gains in ((4.5, True), (2.0, False)):
        fit = fit_of(4.5, judging)
        (gain,) = gain_beyond(fit, fit.model.of_fitted(fit), np.zeros(1), (MASS,))
        assert (gain > 0.0) == gains


@pytest.mark.parametrize(
    ("ratio", "is_beyond"), [(0.1, True), (0.7, False), (1.4, False), (3.0, True)]
)
def test_a_stated_size_is_beyond_in_either_direction(ratio: float, is_beyond: bool) -> None:
    rng = np.random.default_rng(7)
    column = rng.standard_normal(ROWS)
    key = ("coulomb_friction", None, ())
    stated = np.array([5.0])
    known = KnownTerm(key, column[:, None], np.array([10.0]), mean=stated, stated=stated)
    data = model(0.5 * rng.standard_normal(ROWS) + 5.0 * ratio * column, always=(known,))
    (p,) = stated_beyond(data.fit([])).values()
    assert (p > 0.5) == is_beyond


@pytest.mark.parametrize("factor", [10.0, *nightly([0.2])])
def test_friction_that_is_stated_far_too_large_or_small_is_named_with_from_and_to(
    factor: float,
) -> None:
    """Ten times too large is as far off as a tenth: both are more than the description's errors."""
    true = parse("coulomb_friction:joint_2:torque=6", ROBOT)
    stated = replace(true, parameters={"torque": 6.0 * factor})
    described = ROBOT.with_(effects=(stated.to_dict(),))
    text = "coulomb_friction:joint_2:torque=6"
    fitted, judged = (record(motion, text, seed=k) for k, motion in enumerate(motions()))
    found = diagnose([fitted], Question(described, effects=["payload"]), [judged])
    (cause,) = found.causes
    assert (found.verdict, cause.effect, cause.joint) == (
        "explained",
        "coulomb_friction",
        "joint_2",
    )
    assert cause.stated == {"torque": pytest.approx(6.0 * factor)}
    assert cause.parameters["torque"].value == pytest.approx(6.0, rel=0.05)


def zero(joint: str) -> Number:
    """Return the zero of a joint's torque sensor."""
    effect = SimpleNamespace(set_at_start=True)
    feature: Any = SimpleNamespace(sensed=frozenset({"tau_J"}), effect=effect)
    return Number("joint_torque_offset", joint, "Nm", 0.1, 0.0, feature)


@pytest.mark.parametrize(
    ("sizes", "is_beyond"),
    [((5.0, -6.0, 4.0, 5.5, -4.5, 6.0), False), ((0.5, -0.3, 8.0, 0.2, 1.0, -0.7), True)],
    ids=["all", "one"],
)
def test_zeros_share_a_scale(sizes: tuple[float, ...], is_beyond: bool) -> None:
    """Where all zeros of an arm are large, none is beyond; one among small ones is.

    Sets in which that zero alone is far off are summed over as well.
    """
    rng = np.random.default_rng(8)
    columns = 10.0 * rng.standard_normal((ROWS, len(sizes)))
    numbers = [zero(f"joint_{k}") for k in range(len(sizes))]
    kinds = np.array([KINDS.index(number.kind) for number in numbers])
    moving = np.zeros(len(sizes), dtype=bool)
    y = 0.5 * rng.standard_normal(ROWS) + columns @ sizes
    data = model(y, columns, kinds=kinds, moving=moving)
    along = np.eye(len(sizes))[:, [2]]
    key = ("joint_torque_offset", "joint_2", ())
    wide = np.array([WIDE])
    odds = float(np.log(len(sizes)))
    alone = NumberTerm(key, columns @ along, wide, odds=odds, along=along)
    under = [data.assuming(Assumed("as built", scale)) for scale in ZEROS]
    fits = [one.fit(terms) for one in under for terms in ([], [alone])]
    p = sum(p * beyond(fit, np.zeros(len(sizes)), numbers) for p, fit in weighted(fits))
    assert (p[2] > 0.5) == is_beyond
    assert all(p[[0, 1, 3, 4, 5]] < 0.5)


def test_two_numbers_that_only_their_sum_tells_are_held_together() -> None:
    """Each alone can go back to its bound if the other one takes its part; both cannot."""
    rng = np.random.default_rng(6)
    fitted = np.arange(ROWS) % (2 * HARMONICS) < HARMONICS
    column = 10.0 * rng.standard_normal(ROWS)
    N = np.column_stack([column, column + 0.01 * rng.standard_normal(ROWS)])
    y = 0.5 * rng.standard_normal(ROWS) + N @ [5.0, 5.0]
    fit = model(y, N, fitted_rows=fitted).fit([])
    sized = fit.model.of_fitted(fit)
    numbers = (MASS, replace(MASS, what="link_com_x"))
    each = gain_beyond(fit, sized, np.zeros(2), numbers)
    assert np.all(np.abs(each) < 10.0)
    assert gain_beyond_together(fit, sized, np.zeros(2), numbers, [0, 1]) > 1000.0
