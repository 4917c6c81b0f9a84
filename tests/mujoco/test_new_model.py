"""New MJCFs: the arms that they were made of, rigid and elastic."""

import numpy as np
import pytest

from elastic_arm.dynamics import build_model
from elastic_arm.excitation import MotionLimits, random_trajectories
from elastic_arm.mujoco import to_mjcf
from elastic_arm.robot import load_robot
from elastic_arm.robot.urdf import parse_urdf
from elastic_arm.robot.urdf_export import to_urdf
from elastic_arm.simulation import SimulationSettings, Simulator
from tests.helpers.mujoco_arms import MODELS, played, random_motion
from tests.helpers.random_arms import random_arm

pytest.importorskip("mujoco")
SLIDING = random_arm(4, np.random.default_rng(3), elastic=False, prismatic=(0, 2))


@pytest.mark.parametrize("file", [MODELS / "arm.xml", MODELS / "everything.xml", None, SLIDING])
def test_a_rigid_arm_is_itself_again(file, tmp_path) -> None:
    """A rigid arm written as a new MJCF and read back has the same torques, armature and
    friction."""
    robot = (
        parse_urdf(to_urdf(load_robot()))
        if file is None
        else file
        if file is SLIDING
        else load_robot(file)
    )
    (tmp_path / "new.xml").write_text(to_mjcf(robot)[0])
    again = load_robot(tmp_path / "new.xml")
    motion = random_motion(robot.n)
    armatures = [[joint.armature or 0.0 for joint in r.joints] for r in (again, robot)]
    np.testing.assert_allclose(*armatures, rtol=1e-9)
    torques = [build_model(r).inverse_dynamics(*motion) for r in (again, robot)]
    np.testing.assert_allclose(*torques, rtol=1e-9, atol=1e-9)
    friction = [[e for e in r.effects if e["effect"].endswith("friction")] for r in (again, robot)]
    assert len(friction[0]) == len(friction[1])
    for ours in friction[0]:
        (theirs,) = [
            e for e in friction[1] if (e["effect"], e["joint"]) == (ours["effect"], ours["joint"])
        ]
        assert ours["parameters"] == pytest.approx(theirs["parameters"], rel=1e-9)


def test_the_elastic_arm_moves_in_mujoco_as_in_the_simulator() -> None:
    """The nominal elastic arm (mod2) under the same motor torques for 10 s: angles equal to 1e-5
    rad."""
    robot, rate, substeps = load_robot(), 1000, 10
    motion = random_trajectories(
        build_model(robot, "mod2"), MotionLimits.of(robot), 1, rng=np.random.default_rng(0)
    )[0]
    reference = motion.evaluate(np.arange(10 * rate + 1) / rate)
    ours = Simulator(
        robot,
        SimulationSettings(model="mod2", rate=rate, substeps=substeps),
        q0=reference[0][0],
        dq0=reference[1][0],
    )
    start = ours.state.y.copy()
    truth, _ = ours.follow(*reference)
    text, left = to_mjcf(robot, timestep=1.0 / rate / substeps)
    assert not left
    angles = played(
        robot, text.replace('"implicitfast"', '"RK4"'), truth.command, start, substeps=substeps
    )
    assert np.abs(angles - np.hstack([truth.q, truth.theta])).max() < 1e-5
