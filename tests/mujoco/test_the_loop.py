"""A MuJoCo arm with friction that its MJCF lacks, recorded in MuJoCo and diagnosed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.dynamics import build_model
from elastic_arm.excitation import MotionLimits, liveliest, random_trajectories
from elastic_arm.mujoco import record
from elastic_arm.robot.mjcf import open_mjcf
from tests.helpers.mujoco_arms import MODELS

pytest.importorskip("mujoco")
pytest.importorskip("lxml")
pytestmark = pytest.mark.slow(seconds=30)


def test_dry_friction_alone_is_explained_beside_coarse_encoders(tmp_path: Path) -> None:
    """The noise of the motors' angles is that of all accelerations: what it leaves at heavy joints is no gap."""
    plain, robot = MODELS / "arm.xml", open_mjcf(MODELS / "arm.xml").robot
    text = plain.read_text()
    for joint in ("joint3", "joint4"):
        text = text.replace(
            f'<joint name="{joint}"', f'<joint name="{joint}" frictionloss="2" solreffriction="0.002 1"'
        )
    (tmp_path / "true.xml").write_text(text)
    (tmp_path / "hand.xml").write_text((MODELS / "hand.xml").read_text())
    limits, rng = MotionLimits.of(robot, velocity=1.5, acceleration=5.0), np.random.default_rng(1)
    motions = liveliest(random_trajectories(build_model(robot), limits, 40, rng=rng), 2)
    noise = {"torque_noise": 0.15, "encoder_noise": 2e-5}
    recorded = [
        record(open_mjcf(tmp_path / "true.xml"), m, nominal=robot, rate=500.0, rng=rng, **noise) for m in motions
    ]
    found = diagnose(recorded[:1], Question(robot), recorded[1:])
    assert found.verdict == "explained"
    assert {(cause.effect, cause.joint) for cause in found.causes} == {
        ("coulomb_friction", j) for j in ("joint3", "joint4")
    }
    for cause in found.causes:
        assert cause.parameters["torque"].value == pytest.approx(2.0, abs=4.0 * cause.parameters["torque"].std)
