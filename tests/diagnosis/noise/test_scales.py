"""What one joint lacks is its own: the causes of the others are found, and are as certain as their joints are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, Question, diagnose
from elastic_arm.diagnosis.noise.scales import leaves_more, noise_scales
from elastic_arm.diagnosis.pipeline import best_hypothesis
from elastic_arm.diagnosis.preparation import PreparedData, prepare, with_candidates
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.robot.synthetic import random_arm
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.motions import trajectory

VISCOUS, COULOMB = (15.0, 15.0, 10.0), (1.4, 1.4, 1.0)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return random_arm(3, np.random.default_rng(2), elastic=False)


def recorded(robot: Robot, seed: int, disturbance: float) -> Recording:
    """Return a recording of an arm with friction, and with a slow periodic torque at its first joint alone."""
    effects = [
        EffectInstance(EFFECTS[effect], joint, {parameter: size})
        for effect, parameter, sizes in (
            ("viscous_friction", "coefficient", VISCOUS),
            ("coulomb_friction", "torque", COULOMB),
        )
        for joint, size in zip(robot.joint_names, sizes, strict=True)
    ]
    rng = np.random.default_rng(seed)
    found = simulate(robot, trajectory(seed, 3, period=14.0), SimulationSettings(effects=effects), rng=rng)
    assert found.motor is not None and found.motor.effort is not None
    t = (found.motor.stamp_ns - found.motor.stamp_ns[0]) * 1e-9
    effort = found.motor.effort.copy()
    effort[:, 0] += disturbance * np.sin(2 * np.pi * 0.37 * t + seed) * (1.0 + np.sin(0.11 * t))
    return replace(found, link=None, motor=replace(found.motor, effort=effort), currents=("motor_torque",))


@pytest.fixture(scope="module")
def disturbed(robot: Robot) -> Diagnosis:
    parts = [recorded(robot, seed, 100.0) for seed in (3, 4)]
    return diagnose(parts[:1], Question(robot, "mod3", refit=True), parts[1:])


@pytest.mark.slow(30)
def test_frictions_beside_a_joint_that_is_not_explained_are_found_with_their_sizes(
    robot: Robot, disturbed: Diagnosis
) -> None:
    """With one scale for all joints the dry frictions were not found, and viscous ones 0.5 off by deviations of 0.6."""
    causes = {(cause.effect, cause.joint): cause for cause in disturbed.causes}
    for joint, viscous, coulomb in list(zip(robot.joint_names, VISCOUS, COULOMB, strict=True))[1:]:
        for effect, parameter, true in (
            ("viscous_friction", "coefficient", viscous),
            ("coulomb_friction", "torque", coulomb),
        ):
            cause = causes[effect, joint]
            found = cause.parameters[parameter]
            assert abs(found.value - true) < 3.0 * found.std
            assert found.std < 0.05 * true
            assert cause.confidence > 0.95


@pytest.mark.slow(1)
def test_the_joint_with_the_disturbance_is_named_and_nothing_is_explained(robot: Robot, disturbed: Diagnosis) -> None:
    """Its torque is no effect of the catalogue: the verdict says so, whatever was found at the other joints."""
    assert disturbed.verdict == "unknown"
    assert {place.joint for place in disturbed.unexplained} == {robot.joint_names[0]}
    assert all(cause.joint != robot.joint_names[0] for cause in disturbed.causes if cause.confidence > 0.5)
    for joint in robot.joint_names[1:]:
        assert disturbed.shrink_by_place[joint, "motor"] > 0.99


@pytest.mark.slow(1)
def test_leaving_more_is_judged_by_all_joints_alike(robot: Robot, disturbed: Diagnosis) -> None:
    """Twice the square at one joint is made up for by 1 / (1.8 · 1.2) of it at others, and not by 1 / 1.8."""
    assert disturbed.context is not None
    left = np.mean(np.concatenate(disturbed.context.after) ** 2, axis=0)
    assert not leaves_more(disturbed, left, 1.01)
    assert not leaves_more(disturbed, left * np.array([0.5, 1.8, 1.2]), 1.01)
    assert leaves_more(disturbed, left * np.array([0.5, 1.8, 1.0]), 1.01)


@pytest.mark.slow(15)
def test_scales_are_those_of_what_is_left_and_none_where_all_is_noise(robot: Robot) -> None:
    """They keep the mean square of what is left."""

    def prepared(disturbance: float) -> PreparedData:
        parts = [recorded(robot, seed, disturbance) for seed in (3, 4)]
        return with_candidates(prepare(parts[:1], parts[1:], Question(robot, "mod3", refit=True)))

    loud = best_hypothesis(prepared(100.0))
    scales = noise_scales(loud.prepared, loud.hypothesis)
    assert scales is not None
    assert scales[0] > 10.0 * scales[1:].max()
    assert np.mean(scales**2) == pytest.approx(1.0)
    quiet = best_hypothesis(prepared(0.0))
    assert noise_scales(quiet.prepared, quiet.hypothesis) is None
