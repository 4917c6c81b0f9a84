"""The probability that a link exists whose numbers are known as a Gaussian."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.arrays import Array
from elastic_arm.dynamics.bodies import inertial_parameters
from elastic_arm.evidence.body import Body
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.robot import Inertia
from tests.evidence.made_up import HARMONICS, model

LINK = Inertia(2.0, np.array([0.0, 0.0, 0.1]), np.diag([0.02, 0.02, 0.005]))


@pytest.fixture(scope="module")
def body() -> Body:
    """A link of which the ten parameters themselves are the numbers."""
    ten = inertial_parameters(LINK)
    return Body.of(ten, ten + 1e-3 * np.eye(10), 1e-3)


def moved(**parameters: float) -> Array:
    """Changes of the ten parameters."""
    names = ("m", "mx", "my", "mz", "xx", "xy", "xz", "yy", "yz", "zz")
    return np.array([parameters.get(name, 0.0) for name in names])


def test_a_body_is_certain_to_be_one(body: Body) -> None:
    """The described link, and a heavier one, are no doubt."""
    S = 1e-6 * np.eye(10)
    assert body.log_probability(np.zeros(10), S) == 0.0
    assert body.log_probability(moved(m=1.0), S) == 0.0


def test_a_negative_mass_is_as_far_as_its_deviation(body: Body) -> None:
    """A mass of -0.3 ± 0.1 kg: three deviations; with ± 3 kg a body is near."""
    x = moved(m=-2.3, mz=-0.2)
    S = np.diag([0.01, *[1.0] * 9])
    assert body.distance(x, S) == pytest.approx(3.0, abs=0.1)
    assert body.distance(x, np.diag([9.0, *[1.0] * 9])) < 0.2


def test_a_negative_sum_of_moments_is_impossible_though_no_moment_is_known(body: Body) -> None:
    """xx + yy + zz is known to be negative, each of them alone is not: no body is near, as
    the products of eigenvalues alone would not show."""
    x = moved(xx=-0.09, yy=-0.09, zz=-0.02)
    along = np.zeros((10, 3))
    along[[4, 7, 9], :] = np.eye(3) - np.ones((3, 3)) / 3.0
    S = along @ along.T + np.diag([1.0, *[1.0] * 3, *[1e-4] * 6])
    assert body.distance(x, S) > 5.0
    loose = S + np.diag([0.0] * 4 + [1.0] * 6)
    assert body.distance(x, loose) < 0.5


def test_the_nearest_body_lies_between_bounds(body: Body) -> None:
    """It is nearer than all random bodies, and at least as far as every half-space w'Jw >= 0
    that holds all bodies."""
    rng = np.random.default_rng(5)
    A = 0.3 * rng.normal(size=(10, 10))
    S = A @ A.T + 0.01 * np.eye(10)
    x = moved(m=-2.4, mz=-0.3)
    found = body.distance(x, S)
    factors = np.linalg.cholesky(body.described) + 0.5 * rng.normal(size=(20000, 4, 4))
    bodies = factors @ np.swapaxes(factors, 1, 2)
    to_numbers = np.linalg.pinv(body.along.reshape(10, 16).T)
    numbers = (bodies - body.described).reshape(-1, 16) @ to_numbers.T
    off = numbers - x
    distances = np.sqrt(np.einsum("ni,ij,nj->n", off, np.linalg.inv(S), off))
    w = rng.normal(size=(20000, 4))
    along = np.einsum("na,kab,nb->nk", w, body.along, w)
    value = np.einsum("na,ab,nb->n", w, body.at(x), w)
    std = np.sqrt(np.einsum("nk,kl,nl->n", along, S, along))
    assert 0.0 < np.max(-value / std) <= found + 1e-3
    assert found <= distances.min()


def test_a_link_that_no_body_has_loses_its_lead(body: Body) -> None:
    """A term of ten numbers whose best fit has a moment far below zero scores lower than the same
    term without the link; one that fits a heavier link scores the same."""
    rng = np.random.default_rng(2)
    rows = 4 * HARMONICS
    X = 100.0 * rng.standard_normal((rows, 10))
    gains = {}
    for name, ten in (("heavier", moved(m=0.5)), ("impossible", moved(xx=-3.0, yy=-3.0))):
        y = X @ ten + rng.standard_normal(rows)
        data = model(y, X)
        along = np.eye(10)
        term = NumberTerm(("link", "a", ()), X @ along, np.full(10, 30.0), along=along)
        fits = [data.fit([term]).score, data.fit([replace(term, body=body, ident=("b",))]).score]
        gains[name] = fits[1] - fits[0]
    assert gains["heavier"] == pytest.approx(0.0, abs=0.1)
    assert gains["impossible"] < -20.0
