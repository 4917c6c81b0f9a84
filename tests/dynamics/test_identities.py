"""What every derivation must fulfil, whoever wrote it: identities of (1), (8), (9) and (10)."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from elastic_arm.dynamics import Model, build_model
from elastic_arm.errors import RobotError
from elastic_arm.robot import Robot, load_robot
from tests.helpers.random_arms import random_arm

MODELS = ("mod1", "mod2", "mod3")
VARIANTS = [(name, bearings) for name in MODELS for bearings in (False, True)]


def states(model: Model, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states; deflections and tilts small."""
    rng = np.random.default_rng(seed)
    x, dx, ddx = rng.uniform(-2.0, 2.0, (3, samples, model.dof))
    n = model.n
    x[:, n : 2 * n] = x[:, :n] + rng.normal(0.0, 1e-3, (samples, n))
    x[:, 2 * n :] *= 1e-2
    return x, dx, ddx


def without(model: Model, *kinds: str) -> np.ndarray:
    """Nominal Psi in which parameters whose names end so are zero."""
    return np.array(
        [0.0 if p.name.rpartition(".")[2] in kinds else p.nominal for p in model.parameters]
    )


@pytest.mark.parametrize(("name", "bearings"), VARIANTS)
def test_regressor_times_parameters_is_inverse_dynamics(name: str, bearings: bool) -> None:
    """Phi Psi equals the left side of (1) for any Psi, nominal or not."""
    model = build_model(load_robot(), name, bearings=bearings)
    x, dx, ddx = states(model, 200, 1)
    for Psi in (model.Psi, model.Psi * np.random.default_rng(2).normal(size=len(model.Psi))):
        forces = model.inverse_dynamics(x, dx, ddx, Psi)
        np.testing.assert_allclose(
            model.regressor(x, dx, ddx) @ Psi, forces, rtol=0, atol=1e-12 * np.abs(forces).max()
        )


def test_no_samples_give_rows_of_none() -> None:
    """An empty array of samples is no error: the shapes are those of any other."""
    model = build_model(load_robot(), "mod3")
    nothing = np.zeros((0, model.dof))
    assert model.regressor(nothing, nothing, nothing).shape == (0, model.dof, len(model.parameters))
    assert model.inverse_dynamics(nothing, nothing, nothing).shape == (0, model.dof)


@pytest.mark.parametrize(("name", "bearings"), VARIANTS)
def test_inverse_of_forward_is_the_identity(name: str, bearings: bool) -> None:
    """The accelerations under given forces need exactly these forces."""
    model = build_model(load_robot(), name, bearings=bearings)
    x, dx, f = states(model, 200, 3)
    forces = 100.0 * f
    again = model.inverse_dynamics(x, dx, model.forward_dynamics(x, dx, forces))
    scale = np.abs(model.bias(x, dx)).max()
    np.testing.assert_allclose(again, forces, rtol=0, atol=1e-12 * scale)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_forward_of_inverse_is_the_identity_for_any_arm(seed: int) -> None:
    """Forces of a motion bring about its accelerations, also where they are all-zero or fast."""
    rng = np.random.default_rng(seed)
    model = build_model(random_arm(int(rng.integers(1, 3)), rng), "mod3", engine="numpy")
    x, dx, ddx = states(model, 3, seed)
    back = model.forward_dynamics(x, dx, model.inverse_dynamics(x, dx, ddx))
    conditioning = np.linalg.cond(model.mass_matrix(x)).max()
    scale = np.abs(model.bias(x, dx)).max() / np.linalg.eigvalsh(model.mass_matrix(x)).min()
    np.testing.assert_allclose(back, ddx, rtol=0, atol=1e-13 * conditioning + 1e-13 * scale)


