"""An arm recorded in MuJoCo and replayed there: by the model that moved it, and by one that it is
not."""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.excitation import MotionLimits, Shape, random_trajectories
from elastic_arm.mujoco import record, replay
from elastic_arm.recording import Recording
from elastic_arm.robot.mjcf import open_mjcf
from tests.helpers.mujoco_arms import MODELS

LOSS = 2.0  # Nm


@pytest.fixture(scope="module")
def recorded() -> Recording:
    """Exact angles and torques of three seconds, at 500 Hz."""
    arm, rng = open_mjcf(MODELS / "arm.xml"), np.random.default_rng(1)
    limits = MotionLimits.of(arm.robot, velocity=1.5, acceleration=5.0)
    (motion,) = random_trajectories(
        build_model(arm.robot), limits, 1, rng=rng, shape=Shape(3, 3.0, 0.5)
    )
    return record(arm, motion, rate=500.0, rng=rng)


def test_the_model_that_was_recorded_replays_it(recorded: Recording) -> None:
    """It needs the recorded torque to 1 mNm, is late by less than a tenth of a sample, and stays
    within 1 mrad."""
    found = replay(recorded, open_mjcf(MODELS / "arm.xml"))
    assert found.windows >= 10
    assert found.open_loop.torque.max() < 1e-3
    assert np.abs(found.open_loop.lag).max() < 2e-4
    assert found.open_loop.position.max() < 1e-3


def test_a_model_with_friction_that_the_arm_has_not_errs_by_it(
    recorded: Recording, tmp_path: Path
) -> None:
    """Two Nm of friction loss at one joint are what that joint's torque is off by, and no
    other's."""
    text = (MODELS / "arm.xml").read_text()
    (tmp_path / "hand.xml").write_text((MODELS / "hand.xml").read_text())
    rough = f'<joint name="joint3" frictionloss="{LOSS}" solreffriction="0.002 1" '
    (tmp_path / "arm.xml").write_text(text.replace('<joint name="joint3"', rough))
    found = replay(recorded, open_mjcf(tmp_path / "arm.xml"), name="rough")
    assert found.open_loop.torque == pytest.approx(
        [0.0, 0.0, LOSS, 0.0, 0.0, 0.0, 0.0], abs=0.1 * LOSS
    )
    assert found.open_loop.position[2] > 1e-3
    assert found.to_dict()["model"] == "rough"
