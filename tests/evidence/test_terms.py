"""By what terms are told apart, where their products are kept."""

import numpy as np

from elastic_arm.equations.dry_friction import SHAPES, FrictionPlace
from elastic_arm.evidence.grams import Grams
from elastic_arm.evidence.terms.dry_friction import SHARES, DryFrictionTerm
from tests.evidence.made_up import HARMONICS, bands


def curve(columns: np.ndarray, turned: float) -> DryFrictionTerm:
    """Return the friction curve of one joint, linearised where a share turns over."""
    return DryFrictionTerm(
        ("dry_friction", "elbow", (("side", "motor"),)),
        columns,
        np.ones(SHARES + SHAPES),
        place=FrictionPlace("elbow", "motor"),
        turned=np.full(SHARES, turned),
    )


def test_a_curve_linearised_elsewhere_has_products_of_its_own() -> None:
    rng = np.random.default_rng(1)
    rows = 2 * 2 * HARMONICS
    y = rng.standard_normal(rows)
    grams = Grams(y, np.zeros((rows, 0)), bands(), np.zeros((0, 0)))
    first, other = (rng.standard_normal((rows, SHARES + SHAPES)) for _ in range(2))
    grams.with_base(curve(first, turned=0.0))
    found = grams.with_base(curve(other, turned=0.5))
    np.testing.assert_allclose(found.sum(axis=0)[0], y @ other)
