"""Ordinary imperfections that nobody asks for: zeros of torques, a base off level."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.identification import Identification, IdentificationSettings, identify, parse_laws
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.batch.imperfections import (
    LEVEL,
    ZERO,
    NuisanceLaw,
    described_imperfections,
    possible_imperfections,
    told_apart,
)
from elastic_arm.identification.law_columns import law_columns, on_recorded_side
from elastic_arm.identification.regularisation import law_sizes, prior_of
from elastic_arm.identification.stream import Identifier
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.robot.synthetic import random_arm
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.motions import trajectory

FRICTION = ("viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return random_arm(4, np.random.default_rng(2), elastic=False)


def recorded(robot: Robot, effects: list[EffectInstance], seed: int = 3) -> Recording:
    settings = SimulationSettings(effects=effects)
    return simulate(robot, trajectory(seed, robot.n), settings, rng=np.random.default_rng(seed))


def identified(robot: Robot, recordings: list[Recording], validate: list[Recording]) -> Identification:
    settings = IdentificationSettings(effects=parse_laws(FRICTION, robot))
    return identify(recordings, robot, settings, validate=validate)


def test_a_base_off_level_is_identified_though_nobody_asked(robot: Robot) -> None:
    """A tilt of 25 mrad comes out within four deviations of each component, and robot.yaml has it."""
    tilt = EffectInstance(EFFECTS[TILT], None, {"x": 0.02, "y": -0.015})
    found = identified(robot, [recorded(robot, [tilt])], [recorded(robot, [tilt], 4)])
    sizes = {e.name.rpartition(".")[2]: e for e in found.estimates if e.name.startswith(TILT)}
    for name, true in (("x", 0.02), ("y", -0.015)):
        assert abs(sizes[name].value - true) < 4 * sizes[name].std < 0.02
    assert any("identified without being asked for" in note and TILT in note for note in found.notes)
    assert found.identified is not None
    assert TILT in {entry["effect"] for entry in found.identified.effects}


def test_what_the_recordings_do_not_show_is_held_to_what_is_ordinary(robot: Robot) -> None:
    """Level, with right zeros: none is called shown, and each stays within what is ordinary."""
    recording = recorded(robot, [])
    found = identified(robot, [recording], [])
    sizes = {e.name: e.value for e in found.estimates}
    torque = np.sqrt(np.mean(recording.samples().tau_m ** 2, axis=0))
    for joint, size in zip(robot.joint_names, torque, strict=True):
        assert abs(sizes[f"motor_torque_offset:{joint}.offset"]) < ZERO * size
    assert all(abs(sizes[f"{TILT}:{robot.name}.{axis}"]) < LEVEL for axis in "xy")
    assert not any("without being asked for" in note for note in found.notes)
    assert any("held to what is ordinary" in note for note in found.notes)


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
    equations = Identifier(build_model(lone, "mod3"), columns, joints=lone.joint_names).choose_equations(samples)
    assert [each.place[0] for each in told_apart(possible, equations)] == ["motor_torque_offset"]


def test_what_was_asked_for_is_no_imperfection(robot: Robot) -> None:
    """Neither a zero at its joint nor a tilt is taken twice."""
    samples = recorded(robot, []).samples()
    asked = parse_laws([f"motor_torque_offset:{robot.joint_names[1]}", TILT], robot)
    joints = [each.place[1] for each in possible_imperfections([samples], robot, asked)]
    assert joints == [robot.joint_names[k] for k in (0, 2, 3)]


def test_the_prior_of_what_is_ordinary_weighs_as_the_errors_last(robot: Robot) -> None:
    """Where errors are a hundred times more than white ones in variance, so is the prior's information.

    The deviations count its own errors all the same.
    """
    samples = recorded(robot, []).samples()
    (zero,) = parse_laws([f"motor_torque_offset:{robot.joint_names[0]}"], robot)
    (column,) = law_columns([zero], robot)
    held = NuisanceLaw(zero, 0.5)
    columns = [type(column)(column.name, column.unit, column.values, ordinary=held.ordinary)]
    identifier = Identifier(build_model(robot, "mod3"), columns, joints=robot.joint_names)
    identifier.add(samples)
    identifier.finish()
    equations: BaseRegression = identifier.equations
    place, sizes = equations.base.names.index(column.name), law_sizes(identifier.linear_blocks(), equations)
    assert sizes[place] == 0.5
    white, coloured = (prior_of(equations, np.inf, laws=sizes, correlated=c) for c in (1.0, 100.0))
    assert white.factor[place, place] == pytest.approx(2.0) and coloured.factor[place, place] == pytest.approx(20.0)
    assert np.asarray(coloured.excess)[place] == pytest.approx(10.0)


def test_a_rigid_arm_has_one_side(robot: Robot) -> None:
    """Friction is felt by joint torque sensors where they alone are recorded, and not asked for twice."""
    laws = parse_laws(["coulomb_friction", "coulomb_friction:side=link"], robot)
    moved = on_recorded_side(laws, robot, motored=False)
    assert {instance.sides for instance in moved} == {("link",)} and len(moved) == robot.n
    assert on_recorded_side(laws, robot, motored=True) == tuple(laws)


def test_imperfections_are_named_with_why_and_how(robot: Robot) -> None:
    """One note for what the recordings show, one for what a prior holds."""
    first, second = parse_laws(["motor_torque_offset"], robot)[:2]
    shown, held = described_imperfections([NuisanceLaw(first), NuisanceLaw(second, 1.0)])
    assert "differ from none" in shown and shown.endswith(f"motor_torque_offset:{first.joint}")
    assert held.startswith("the other zeros of torques") and "10%" in held
    assert described_imperfections([]) == []


def test_the_zero_of_a_sliding_axis_is_kept_beside_no_tilt() -> None:
    """A tilt loads it with a constant force, as a zero does: the zero is identified, the tilt is not."""
    slide = random_arm(1, np.random.default_rng(1), elastic=False, prismatic=[0])
    samples = recorded(slide, []).samples()
    asked = parse_laws(["viscous_friction"], slide)
    possible = possible_imperfections([samples], slide, asked)
    columns = law_columns([*asked, *(each.instance for each in possible)], slide)
    equations = Identifier(build_model(slide, "mod3"), columns, joints=slide.joint_names).choose_equations(samples)
    assert [each.place[0] for each in told_apart(possible, equations)] == ["motor_torque_offset"]
