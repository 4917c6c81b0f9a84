"""The arm with numbers that deviate from its description."""

import numpy as np
import pytest

from elastic_arm.dynamics.bodies import TENSOR, inertial_parameters
from elastic_arm.equations.robot_at import changed_link
from elastic_arm.errors import RobotError
from elastic_arm.robot import Inertia

LINK = Inertia(2.0, np.array([0.02, -0.01, 0.1]), np.diag([0.05, 0.06, 0.03]))
NAMES = (
    "link_mass",
    *(f"link_com_{axis}" for axis in "xyz"),
    *(f"link_inertia_{'xyz'[a]}{'xyz'[b]}" for a, b in TENSOR),
)


def parameters(deviations: np.ndarray) -> np.ndarray:
    """Return the inertial parameters (10,) of the link with deviations (10,)."""
    return inertial_parameters(changed_link(LINK, dict(zip(NAMES, deviations, strict=True))))


def test_a_link_is_linear_in_its_deviations() -> None:
    """As the columns of the numbers are: otherwise a fitted payload, which changes mass and centre
    together, is written with another weight than was fitted."""
    deviations = np.array([1.4, 0.03, -0.02, 0.12, 0.9, 0.01, -0.02, 0.8, 0.03, 0.2])
    described = parameters(np.zeros(10))
    slopes = np.zeros((10, 10))
    for k in range(10):
        step = 1e-6 * np.eye(10)[k]
        slopes[:, k] = (parameters(step) - parameters(-step)) / 2e-6
    np.testing.assert_allclose(parameters(deviations), described + slopes @ deviations, atol=1e-8)


def test_moments_that_no_body_has_leave_mass_and_centre() -> None:
    """The weight of a payload counts, although the motion leaves its moments of inertia open."""
    deviation = dict.fromkeys(NAMES, 0.0) | {"link_mass": 2.4, "link_com_z": 0.9}
    with pytest.raises(RobotError):
        changed_link(LINK, deviation)
    found = changed_link(LINK, deviation, nearest=True)
    assert found.mass == pytest.approx(6.8)
    np.testing.assert_allclose(found.com, np.add(LINK.com, [0.0, 0.0, 0.9 / 3.4]))
    same = changed_link(LINK, dict.fromkeys(NAMES, 0.0), nearest=True)
    np.testing.assert_allclose(same.inertia, LINK.inertia, atol=1e-15)
