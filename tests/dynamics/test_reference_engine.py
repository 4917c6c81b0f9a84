"""The derivation against Pinocchio, where every rotor, wave generator and spline is a body on a
joint of its own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_arm.dynamics import Model, build_model
from elastic_arm.robot import Robot, load_robot
from tests.helpers.full_tree import FullTree
from tests.helpers.nightly import nightly
from tests.helpers.random_arms import random_arm

RELATIVE = 1e-9
ARMS = {
    "nominal": lambda: load_robot(),
    "nominal at low ratio": lambda: load_robot().with_ratio(5),
    "random of 7 joints": lambda: random_arm(7, np.random.default_rng(7)),
    "random of 5 joints, three of them prismatic": lambda: random_arm(
        5, np.random.default_rng(8), prismatic=(0, 2, 3)
    ),
}
# Five joints of both kinds show every term that seven show.
LARGE = "random of 7 joints"
CASES = [(arm, bearings) for arm in ARMS for bearings in (False, True) if arm != LARGE]
CASES += nightly([(LARGE, False), (LARGE, True)])


def states(
    dof: int, n: int, rng: np.random.Generator, samples: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states with theta near q and bearings tilted by centiradians, as real ones are, but
    more."""
    x, dx, ddx = rng.uniform(-3.0, 3.0, (3, samples, dof))
    if dof > n:
        x[:, n : 2 * n] = x[:, :n] + rng.normal(0.0, 1e-2, (samples, n))
    x[:, 2 * n :] = rng.normal(0.0, 1e-2, (samples, dof - min(dof, 2 * n)))
    return x, dx, ddx


def relative_error(value: np.ndarray, reference: np.ndarray) -> float:
    """Largest error relative to the sample's largest entry."""
    error = np.abs(value - reference).reshape(len(value), -1).max(axis=1)
    return float((error / np.abs(reference).reshape(len(value), -1).max(axis=1)).max())


def both(robot: Robot, bearings: bool) -> tuple[Model, FullTree]:
    return build_model(robot, "mod3", bearings=bearings), FullTree(robot, bearings=bearings)


@pytest.mark.parametrize(("arm", "bearings"), CASES)
def test_inverse_dynamics_is_that_of_the_full_tree(arm: str, bearings: bool) -> None:
    """mod3 equals Pinocchio's full tree reduced by G, springs included, at random states."""
    model, tree = both(ARMS[arm](), bearings)
    x, dx, ddx = states(model.dof, model.n, np.random.default_rng(1), 100)
    reference = np.array(
        [tree.inverse_dynamics(*sample) for sample in zip(x, dx, ddx, strict=True)]
    )
    assert relative_error(model.inverse_dynamics(x, dx, ddx), reference) < RELATIVE


@pytest.mark.parametrize(("arm", "bearings"), CASES)
def test_every_row_of_the_equation_agrees_on_its_own_scale(arm: str, bearings: bool) -> None:
    """Without springs, whose torques would hide them, each generalized force agrees relative to its
    own range."""
    model, tree = both(ARMS[arm](), bearings)
    no_springs = np.array(
        [0.0 if p.name.rpartition(".")[2][0] in "KD" else p.nominal for p in model.parameters]
    )
    x, dx, ddx = states(model.dof, model.n, np.random.default_rng(2), 100)
    springs = np.array([tree._springs(*sample) for sample in zip(x, dx, strict=True)])
    reference = (
        np.array([tree.inverse_dynamics(*sample) for sample in zip(x, dx, ddx, strict=True)])
        - springs
    )
    error = np.abs(model.inverse_dynamics(x, dx, ddx, no_springs) - reference).max(axis=0)
    # The reference itself loses digits where the springs' forces are taken off again.
    rounding = 4e-16 * np.abs(springs).max(axis=0)
    assert (error < RELATIVE * np.abs(reference).max(axis=0) + rounding).all()


@pytest.mark.parametrize(("arm", "bearings"), CASES)
def test_mass_matrix_is_that_of_the_full_tree(arm: str, bearings: bool) -> None:
    """M, S and B together equal the composite inertia of the full tree reduced by G."""
    model, tree = both(ARMS[arm](), bearings)
    x, _, _ = states(model.dof, model.n, np.random.default_rng(3), 50)
    reference = np.array([tree.mass_matrix(sample) for sample in x])
    assert relative_error(model.mass_matrix(x), reference) < RELATIVE


@pytest.mark.parametrize(("arm", "bearings"), CASES)
def test_energy_is_that_of_the_full_tree(arm: str, bearings: bool) -> None:
    """Kinetic and gravity's energy equal the full tree's."""
    model, tree = both(ARMS[arm](), bearings)
    no_springs = np.array(
        [0.0 if p.name.rpartition(".")[2][0] in "KD" else p.nominal for p in model.parameters]
    )
    x, dx, _ = states(model.dof, model.n, np.random.default_rng(4), 50)
    kinetic, potential = model.energy(x, dx, no_springs)
    reference = np.array([tree.energy(*sample) for sample in zip(x, dx, strict=True)])
    # What stands on the base is at rest: its energy is a constant that the model leaves out.
    resting = reference[:, 1] - potential
    np.testing.assert_allclose(kinetic, reference[:, 0], rtol=RELATIVE)
    np.testing.assert_allclose(resting, resting[0], atol=RELATIVE * np.abs(potential).max())


@pytest.mark.parametrize("prismatic", [(), (1, 4), tuple(range(7))])
def test_an_arm_without_transmissions_is_its_rigid_links(prismatic: tuple[int, ...]) -> None:
    """x = [q] for a robot without transmissions, whichever model is asked for, and Pinocchio
    agrees."""
    robot = random_arm(7, np.random.default_rng(5), elastic=False, prismatic=prismatic)
    tree = FullTree(robot, bearings=False)
    x, dx, ddx = np.random.default_rng(6).normal(size=(3, 50, 7))
    reference = np.array(
        [tree.inverse_dynamics(*sample) for sample in zip(x, dx, ddx, strict=True)]
    )
    for name in ("mod1", "mod2", "mod3"):
        model = build_model(robot, name)
        assert model.coordinates == tuple(f"q_{i}" for i in range(1, 8))
        assert relative_error(model.inverse_dynamics(x, dx, ddx), reference) < RELATIVE


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 3), prismatic=st.sets(st.integers(0, 2)))
def test_any_arm_agrees_with_the_full_tree(seed: int, n: int, prismatic: set[int]) -> None:
    """No arm is special: whatever its axes, inertias, carriers and ratios, the two engines
    agree."""
    rng = np.random.default_rng(seed)
    robot = random_arm(n, rng, prismatic=prismatic)
    model = build_model(robot, "mod3", bearings=True, engine="numpy")
    tree = FullTree(robot, bearings=True)
    x, dx, ddx = states(model.dof, n, rng, 5)
    reference = np.array(
        [tree.inverse_dynamics(*sample) for sample in zip(x, dx, ddx, strict=True)]
    )
    assert relative_error(model.inverse_dynamics(x, dx, ddx), reference) < RELATIVE
