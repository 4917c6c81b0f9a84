"""Ordinary imperfections that nobody asks for: zeros of torques, a base off level."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.identification import Identification, IdentificationSettings, identify, parse_laws
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.batch.identify import FELT
from elastic_arm.identification.batch.imperfections import (
    LEVEL,
    ZERO,
    NuisanceLaw,
    possible_imperfections,
    told_apart,
)
from elastic_arm.identification.batch.mounting import turned
from elastic_arm.identification.law_columns import law_columns, on_recorded_side
from elastic_arm.identification.regularisation import law_sizes, prior_of
from elastic_arm.identification.stream import Identifier
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.motions import trajectory
from tests.helpers.random_arms import random_arm

FRICTION = ("viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return random_arm(4, np.random.default_rng(2), elastic=False)


def recorded(robot: Robot, effects: list[EffectInstance], seed: int = 3) -> Recording:
    settings = SimulationSettings(effects=effects)
    return simulate(robot, trajectory(seed, robot.n), settings, rng=np.random.default_rng(seed))


def identified(
    robot: Robot, recordings: list[Recording], validate: list[Recording]
) -> Identification:
    settings = IdentificationSettings(effects=parse_laws(FRICTION, robot))
    return identify(recordings, robot, settings, validate=validate)


def test_a_base_off_level_is_identified_though_nobody_asked(robot: Robot) -> None:
    """A tilt of 25 mrad comes out within four deviations of each component, and robot.yaml has
    it."""
    tilt = EffectInstance(EFFECTS[TILT], None, {"x": 0.02, "y": -0.015})
    found = identified(robot, [recorded(robot, [tilt])], [recorded(robot, [tilt], 4)])
    sizes = {e.name.rpartition(".")[2]: e for e in found.estimates if e.name.startswith(TILT)}
    for name, true in (("x", 0.02), ("y", -0.015)):
        assert abs(sizes[name].value - true) < 4 * sizes[name].std < 0.02
    assert any("also identified, as they differ" in note and TILT in note for note in found.notes)
    assert found.identified is not None
    assert TILT in {entry["effect"] for entry in found.identified.effects}


def test_what_a_short_recording_does_not_show_is_held_to_what_is_ordinary(robot: Robot) -> None:
    """Level, with right zeros: none is called shown, and each stays within what is ordinary."""
    whole = recorded(robot, [])
    samples = whole.samples()
    recording = whole.between(0.0, 1.5)
    found = identified(robot, [recording], [])
    sizes = {e.name: e.value for e in found.estimates}
    torque = np.sqrt(np.mean(samples.tau_m**2, axis=0))
    held = [name for name in sizes if name.startswith(("motor_torque_offset", TILT))]
    assert held
    for joint, size in zip(robot.joint_names, torque, strict=True):
        assert abs(sizes.get(f"motor_torque_offset:{joint}.offset", 0.0)) < 2 * ZERO * size
    assert all(abs(sizes.get(f"{TILT}:{robot.name}.{axis}", 0.0)) < 2 * LEVEL for axis in "xy")
    assert not any("as they differ from zero" in note for note in found.notes)
    assert any("constrained to their usual size" in note for note in found.notes)


def test_what_the_recordings_show_to_be_none_is_left_out(robot: Robot) -> None:
    """A long recording of a level arm with right zeros needs no parameters for them."""
    found = identified(robot, [recorded(robot, [])], [])
    assert not any(e.name.startswith(("motor_torque_offset", TILT)) for e in found.estimates)


def test_nothing_is_identified_beside_the_model_alone(robot: Robot) -> None:
    """Without laws beyond the model there are no imperfections."""
    found = identify(recorded(robot, []), robot, IdentificationSettings(consistent=False))
    assert not any(":" in estimate.name for estimate in found.estimates)


def test_a_tilt_that_another_parameter_can_stand_for_is_left_out() -> None:
    """About a horizontal first axis a tilt is the same as another centre of mass."""
    lone = random_arm(1, np.random.default_rng(1), elastic=False)
    turned = np.eye(4)
    turned[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    lone = lone.with_(base_placement=turned, base_dh=None)
    samples = recorded(random_arm(1, np.random.default_rng(1), elastic=False), []).samples()
    asked = parse_laws(["viscous_friction"], lone)
    possible = possible_imperfections([samples], lone, asked)
    assert [each.place[0] for each in possible] == ["motor_torque_offset", TILT]
    columns = law_columns([*asked, *(each.instance for each in possible)], lone)
    equations = Identifier(
        build_model(lone, "mod3"), columns, joints=lone.joint_names
    ).choose_equations(samples)
    assert [each.place[0] for each in told_apart(possible, equations)] == ["motor_torque_offset"]


def test_what_was_asked_for_is_no_imperfection(robot: Robot) -> None:
    """Neither a zero at its joint nor a tilt is taken twice."""
    samples = recorded(robot, []).samples()
    asked = parse_laws([f"motor_torque_offset:{robot.joint_names[1]}", TILT], robot)
    joints = [each.place[1] for each in possible_imperfections([samples], robot, asked)]
    assert joints == [robot.joint_names[k] for k in (0, 2, 3)]


def test_the_prior_of_what_is_ordinary_weighs_as_the_errors_last(robot: Robot) -> None:
    """Where errors are a hundred times more than white ones in variance, so is the prior's
    information.

    The deviations count its own errors all the same.
    """
    samples = recorded(robot, []).samples()
    (zero,) = parse_laws([f"motor_torque_offset:{robot.joint_names[0]}"], robot)
    (column,) = law_columns([zero], robot)
    held = NuisanceLaw(zero, 0.5)
    columns = [replace(column, ordinary=held.ordinary)]
    identifier = Identifier(build_model(robot, "mod3"), columns, joints=robot.joint_names)
    identifier.add(samples)
    identifier.finish()
    equations: BaseRegression = identifier.equations
    place = equations.base.names.index(column.name)
    sizes = law_sizes(identifier.linear_blocks(), equations)
    assert sizes[place] == 0.5
    white, coloured = (prior_of(equations, np.inf, laws=sizes, correlated=c) for c in (1.0, 100.0))
    assert white.factor[place, place] == pytest.approx(2.0) and coloured.factor[
        place, place
    ] == pytest.approx(20.0)
    assert np.asarray(coloured.excess)[place] == pytest.approx(10.0)


def test_a_rigid_arm_has_one_side(robot: Robot) -> None:
    """Friction is felt by joint torque sensors where they alone are recorded, and not asked for
    twice."""
    laws = parse_laws(["coulomb_friction", "coulomb_friction:side=link"], robot)
    felt, moved = on_recorded_side(laws, robot, motored=False)
    assert {instance.sides for instance in felt} == {("link",)} and len(felt) == robot.n
    assert moved == ["coulomb_friction"]
    assert on_recorded_side(laws, robot, motored=True) == (tuple(laws), [])
    curves = parse_laws(
        [f"stribeck_friction:speed={speed},side=link" for speed in (0.05, 0.5)], robot
    )
    assert on_recorded_side(curves, robot, motored=False) == (tuple(curves), [])


@pytest.mark.nightly
def test_what_an_identification_adds_is_no_law_of_the_next_one(robot: Robot) -> None:
    """Its robot.yaml is identified anew with other channels, and zeros are held about what it
    states."""
    tilt = EffectInstance(EFFECTS[TILT], None, {"x": 0.02, "y": -0.015})
    whole = recorded(robot, [tilt])
    torques = whole.samples().tau_m + np.array([5.0, 0.0, 0.0, 0.0])
    felt = Recording(
        robot.joint_names, link=replace(whole.link, effort=torques), motor=None, source="sensors"
    )
    first = identified(robot, [felt], [])
    assert any(FELT in note for note in first.notes)
    assert first.identified is not None
    stated = {entry["effect"] for entry in first.identified.effects}
    assert {"joint_torque_offset", TILT} <= stated
    second = identified(first.identified, [whole], [])
    assert not any(estimate.name.startswith("joint_torque_offset") for estimate in second.estimates)
    again = identified(first.identified, [felt], [])
    (zero,) = (
        e
        for e in again.estimates
        if e.name.startswith(f"joint_torque_offset:{robot.joint_names[0]}.")
    )
    assert zero.value == pytest.approx(5.0, abs=4 * zero.std) and zero.nominal == pytest.approx(
        5.0, abs=0.5
    )


def test_a_channel_that_holds_nothing_has_no_zero(robot: Robot) -> None:
    """A torque that is zero throughout is none of a sensor that is off."""
    samples = recorded(robot, []).samples()
    torques = samples.tau_m.copy()
    torques[:, 1] = 0.0
    possible = possible_imperfections(
        [replace(samples, tau_m=torques)], robot, parse_laws(FRICTION, robot)
    )
    assert [each.place[1] for each in possible] == [robot.joint_names[k] for k in (0, 2, 3)] + [
        None
    ]


@pytest.mark.nightly
def test_a_tilt_of_which_one_component_shows_is_identified(robot: Robot) -> None:
    """Of an arm on a wall a turn about the vertical leaves no trace; the other one comes out."""
    wall = robot.with_(gravity=np.array([9.81, 0.0, 0.0]))
    tilt = EffectInstance(EFFECTS[TILT], None, {"x": 0.0, "y": 0.04})
    found = identified(wall, [recorded(wall, [tilt])], [])
    (y,) = (e for e in found.estimates if e.name.startswith(TILT))
    assert y.name.endswith(".y") and abs(y.value - 0.04) < 4 * y.std < 0.02


def test_the_prior_of_the_description_is_kept_where_a_zero_is_part_of_a_base_parameter() -> None:
    """Of a vertical sliding axis a zero and a mass are one base parameter: the mass keeps its
    prior."""
    slide = random_arm(2, np.random.default_rng(1), elastic=False, prismatic=[0]).with_armatures()
    samples = recorded(slide, []).samples()
    possible = possible_imperfections([samples], slide, parse_laws(["viscous_friction"], slide))
    zeros = [
        replace(c, ordinary=0.5)
        for c in law_columns([e.instance for e in possible if e.place[0] != TILT], slide)
    ]
    identifier = Identifier(build_model(slide, "mod3"), zeros, joints=slide.joint_names)
    identifier.add(samples)
    identifier.finish()
    equations = identifier.equations
    mixed = [":" in name and "link_" in name for name in equations.base.names]
    sizes = law_sizes(identifier.linear_blocks(), equations)
    assert any(mixed) and np.isnan(sizes[mixed]).all()
    own = np.isnan(sizes)
    with_laws, without = (prior_of(equations, 0.1, laws=laws).factor for laws in (sizes, None))
    np.testing.assert_array_equal(with_laws[np.ix_(own, own)], without[np.ix_(own, own)])


@pytest.mark.nightly
def test_an_arm_mounted_otherwise_has_no_zeros_that_nobody_asked_for(robot: Robot) -> None:
    """Without laws beyond the model its tilt alone is identified."""
    upright = robot.with_(gravity=np.array([0.0, 0.0, -9.81]))
    turn = np.eye(4)
    turn[:3, :3] = turned(np.pi / 2, 0.0)
    described = upright.with_(base_placement=turn @ upright.base_placement, base_dh=None)
    found = identify(recorded(upright, []), described, IdentificationSettings(consistent=False))
    assert any("mounted differently" in note for note in found.notes)
    assert {e.name.partition(":")[0] for e in found.estimates if ":" in e.name} == {TILT}
