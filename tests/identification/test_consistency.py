"""Physically consistent parameters: possible bodies, true to the data, close to the nominal
elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.dynamics.bodies import pseudo_inertia
from elastic_arm.errors import IdentificationError, RobotError
from elastic_arm.identification import (
    Identification,
    IdentificationSettings,
    identifier_of,
    identify,
    identify_with,
    parse_laws,
)
from elastic_arm.identification import consistent as module
from elastic_arm.identification.consistent import (
    consistent,
    correlation_of_errors,
    identified_robot,
    odd_masses,
)
from elastic_arm.identification.verdict import remarks
from elastic_arm.recording import Recording, Side
from elastic_arm.robot import Inertia, Robot, load_robot, parse_urdf, to_urdf
from tests.helpers.periodic_arm import derivative, link_motion, record, recording_of
from tests.helpers.random_arms import random_arm


def mistaken(robot: Robot) -> Robot:
    """The arm as a description that is wrong everywhere."""
    for joint in robot.joints:
        t = joint.transmission
        link = replace(
            joint.link, mass=1.1 * joint.link.mass, inertia=1.2 * np.array(joint.link.inertia)
        )
        rotor = replace(t.rotor, ixx=0.9 * t.rotor.ixx, izz=0.9 * t.rotor.izz)
        changed = replace(t, stiffness=0.8 * t.stiffness, damping=1.5 * t.damping, rotor=rotor)
        robot = robot.with_joint(joint.name, link=link, transmission=changed)
    return robot


@pytest.fixture(scope="module")
def true_robot() -> Robot:
    return load_robot(None)


@pytest.fixture(scope="module")
def result(true_robot: Robot) -> Identification:
    model = build_model(true_robot, "mod3")
    samples = record(model, np.random.default_rng(1), encoder_noise=1e-6, velocity_noise=1e-4)
    other = record(model, np.random.default_rng(2), encoder_noise=1e-6, velocity_noise=1e-4)
    return identify(
        recording_of(samples, true_robot),
        mistaken(true_robot),
        IdentificationSettings(),
        validate=[recording_of(other, true_robot, "other")],
    )


def bodies(result: Identification, robot: Robot) -> list[np.ndarray]:
    model = build_model(robot, result.model)
    return [result.Psi[list(b.parameters)] for b in model.bodies.bodies if len(b.parameters) == 10]


def test_every_body_is_physically_possible(result: Identification, true_robot: Robot) -> None:
    """All pseudo-inertias are positive definite, all masses, stiffnesses and dampings positive."""
    for ten in bodies(result, true_robot):
        assert np.linalg.eigvalsh(pseudo_inertia(ten))[0] > 0
    named = dict(zip(result.parameter_names, result.Psi, strict=True))
    assert all(
        value > 0
        for name, value in named.items()
        if name.endswith((".m", ".K", ".D", ".Ixx", ".Izz"))
    )


def test_consistent_arm_predicts_as_well_as_the_free_fit(result: Identification) -> None:
    """On a motion no fit has seen the consistent arm leaves at most 10 % more than the base
    parameters."""
    found = result.validation["other"]
    for side, by_joint in found["identified"].items():
        for joint, left in by_joint.items():
            assert found["consistent"][side][joint] < 1.1 * left + 0.01
            assert found["nominal"][side][joint] > 20 * left


def test_stiffness_and_motor_inertia_come_out_to_a_thousandth(
    result: Identification, true_robot: Robot
) -> None:
    """From a nominal 20 % off, K is found to 0.1 %, and the inertia of joint 2's motor side to 0.1
    %."""
    for joint in result.identified.joints:
        true = true_robot.joints[
            result.identified.joint_names.index(joint.name)
        ].transmission.stiffness
        assert joint.transmission.stiffness == pytest.approx(true, rel=1e-3)
    inertia = [
        sum(
            ratio**2 * solid.izz
            for solid, ratio in robot.joints[1].transmission.components.values()
        )
        for robot in (result.identified, true_robot)
    ]
    assert inertia[0] == pytest.approx(inertia[1], rel=1e-3)


def test_errors_count_as_alike_over_half_a_period_only_where_the_motion_repeats(
    true_robot: Robot,
) -> None:
    """Blocks show how far sensors' noise is correlated; where the motion repeats, so may what the
    model misses."""
    samples = record(
        build_model(true_robot, "mod3"),
        np.random.default_rng(1),
        encoder_noise=1e-6,
        velocity_noise=1e-4,
    )
    recording = recording_of(samples, true_robot)
    _, identifier, *_ = identify_with(
        recording, true_robot, IdentificationSettings(consistent=False)
    )
    half_period = identifier.fit().samples / identifier.statistics.effective_samples
    assert correlation_of_errors(identifier, repeats=True) == half_period
    assert correlation_of_errors(identifier, repeats=False) < 0.4 * half_period


def of_rigid_arm(described: Robot, harmonics: int, trembles: float | None = None) -> Recording:
    """Return 20 s of a rigid arm with friction; of joint 1 held with a tremble of 20 Hz, rad, if it
    is said."""
    rate = 500.0
    rng = np.random.default_rng(1)
    t = np.arange(10_000) / 500.0
    q = link_motion(described.n, t, 20.0, harmonics, rng)
    if trembles is not None:
        q[:, 0] = trembles * np.sin(2 * np.pi * 20.0 * t)
    dq = derivative(q, 1, rate)
    torque = (
        build_model(described).inverse_dynamics(q, dq, derivative(q, 2, rate))
        + 5.0 * np.tanh(dq / 1e-3)
        + 3.0 * dq
    )
    read = q + 1e-7 * rng.standard_normal(q.shape)
    motor = Side(
        np.rint(t * 1e9).astype(np.int64), read, None, torque + 0.3 * rng.standard_normal(q.shape)
    )
    return Recording(described.joint_names, motor=motor, source="test")


@pytest.mark.parametrize(("harmonics", "trembles", "least"), [(10, 1e-5, 5.0), (100, None, 1.0)])
def test_errors_of_averages_count_as_white_ones_at_least(
    true_robot: Robot, harmonics: int, trembles: float | None, least: float
) -> None:
    """What friction leaves follows the joints that move, not one that trembles; fewer averages than
    half periods."""
    rigid = parse_urdf(to_urdf(true_robot))
    settings = IdentificationSettings(consistent=False)
    _, identifier, *_ = identify_with(of_rigid_arm(rigid, harmonics, trembles), rigid, settings)
    assert correlation_of_errors(identifier, repeats=False) >= least
    assert correlation_of_errors(identifier, repeats=True) >= least


def test_saved_arm_loads_and_predicts_the_same(
    result: Identification, true_robot: Robot, tmp_path: Path
) -> None:
    """The arm file of the identified arm gives the torques of the identified parameters."""
    result.save_robot(tmp_path / "arm.yaml")
    loaded = build_model(load_robot(tmp_path / "arm.yaml"), "mod3")
    x, dx, ddx = np.random.default_rng(3).standard_normal((3, 20, loaded.dof))
    expected = build_model(true_robot, "mod3").inverse_dynamics(x, dx, ddx, result.Psi)
    assert (
        np.abs(loaded.inverse_dynamics(x, dx, ddx) - expected).max() < 1e-6 * np.abs(expected).max()
    )


def test_identified_laws_become_effects_of_the_arm(true_robot: Robot) -> None:
    """A law identified beside the model is written into the arm as an effect with its value."""
    laws = parse_laws(["viscous_friction:joint_2"], true_robot)
    identifier = identifier_of(true_robot, "mod3", laws)
    identifier.add(
        record(identifier.model, np.random.default_rng(4), encoder_noise=1e-6, velocity_noise=1e-4)
    )
    found = consistent(identifier.fit(), identifier.equations, trust=0.1)
    arm = identified_robot(true_robot, identifier.equations, found.Psi, laws)
    assert [(e["effect"], e["joint"]) for e in arm.effects] == [("viscous_friction", "joint_2")]
    assert arm.effects[0]["parameters"]["coefficient"] == pytest.approx(found.Psi[-1])


def test_no_identified_friction_drives(true_robot: Robot) -> None:
    """Friction that a recording puts below zero, as where the model lacks something, is none in the
    arm."""
    laws = parse_laws(["viscous_friction:joint_2"], true_robot)
    identifier = identifier_of(true_robot, "mod3", laws)
    identifier.add(
        record(identifier.model, np.random.default_rng(4), encoder_noise=1e-6, velocity_noise=1e-4)
    )
    fit = identifier.fit()
    column = identifier.equations.base.names.index("viscous_friction:joint_2.coefficient")
    below = np.where(np.arange(len(fit.Psi)) == column, -5.0, fit.Psi)
    factor = fit.factor.copy()
    factor[:-1, -1] = factor[:-1, :-1] @ below
    found = consistent(replace(fit, Psi=below, factor=factor), identifier.equations, trust=0.1)
    assert found.Psi[-1] == pytest.approx(0.0, abs=1e-3)


def test_only_what_is_surely_below_zero_speaks_against_the_model(true_robot: Robot) -> None:
    """Friction of zero but for its uncertainty, tried where there is none, is no sign of a wrong
    model."""
    laws = parse_laws(["viscous_friction:joint_2"], true_robot)
    identifier = identifier_of(true_robot, "mod3", laws)
    identifier.add(
        record(identifier.model, np.random.default_rng(4), encoder_noise=1e-6, velocity_noise=1e-4)
    )
    fit = identifier.fit()
    equations = identifier.equations
    column = equations.base.names.index("viscous_friction:joint_2.coefficient")
    for deviations, named in ((1.0, False), (10.0, True)):
        below = np.where(np.arange(len(fit.Psi)) == column, -deviations * fit.std[column], fit.Psi)
        words = " ".join(remarks(replace(fit, Psi=below), equations))
        assert ("viscous_friction:joint_2.coefficient: negative" in words) == named


def test_what_the_data_do_not_say_stays_with_the_nominal(true_robot: Robot) -> None:
    """The mass of link 1, which turns about a vertical axis and enters no equation, stays as
    described."""
    identifier = identifier_of(true_robot)
    identifier.add(
        record(identifier.model, np.random.default_rng(4), encoder_noise=1e-6, velocity_noise=1e-4)
    )
    found = consistent(identifier.fit(), identifier.equations)
    named = dict(zip(identifier.equations.names, found.Psi, strict=True))
    assert named["link_1.m"] == pytest.approx(true_robot.joints[0].link.mass, rel=0.05)


def test_links_with_masses_that_no_such_link_has_are_named() -> None:
    """Far too heavy or too light, with both masses; ordinary errors and links that weigh next to
    nothing are not."""
    robot = random_arm(4, np.random.default_rng(0), elastic=False)

    def with_masses(*masses: float) -> Robot:
        joints = zip(robot.joints, masses, strict=True)
        return robot.with_(
            joints=tuple(replace(j, link=replace(j.link, mass=m)) for j, m in joints)
        )

    described = with_masses(4.0, 4.0, 3.0, 0.01)
    assert odd_masses(described, with_masses(10.0, 1.0, 3.0, 0.1)) == []
    (words,) = odd_masses(described, with_masses(4.0, 124.0, 0.2, 0.1))
    heavy, light = robot.link_names[1:3]
    assert f"{heavy} has 124 kg (4 kg described), {light} has 0.2 kg (3 kg described): " in words
    first = replace(robot.joints[0], link=Inertia(0.0, np.zeros(3), np.zeros((3, 3))))
    bare = described.with_(joints=(first, *described.joints[1:]))
    assert odd_masses(bare, described) == []


def test_a_solution_that_is_no_body_is_a_note(
    monkeypatch: pytest.MonkeyPatch, true_robot: Robot
) -> None:
    """The base parameters are there, whatever becomes of the arm that is made of them."""

    def refusing(*_: object) -> Robot:
        raise RobotError("inertia violates the triangle inequality", "Check it")

    monkeypatch.setattr(module, "identified_robot", refusing)
    samples = record(build_model(true_robot, "mod3"), np.random.default_rng(1), encoder_noise=1e-6)
    found = identify(recording_of(samples, true_robot), true_robot)
    assert found.identified is None
    assert "no physically consistent arm: inertia violates the triangle inequality" in found.notes
    assert np.isfinite(found.Psi_base).all()


def test_a_description_that_hides_the_stiffness_is_refused(true_robot: Robot) -> None:
    """Its columns vanish in the rounding of much larger ones."""
    samples = record(build_model(true_robot, "mod3"), np.random.default_rng(1))
    far = true_robot
    for joint in far.joints:
        stages = replace(joint.transmission, belt_ratio=1e4, harmonic_drive_ratio=1e4)
        far = far.with_joint(joint.name, transmission=stages)
    with pytest.raises(
        IdentificationError, match=r"joint_1\.K is lost numerically next to much larger numbers"
    ):
        identify(recording_of(samples, true_robot), far)
