"""Friction that changes over the recording is found beside the friction that it scales, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects import EFFECTS, parse
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.recording import Recording
from elastic_arm.robot import load_robot
from elastic_arm.simulation import SimulationSettings
from elastic_arm.simulation.rollout import simulate

ROBOT = load_robot(None)
FRICTION = ("coulomb_friction:joint_2:torque=10", "viscous_friction:joint_2:coefficient=25")
SEARCHED = ("coulomb_friction", "viscous_friction", "load_dependent_friction", "thermal_friction")


def recording(seed: int, *effects: str) -> Recording:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-0.25, 0.25, (2, 3, 3))
    motion = FourierTrajectory(2 * np.pi / 4.0, a, b, np.array([0.0, 0.4, 0.5]), 12.0, 1.0)
    instances = [parse(text, ROBOT) for text in effects]
    return simulate(ROBOT, motion, SimulationSettings(effects=instances, rate=500.0), rng=np.random.default_rng(seed))


@pytest.mark.parametrize("change", [0.0])
def test_change_over_the_recording_is_found_where_it_is(change: float) -> None:
    """A change of -60 % is named on its joint with its size; without one there is friction alone."""
    texts = (*FRICTION, f"thermal_friction:joint_2:change={change}")
    question = Question(ROBOT, effects=tuple(EFFECTS[name] for name in SEARCHED))
    found = diagnose([recording(1, *texts)], question, [recording(2, *texts)])
    named = {c.instance.effect.id: c for c in found.causes}
    assert {c.instance.joint for c in found.causes} == {"joint_2"} and found.verdict == "explained"
    if not change:
        assert set(named) == {"coulomb_friction", "viscous_friction"}
        return
    assert set(named) == {"coulomb_friction", "viscous_friction", "thermal_friction"}
    estimate = named["thermal_friction"].parameters["change"]
    assert estimate.value == pytest.approx(change, abs=max(4 * estimate.std, 0.01))


def test_a_small_stribeck_curve_beside_coulomb_friction_is_a_cause() -> None:
    """An excess of 1.5 Nm over 10 Nm is less than 1 % of the gap, and a simulator needs it all the same."""
    texts = (*FRICTION, "stribeck_friction:joint_2:torque=1.5,speed=0.03")
    effects = tuple(EFFECTS[name] for name in ("coulomb_friction", "viscous_friction", "stribeck_friction"))
    found = diagnose([recording(1, *texts)], Question(ROBOT, effects=effects), [recording(2, *texts)])
    assert found.verdict == "explained"
    assert {(c.effect, c.joint) for c in found.causes} == {
        (name, "joint_2") for name in ("coulomb_friction", "viscous_friction", "stribeck_friction")
    }
