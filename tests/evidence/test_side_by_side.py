"""Columns without the rows in which they are null: what is made of them is what is made of all."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.side_by_side import SideBySide, tail_of
from elastic_arm.evidence.tails import Tail
from elastic_arm.evidence.terms.law import LawTerm
from tests.evidence.made_up import HARMONICS, bands, model, quiet, term

PLACES = 3
RNG = np.random.default_rng(11)
BANDS = bands(PLACES)


def columns(first_place: int, count: int) -> np.ndarray:
    """Return columns that are null before a place."""
    found = RNG.standard_normal((PLACES, 2 * HARMONICS, count))
    found[:first_place] = 0.0
    return found.reshape(-1, count)


def dense_products(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the products of columns in each band, null rows included."""
    return np.stack([one[rows].T @ other[rows] for rows in BANDS.slices])


@pytest.mark.parametrize("first_place", range(PLACES))
def test_products_without_null_rows_are_those_with_them(first_place: int) -> None:
    """Products, squares and whole columns equal those of dense columns, in any order of tails,
    wherever the other columns begin to show."""
    each = [columns(place, count) for place, count in ((1, 2), (0, 1), (2, 3), (1, 1), (0, 2))]
    stored = SideBySide(BANDS, [tail_of(BANDS, one) for one in each])
    assert sum(group.columns.size for group in stored.groups) < sum(one.size for one in each)
    A = columns(first_place, 4)
    products = np.concatenate(
        [
            np.pad(own, ((0, 0), (first, 0), (0, 0)))
            for first, own in zip(stored.firsts, stored.products(A), strict=True)
        ]
    )
    for one, place in zip(each, stored.slices, strict=True):
        np.testing.assert_array_equal(stored.some(place).whole, one)
        np.testing.assert_allclose(stored.squares(place), dense_products(one, one))
        expected = dense_products(one, A)
        np.testing.assert_allclose(BANDS.products(one, A), expected, atol=1e-12)
        np.testing.assert_allclose(products[place], expected.transpose(1, 0, 2), atol=1e-12)


def test_some_of_all_columns_are_found_in_their_groups() -> None:
    stored = SideBySide(BANDS, [tail_of(BANDS, columns(place, 2)) for place in (0, 1, 2)])
    some = stored.among(np.array([1, 4, 5]))
    assert [list(one) for one in some] == [[1], [], [0, 1]]  # type: ignore[arg-type]
    assert stored.among(np.arange(6)) == [slice(None)] * 3


def test_laws_that_share_shapes_gain_what_they_gain_alone() -> None:
    """Two laws that are combinations of the same shapes are screened as laws with columns of their
    own, all of them or one alone."""
    shapes, beside = columns(1, 4), term("beside", columns(0, 1), 2.0)
    y = quiet(RNG, PLACES) + 0.3 * shapes @ [0.5, -0.2, 0.1, 0.3]
    data = model(y + beside.columns[:, 0], columns(0, 2))
    fit = data.fit([beside])
    alone, shared, own = [], [], Tail(0, shapes)
    for k, count in enumerate((3, 5)):
        mixed, key = RNG.standard_normal((4, count)), ("law", "0", (k,))
        law: Any = SimpleNamespace(mixed=mixed)
        alone.append(LawTerm(key, shapes @ mixed, np.ones(count)))
        none = np.empty((0, count))
        shared.append(LawTerm(key, none, np.ones(count), law=law, shapes=own))
    one, other = Screen(data.grams, alone), Screen(data.grams, shared)
    assert other.columns.count == 4
    for among in (None, {1}):
        np.testing.assert_allclose(one.gains(fit, among), other.gains(fit, among), atol=1e-6)
    assert one.related(fit, beside) == other.related(fit, beside)
    (made,) = other.term(1).parts
    np.testing.assert_allclose(made, alone[1].columns, atol=1e-12)
    scores = [data.fit([beside, screen.term(1)], fit).score for screen in (one, other)]
    assert scores[0] == pytest.approx(scores[1], abs=1e-9)
