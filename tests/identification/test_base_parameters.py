"""Base parameters: all that the equations see, nothing else, in readable words."""

import numpy as np
import pytest

from elastic_arm.dynamics import Model, build_model
from elastic_arm.identification.base_parameters import find_base
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.robot import load_robot

BOTH = ("q", "theta", "tau_J", "tau_m")


@pytest.fixture(scope="module", params=["mod1", "mod2", "mod3"])
def model(request: pytest.FixtureRequest) -> Model:
    return build_model(load_robot(None), request.param)


def states(model: Model, rng: np.random.Generator, rigid: bool = False) -> list[np.ndarray]:
    x, dx, ddx = rng.standard_normal((3, 50, model.dof))
    if rigid:
        for a in (x, dx, ddx):
            a[:, model.n :] = a[:, : model.n]
    return [x, dx, ddx]


def test_base_parameters_give_the_same_torques_as_all_parameters(model: Model) -> None:
    """Phi Psi = Phi_base T Psi at states the base was not found at."""
    base = BaseRegression(model, BOTH).base
    rng = np.random.default_rng(11)
    phi = model.regressor(*states(model, rng))
    Psi = rng.standard_normal(len(model.Psi))
    whole = phi @ Psi
    assert (
        np.abs(phi[:, :, base.columns] @ (base.T @ Psi) - whole).max() < 1e-9 * np.abs(whole).max()
    )


def test_base_columns_are_independent(model: Model) -> None:
    """The base regressor at random states has full rank, clear of rounding."""
    base = BaseRegression(model, BOTH).base
    phi = model.regressor(*states(model, np.random.default_rng(12)))[:, :, base.columns].reshape(
        -1, len(base)
    )
    values = np.linalg.svd(phi / np.linalg.norm(phi, axis=0), compute_uv=False)
    assert values[-1] > 1e-4 * values[0]


def test_the_full_model_of_the_arm_has_26_base_parameters() -> None:
    """mod3 with locked bearings has rank 26, as an independent count found; K and D are six of
    them."""
    base = BaseRegression(build_model(load_robot(None), "mod3"), BOTH).base
    assert len(base) == 26
    assert sum(name.endswith((".K", ".D")) for name in base.names) == 6


def test_one_encoder_side_sees_fewer_parameters(model: Model) -> None:
    """With theta = q there are no deflections, so K and D drop out and the rest regroups
    exactly."""
    equations = BaseRegression(model, ("theta", "tau_m"))
    base = equations.base
    n = model.n
    assert not any(name.endswith((".K", ".D")) for name in base.names)
    rng = np.random.default_rng(13)
    phi = model.regressor(*states(model, rng, rigid=True))
    whole = phi[:, :n] + phi[:, n:]
    Psi = rng.standard_normal(len(model.Psi))
    torque = whole @ Psi
    assert (
        np.abs(whole[:, :, base.columns] @ (base.T @ Psi) - torque).max()
        < 1e-9 * np.abs(torque).max()
    )


def test_names_are_the_combinations(model: Model) -> None:
    """A name lists exactly the parameters of its row of T, its own first."""
    equations = BaseRegression(model, BOTH)
    base = equations.base
    for name, row, column in zip(base.names, base.T, base.columns, strict=True):
        assert name.startswith(equations.names[column])
        words = {
            word
            for word in name.replace("+", " ").replace("-", " ").split()
            if "." in word and word[0].isalpha()
        }
        assert words == {equations.names[k] for k in np.flatnonzero(row)}


def test_coefficients_are_readable_numbers() -> None:
    """The mass of link 3 enters the inertia of link 2 with the square of its length, written as
    such."""
    base = BaseRegression(build_model(load_robot(None), "mod3"), BOTH).base
    assert any("0.5625 link_3.m" in name for name in base.names)
    assert any(
        "131769 joint_2.rotor.Izz + 14641 joint_2.wave_generator.Izz" in name for name in base.names
    )


def test_a_column_out_of_rounding_is_not_a_parameter() -> None:
    """A column of norm 1e-15, as cos(pi/2) leaves, is neither a base column nor a part of one."""
    rng = np.random.default_rng(14)
    phi = rng.standard_normal((100, 4))
    phi[:, 2] *= 1e-15
    phi[:, 3] = 2.0 * phi[:, 0]
    base = find_base(phi, ["a.Izz", "a.Ixx", "a.mx", "a.m"], ["u"] * 4)
    assert base.columns.tolist() == [0, 1]
    assert base.names == ("a.Izz + 2 a.m", "a.Ixx")
