"""Every benchmark can be started: the names it takes from the package are there."""

import importlib
import pkgutil

import numpy as np
import pytest

import benchmarks
from elastic_arm.effects.arm_equations import ArmEquations
from tests.helpers.random_arms import random_arm

NAMES = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__))


@pytest.mark.parametrize("name", NAMES)
def test_it_can_be_imported_and_has_a_main(name: str) -> None:
    """What it imports exists, so that only its figures can be wrong."""
    assert callable(importlib.import_module(f"benchmarks.{name}").main)


def test_the_plain_fit_is_of_the_arm_under_its_gravity() -> None:
    """Whatever the direction that the arm file has: torques at rest are those of the
    description."""
    pinocchio = pytest.importorskip("pinocchio")
    model = importlib.import_module("benchmarks.compare_identification").rigid_model
    robot = random_arm(3, np.random.default_rng(0), elastic=False).with_(
        gravity=np.array([3.0, -9.0, 1.0])
    )
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (4, 3))
    whole = model(robot)
    torques = [pinocchio.computeGeneralizedGravity(whole, whole.createData(), pose) for pose in q]
    still = np.zeros_like(q)
    _, pull = ArmEquations(robot).moved_and_pulled(q, still, still, motors=False)
    np.testing.assert_allclose(torques, pull @ robot.gravity, atol=1e-9)