@pytest.mark.parametrize(("name", "bearings"), VARIANTS)
def test_mass_matrix_is_symmetric_and_positive_definite(name: str, bearings: bool) -> None:
    """Kinetic energy is positive whenever anything moves, and half of dx M dx."""
    model = build_model(load_robot(), name, bearings=bearings)
    x, dx, _ = states(model, 100, 4)
    M = model.mass_matrix(x)
    np.testing.assert_array_equal(M, M.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(M).min() > 0.0
    kinetic, _ = model.energy(x, dx)
    np.testing.assert_allclose(0.5 * np.einsum("ni,nij,nj->n", dx, M, dx), kinetic, rtol=1e-10)


@pytest.mark.parametrize("bearings", [False, True])
def test_coriolis_terms_are_those_of_the_mass_matrix_and_leave_M_dot_minus_2C_skew(
    bearings: bool,
) -> None:
    """c + c1 and c2 equal C dx with C of Christoffel's symbols of M, so that M' - 2C is
    skew-symmetric."""
    model = build_model(load_robot(), "mod3", bearings=bearings)
    x = ca.SX.sym("x", model.dof)
    dx = ca.SX.sym("dx", model.dof)
    M = model.function("mass_matrix")(x, model.Psi)
    by_coordinate = [ca.reshape(ca.jacobian(ca.vec(M), x[k]), M.shape) for k in range(model.dof)]
    M_dot = sum((by_coordinate[k] * dx[k] for k in range(model.dof)), ca.SX.zeros(*M.shape))
    # C = (M' + A - AT) / 2 with A_ij = sum_k dM_ik / dx_j dx_k
    A = ca.horzcat(*(by_coordinate[j] @ dx for j in range(model.dof)))
    christoffel = ca.Function("C", [x, dx], [0.5 * (M_dot + A - A.T), M_dot])
    states_x, states_dx, _ = states(model, 20, 5)
    terms = model.terms(states_x, states_dx)
    for k, (sample_x, sample_dx) in enumerate(zip(states_x, states_dx, strict=True)):
        C, rate = (np.array(m) for m in christoffel(sample_x, sample_dx))
        expected = np.empty(model.dof)
        expected[list(model.bodies.link_side)] = terms["c"][k] + terms["c1"][k]
        expected[list(model.bodies.motor_side)] = terms["c2"][k]
        np.testing.assert_allclose(
            C @ sample_dx, expected, rtol=0, atol=1e-10 * np.abs(expected).max()
        )
        skew = rate - 2.0 * C
        np.testing.assert_allclose(skew, -skew.T, rtol=0, atol=1e-12 * max(np.abs(C).max(), 1.0))


@pytest.mark.parametrize("name", MODELS)
def test_power_put_in_is_energy_gained(name: str) -> None:
    """dx f equals the rate of kinetic and potential energy where nothing is damped."""
    model = build_model(load_robot(), name, bearings=True)
    Psi = without(model, "D", "D_b")
    x, dx, ddx = states(model, 50, 6)
    power = (dx * model.inverse_dynamics(x, dx, ddx, Psi)).sum(axis=1)
    step = 1e-5

    def total(t: float) -> np.ndarray:
        return np.add(*model.energy(x + t * dx + 0.5 * t * t * ddx, dx + t * ddx, Psi))

    # Fourth-order central difference.
    rate = (8 * (total(step) - total(-step)) - (total(2 * step) - total(-2 * step))) / (12 * step)
    np.testing.assert_allclose(rate, power, rtol=0, atol=1e-7 * np.abs(power).max())


@pytest.mark.parametrize(("name", "bearings"), [("mod3", False), ("mod2", False), ("mod3", True)])
def test_energy_is_conserved_without_damping_and_input(name: str, bearings: bool) -> None:
    """An arm that swings freely keeps its energy, however stiff its joints are."""
    # Soft springs let a tight integrator end soon; the equations are the same.
    model = build_model(load_robot(), name, bearings=bearings)
    Psi = without(model, "D", "D_b")
    for k, parameter in enumerate(model.parameters):
        if parameter.name.endswith((".K", ".K_b")):
            Psi[k] = 2000.0
    x, dx, _ = states(model, 1, 7)
    dof = model.dof

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        ddx = model.forward_dynamics(state[None, :dof], state[None, dof:], np.zeros((1, dof)), Psi)
        return np.concatenate([state[dof:], ddx[0]])

    run = solve_ivp(
        rates, (0.0, 0.5), np.concatenate([x[0], dx[0]]), method="DOP853", rtol=1e-12, atol=1e-12
    )
    kinetic, potential = model.energy(run.y[:dof].T, run.y[dof:].T, Psi)
    total = kinetic + potential
    assert np.ptp(kinetic) > 0.01 * kinetic.max()
    np.testing.assert_allclose(
        total, total[0], rtol=0, atol=1e-9 * (kinetic.max() + np.ptp(potential))
    )


@pytest.mark.parametrize("bearings", [False, True])
def test_mod3_without_S_is_mod2(bearings: bool) -> None:
    """With S, c1 and c2 taken away, mod3's terms are mod2's, and mod2 has none of them."""
    coupled, simple = (
        build_model(load_robot(), name, bearings=bearings) for name in ("mod3", "mod2")
    )
    x, dx, _ = states(coupled, 50, 8)
    terms = coupled.terms(x, dx)
    plain = simple.terms(x, dx)
    assert np.abs(terms["S"]).max() > 0.1
    for name in ("M", "B", "c", "g"):
        np.testing.assert_allclose(
            terms[name], plain[name], rtol=0, atol=1e-12 * np.abs(plain[name]).max()
        )
    for name in ("S", "c1", "c2"):
        assert not plain[name].any()


def test_mod1_moves_the_spline_from_B_to_M() -> None:
    """B of mod1 lacks I_spl of (7), and the link's side has gained the spline that link drives."""
    simple, folded = (build_model(load_robot(), name) for name in ("mod2", "mod1"))
    x, dx, _ = states(simple, 20, 9)
    B2, B1 = (model.terms(x, dx)["B"] for model in (simple, folded))
    splines = [joint.transmission.spline.izz for joint in load_robot().joints]
    np.testing.assert_allclose(
        B2 - B1, np.broadcast_to(np.diag(splines), B2.shape), rtol=0, atol=1e-12
    )
    # Joint 3's own entry of M: its spline now turns with q_3.
    gained = (folded.terms(x, dx)["M"] - simple.terms(x, dx)["M"])[:, 2, 2]
    np.testing.assert_allclose(gained, splines[2], rtol=1e-9)


def test_B_is_the_reflected_inertia_of_7() -> None:
    """B is diagonal and constant: I_spl + I_wg r_hd^2 + I_r r_b^2 r_hd^2."""
    robot = load_robot()
    model = build_model(robot, "mod3")
    x, dx, _ = states(model, 20, 10)
    expected = [
        t.spline.izz + t.wave_generator.izz * t.harmonic_drive_ratio**2 + t.rotor.izz * t.r_tot**2
        for t in (joint.transmission for joint in robot.joints)
    ]
    np.testing.assert_allclose(
        model.terms(x, dx)["B"], np.broadcast_to(np.diag(expected), (20, 3, 3)), rtol=1e-12
    )


def test_S_has_the_pattern_of_8_and_the_values_of_9() -> None:
    """S_11 = I_r r_b r_hd of rotor 1 on link 1; S_23 sums transmission 3's components; what (8)
    prints as 0 is null.

    S_12 of (8) is null too: joint 1 turns after it tilts, so axis 2 stays perpendicular to its own
    turn.
    """
    robot = load_robot()
    model = build_model(robot, "mod3", bearings=True)
    x, dx, _ = states(model, 50, 11)
    S = model.terms(x, dx)["S"][:, :3]
    pattern = np.abs(S).max(axis=0) > 0.0
    np.testing.assert_array_equal(
        pattern, [[True, False, True], [False, False, True], [False, False, False]]
    )
    # S_23's coefficient is cos of the angle between axes 2 and 3: one while nothing tilts.
    x[:, 6:] = 0.0
    S = model.terms(x, dx)["S"][:, :3]
    third = robot.joints[2].transmission
    S_23 = (
        third.spline.izz
        + third.wave_generator.izz * third.harmonic_drive_ratio
        + third.rotor.izz * third.r_tot
    )
    np.testing.assert_allclose(S[:, 0, 0], 0.4356, rtol=1e-12)
    np.testing.assert_allclose(S[:, 1, 2], S_23, rtol=1e-12)
    assert pytest.approx(0.185, abs=5e-4) == S_23


def test_S_13_vanishes_until_the_bearings_tilt() -> None:
    """Axis 1 is perpendicular to axes 2 and 3: no coupling with zero tilt; joint 2's tilts bring a
    pose-dependent S_13.

    Transmission 2 then couples with the tilts of joint 1, which turn link 1 about other axes than
    q_1 does.
    """
    model = build_model(load_robot(), "mod3", bearings=True)
    x, dx, _ = states(model, 50, 12)
    tilted = model.terms(x, dx)["S"]
    x[:, 6:] = 0.0
    upright = model.terms(x, dx)["S"]
    assert not upright[:, 0, 1:].any()
    assert np.ptp(tilted[:, 0, 2]) > 1e-3
    q_1x = 3
    q_1y = 6
    assert np.abs(tilted[:, [q_1x, q_1y], 1]).max() > 0.1


def test_gyroscopic_terms_act_on_the_tilts_alone() -> None:
    """With the axes of Table I and upright bearings, c1 moves no q, and c2 is null."""
    model = build_model(load_robot(), "mod3", bearings=True)
    x, dx, _ = states(model, 50, 13)
    x[:, 6:] = 0.0
    dx[:, 6:] = 0.0
    terms = model.terms(x, dx)
    np.testing.assert_allclose(terms["c1"][:, :3], 0.0, atol=1e-12)
    np.testing.assert_allclose(terms["c2"], 0.0, atol=1e-12)
    assert np.abs(terms["c1"][:, 3:]).max() > 1.0


def test_terms_put_together_are_inverse_dynamics() -> None:
    """M, S, B, c, c1, c2, g and the springs of (1) make up the left side."""
    model = build_model(load_robot(), "mod3")
    x, dx, ddx = states(model, 50, 14)
    t = model.terms(x, dx)
    n = model.n
    (q, theta), (dq, dtheta), (ddq, ddtheta) = ((v[:, :n], v[:, n:]) for v in (x, dx, ddx))
    K, D = (
        np.array([getattr(j.transmission, what) for j in model.robot.joints])
        for what in ("stiffness", "damping")
    )
    elastic = K * (theta - q) + D * (dtheta - dq)
    link = np.einsum("nij,nj->ni", t["M"], ddq) + np.einsum("nij,nj->ni", t["S"], ddtheta)
    motor = np.einsum("nji,nj->ni", t["S"], ddq) + np.einsum("nij,nj->ni", t["B"], ddtheta)
    expected = np.hstack([link + t["c"] + t["c1"] + t["g"] - elastic, motor + t["c2"] + elastic])
    np.testing.assert_allclose(
        model.inverse_dynamics(x, dx, ddx), expected, rtol=0, atol=1e-12 * np.abs(expected).max()
    )


def test_right_angles_leave_no_false_base_column() -> None:
    """cos(pi/2) is zero: no column of Phi is tiny but not null."""
    model = build_model(load_robot(), "mod3")
    norms = np.linalg.norm(np.vstack(model.regressor(*states(model, 200, 15))), axis=0)
    assert not ((norms > 0.0) & (norms < 1e-3)).any()


def test_parameters_are_named_with_units() -> None:
    """Psi lists links, components of revolution, K and D by name; the links' masses are among
    them."""
    model = build_model(load_robot(), "mod3", bearings=True)
    by_name = {p.name: p for p in model.parameters}
    assert len(by_name) == len(model.Psi) == 3 * 10 + 9 * 4 + 6 + 6
    assert by_name["link_2.m"].nominal == 34.0 and by_name["link_2.m"].unit == "kg"
    assert (
        by_name["joint_1.rotor.Izz"].nominal == 1.2e-3
        and by_name["joint_1.rotor.Izz"].unit == "kg m^2"
    )
    assert by_name["joint_3.K"].nominal == 45000.0 and by_name["joint_3.K"].unit == "Nm/rad"
    assert by_name["joint_3.K_b"].nominal == 1e6


def test_unknown_models_and_missing_bearings_are_refused() -> None:
    """The error names the model or joint, and the remedy."""
    robot = load_robot()
    with pytest.raises(RobotError, match=r"unknown model 'mod4'.*mod1, mod2, mod3"):
        build_model(robot, "mod4")
    with pytest.raises(RobotError, match="joint_1 has no bearing"):
        build_model(bearingless(robot), "mod3", bearings=True)


def bearingless(robot: Robot) -> Robot:
    from dataclasses import replace

    joints = [replace(j, transmission=replace(j.transmission, bearing=None)) for j in robot.joints]
    return robot.with_(joints=tuple(joints))
