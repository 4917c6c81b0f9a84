"""A motion as set-points, and as `identify` will judge it."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.interpolate import BPoly

from elastic_arm.dynamics import build_model
from elastic_arm.errors import ExcitationError
from elastic_arm.excitation import FourierTrajectory
from elastic_arm.excitation.setpoints import write_csv, write_goal
from elastic_arm.identification import IdentificationSettings, identify
from elastic_arm.identification.planned import judged
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.message_types import typestore
from elastic_arm.robot import load_robot
from elastic_arm.simulation import SimulationSettings, simulate
from tests.test_first_arm import URDF

JOINTS = ("a", "b")


def motion() -> FourierTrajectory:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 2, 5)) * 0.3
    return FourierTrajectory.of_periods(10.0, a, b, np.zeros(2), ramp=2.5)


def test_a_csv_file_holds_the_motion(tmp_path: Path) -> None:
    """Time, positions, velocities and accelerations of every joint, as the trajectory has them,
    with units above."""
    write_csv(tmp_path / "motion.csv", motion(), JOINTS, 100.0)
    head, *_ = (tmp_path / "motion.csv").read_text().splitlines()
    assert head.startswith("time [s],a position [rad],b position [rad],a velocity [rad/s]")
    t, *columns = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1).T
    assert t[1] == pytest.approx(0.01) and t[-1] == pytest.approx(15.0)
    np.testing.assert_allclose(np.transpose(columns), np.hstack(motion().evaluate(t)), atol=1e-8)


def test_a_parquet_file_is_an_episode_of_commands(tmp_path: Path) -> None:
    """Its `action` is the motion at its `timestamp`, to single precision, as datasets of LeRobot
    are read."""
    pq = pytest.importorskip("pyarrow.parquet")
    write_csv(tmp_path / "motion.parquet", motion(), JOINTS, 50.0)
    assert (
        str(pq.read_schema(tmp_path / "motion.parquet").field("action").type.value_type) == "float"
    )
    found = load_arrays(tmp_path / "motion.parquet")
    np.testing.assert_allclose(found["action"], motion().evaluate(found["timestamp"])[0], atol=1e-5)
    assert found["frame_index"][-1] == 750 and not found["episode_index"].any()


def test_a_goal_is_a_message_whose_quintics_are_the_motion(tmp_path: Path) -> None:
    """The goal has the fields of JointTrajectory; quintics through its points, which the controller
    makes of it, stay within 10 µrad of the motion."""
    write_goal(tmp_path / "goal.yaml", motion(), JOINTS, 20.0)
    trajectory = yaml.safe_load((tmp_path / "goal.yaml").read_text())["trajectory"]
    types = typestore().types
    assert set(trajectory) <= set(types["trajectory_msgs/msg/JointTrajectory"].__dataclass_fields__)
    points = trajectory["points"]
    assert set(points[0]) <= set(
        types["trajectory_msgs/msg/JointTrajectoryPoint"].__dataclass_fields__
    )
    t = [p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points]
    quintic = BPoly.from_derivatives(
        t, [[p[k] for k in ("positions", "velocities", "accelerations")] for p in points]
    )
    between = np.linspace(0.0, 15.0, 4001)
    np.testing.assert_allclose(quintic(between), motion().evaluate(between)[0], atol=1e-5)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_a_rate_that_is_none_is_refused(tmp_path: Path, rate: float) -> None:
    """Set-points at no rate are refused in one line."""
    with pytest.raises(ExcitationError, match="Request at least one"):
        write_csv(tmp_path / "motion.csv", motion(), JOINTS, rate)


def test_identify_judges_a_recording_as_its_motion_was_judged(tmp_path: Path) -> None:
    """A light arm needs some periods: with as many `identify` calls the recording good, with one
    period poor."""
    (tmp_path / "arm.urdf").write_text(URDF)
    robot = load_robot(tmp_path / "arm.urdf")
    a = 0.7 * np.array([[0.5, 0.5, 0.5, 0.9, 0.9]])
    b = 0.7 * np.array([[0.0, 0.4, 0.2, 0.5, 0.9]])
    planned = FourierTrajectory.of_periods(10.0, a, b, np.zeros(1), ramp=0.0)
    periods, found = judged(build_model(robot, "mod3"), planned)
    assert periods > 1 and not found.poor
    for count, poor in ((periods, False), (1, True)):
        assert judged(build_model(robot, "mod3"), planned, count)[1].poor is poor
        rng = np.random.default_rng(0)
        recording = simulate(
            robot, planned.repeated(count), SimulationSettings(rate=200.0), rng=rng
        )
        result = identify(recording, robot, IdentificationSettings(consistent=False))
        assert result.excitation["poor"] is poor, result.excitation
