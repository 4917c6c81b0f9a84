"""Sizes of causes: what the posterior says within the bounds of physics."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from elastic_arm.diagnosis.causes import Causes
from elastic_arm.diagnosis.estimates import link_values, mounted_body, within
from elastic_arm.diagnosis.result import ParameterEstimate
from elastic_arm.equations.robot_at import changed_link
from elastic_arm.evidence.terms.known import least_of
from elastic_arm.evidence.terms.term import Term
from elastic_arm.robot import Inertia
from elastic_arm.robot.kinematics import lumped


def test_a_size_stays_within_its_bounds_and_takes_others_along() -> None:
    """Mean and covariance are those of the draws of a Gaussian that lie within the bound, to 3 % of
    a deviation."""
    x, S = np.array([-2.4, 1.0]), np.array([[0.25, 0.1], [0.1, 0.09]])
    draws = np.random.default_rng(0).multivariate_normal(x, S, size=400_000)
    draws = draws[draws[:, 0] > -2.0]
    mean, covariance = within(x, S, np.array([-2.0, -np.inf]), np.full(2, np.inf))
    np.testing.assert_allclose(mean, draws.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(covariance, np.cov(draws.T), atol=0.004)
    assert mean[0] > -2.0


def test_a_cause_that_very_many_sets_share_has_the_mean_size_of_these(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each set has a hundredth of the probability."""
    sizes = iter(np.linspace(1.0, 2.0, 100))

    def estimated(*_: Any) -> tuple[dict[str, ParameterEstimate], None]:
        return {"torque": ParameterEstimate(float(next(sizes)), 0.1, "Nm")}, None

    monkeypatch.setattr("elastic_arm.diagnosis.causes.estimated", estimated)
    term = Term(("coulomb_friction", "elbow", ()), np.zeros((4, 1)), np.ones(1))
    fit = SimpleNamespace(model=SimpleNamespace(of_fitted=lambda fit: fit))
    parts = SimpleNamespace(
        problem=SimpleNamespace(numbers=()),
        explanation=SimpleNamespace(linear=SimpleNamespace(values=np.zeros(0))),
    )
    confirmed: Any = SimpleNamespace(parts=parts)
    causes = Causes(confirmed, unknown=cast(Any, None))
    found = causes._sizes([(0.01, cast(Any, fit), term)] * 100)
    assert found["torque"].value == pytest.approx(1.5)


def test_stated_friction_is_not_less_than_none() -> None:
    """A stated friction that recordings put within a deviation of zero stays positive; one far from
    zero keeps its size."""
    friction = SimpleNamespace(least=0.0, neutral=None, size=1)
    ratio = SimpleNamespace(least=0.0, neutral=1.0, size=1)
    feature: Any = SimpleNamespace(linear=(friction,))
    assert least_of(cast(Any, SimpleNamespace(linear=(ratio,))), 1) == -1.0
    low = least_of(feature, 1)
    none = np.full(1, np.inf)
    small, _ = within(np.array([-0.01]), np.array([[0.02**2]]), low, none)
    large, _ = within(np.array([1.0]), np.array([[0.02**2]]), low, none)
    assert 0.0 < small[0] < 0.02
    assert large[0] == pytest.approx(1.0)


def test_a_wrong_link_has_the_sizes_of_the_link_that_is_written() -> None:
    """Numbers of a link are linear about the frame's origin, sizes of the cause are not; moments
    that no body has are the nearest ones."""
    link = Inertia(2.0, np.array([0.02, -0.01, 0.1]), np.diag([0.05, 0.06, 0.03]))
    numbers = {f"link_{name}": 0.0 for name in ("com_x", "inertia_xy", "inertia_xz", "inertia_yz")}
    numbers |= {"link_mass": 1.4, "link_com_y": -0.02, "link_com_z": 0.12}
    numbers |= {"link_inertia_xx": 0.9, "link_inertia_yy": 0.8, "link_inertia_zz": 0.2}
    written = changed_link(link, numbers, nearest=True)
    shift, inertia = link_values(link, numbers)
    assert link.com + shift == pytest.approx(written.com)
    moments = np.trace(written.inertia) / np.trace(link.inertia)
    assert inertia == pytest.approx(moments / 2.4)


def test_a_heavier_link_is_the_described_one_with_a_body() -> None:
    link = Inertia(2.0, np.array([0.02, -0.01, 0.1]), 0.05 * np.eye(3))
    place = np.array([0.0, 0.03, 0.2])
    together = lumped([link, Inertia(0.5, place)])
    mass, found = mounted_body(link, together.mass / link.mass, together.com - link.com)
    assert mass == pytest.approx(0.5)
    assert found == pytest.approx(place)


def test_a_wrong_link_has_finite_sizes_as_a_point_and_below_no_mass() -> None:
    """Arm files may describe links as points, and the mean of a posterior may be no mass."""
    names = ("xx", "yy", "zz", "xy", "xz", "yz")
    numbers = {f"link_inertia_{name}": 0.0 for name in names}
    numbers |= {"link_mass": 0.5, "link_com_x": 0.0, "link_com_y": 0.0, "link_com_z": 0.03}
    point = Inertia(2.0, np.array([0.0, 0.0, 0.1]))
    shift, inertia = link_values(point, numbers)
    assert shift == pytest.approx((0.0, 0.0, 0.02))
    assert inertia == 1.0
    body = Inertia(2.0, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
    shift, inertia = link_values(body, {**numbers, "link_mass": -1.1})
    assert np.isfinite([*shift, inertia]).all()
