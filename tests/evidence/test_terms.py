"""By what terms are told apart, where their products are kept."""

from itertools import combinations

import numpy as np
import pytest

from elastic_arm.equations.dry_friction import SHAPES
from elastic_arm.estimation.turnover import FrictionPlace
from elastic_arm.evidence.grams import Grams
from elastic_arm.evidence.terms.dry_friction import SHARES, CurveTerm, TurnoverTerm, choices
from tests.evidence.made_up import HARMONICS, bands

JOINTS = ("base", "shoulder", "elbow", "wrist", "flange")


def curve(columns: np.ndarray, turned: float, joint: str = "elbow") -> CurveTerm:
    """Return the friction curve of one joint, where a share of the friction turns over."""
    return CurveTerm(
        ("friction_curve", joint, (("side", "motor"),)),
        columns,
        np.ones(SHAPES),
        place=FrictionPlace(joint, "motor"),
        turned=np.full(SHARES, turned),
        joints=len(JOINTS),
    )


def turnover(joint: str) -> TurnoverTerm:
    """Return the turnover of the friction of one joint."""
    return TurnoverTerm(
        ("friction_turnover", joint, (("side", "motor"),)),
        np.zeros((1, SHARES)),
        np.ones(SHARES),
        place=FrictionPlace(joint, "motor"),
        joints=len(JOINTS),
    )


def test_a_curve_linearised_elsewhere_has_products_of_its_own() -> None:
    rng = np.random.default_rng(1)
    rows = 2 * 2 * HARMONICS
    y = rng.standard_normal(rows)
    grams = Grams(y, np.zeros((rows, 0)), bands(), np.zeros((0, 0)))
    first, other = (rng.standard_normal((rows, SHAPES)) for _ in range(2))
    grams.with_base(curve(first, turned=0.0))
    found = grams.with_base(curve(other, turned=0.5))
    np.testing.assert_allclose(found.sum(axis=0)[0], y @ other)


def test_the_joints_of_an_arm_are_alike() -> None:
    """Friction that differs from its laws at all joints or at none costs nothing; at some of them,
    the choice of these. The numbers of joints are then equally likely."""
    empty = np.zeros((1, SHAPES))
    curves = [curve(empty, 0.0, joint) for joint in JOINTS]
    turnovers = [turnover(joint) for joint in JOINTS]
    assert choices([]) == 0.0
    assert choices(curves) == choices([*curves, *turnovers]) == 0.0
    assert choices(curves[:1]) == pytest.approx(np.log(5.0))
    assert choices(curves[:2]) == pytest.approx(np.log(10.0))
    assert choices([*curves[:2], *turnovers[:1]]) == pytest.approx(np.log(50.0))
    subsets = [c for k in range(6) for c in combinations(curves, k)]
    assert sum(np.exp(-choices(c)) / 6.0 for c in subsets) == pytest.approx(1.0)
