"""A motion as set-points: a table for a controller, and a goal of ROS's
joint_trajectory_controller."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from elastic_arm.arrays import Array
from elastic_arm.errors import ExcitationError, require_libraries
from elastic_arm.excitation.fourier import FourierTrajectory, require
from elastic_arm.output_files import write_result

REMEDY = "Give a file in a writable folder"


def write_csv(
    path: Path, trajectory: FourierTrajectory, joints: Sequence[str], rate: float
) -> None:
    """Write time, positions, velocities and accelerations, `rate` rows a second.

    Or an episode.
    """
    if path.suffix.lower() == ".parquet":
        _write_episode(path, trajectory, rate)
        return
    t, *values = _sampled(trajectory, rate)
    units = ("position [rad]", "velocity [rad/s]", "acceleration [rad/s^2]")
    header = ",".join(["time [s]", *(f"{joint} {unit}" for unit in units for joint in joints)])
    rows = [",".join(f"{v:.9g}" for v in row) for row in np.column_stack([t, *values])]
    write_result(path, "\n".join([header, *rows, ""]), ExcitationError, REMEDY)


def write_goal(
    path: Path, trajectory: FourierTrajectory, joints: Sequence[str], rate: float
) -> None:
    """Write a FollowJointTrajectory goal, `rate` points a second with all derivatives."""
    t, *values = _sampled(trajectory, rate)
    stamps = [divmod(round(1e9 * at), 10**9) for at in t]
    points = [
        {
            **dict(zip(("positions", "velocities", "accelerations"), _rounded(row), strict=True)),
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
        for (sec, nanosec), *row in zip(stamps, *values, strict=True)
    ]
    goal = {"trajectory": {"joint_names": list(joints), "points": points}}
    text = yaml.safe_dump(goal, default_flow_style=True, sort_keys=False, width=10**9)
    write_result(path, text, ExcitationError, REMEDY)


def _write_episode(path: Path, trajectory: FourierTrajectory, rate: float) -> None:
    """Write the columns of a LeRobot episode that commands are: `action` (n,) rad, `timestamp` and
    its indices."""
    require_libraries(".parquet files need", "pyarrow")
    import pyarrow as pa
    import pyarrow.parquet as pq

    t, q, *_ = _sampled(trajectory, rate)
    columns = {"action": pa.array(list(q.astype(np.float32))), "timestamp": t.astype(np.float32)}
    columns |= {"frame_index": np.arange(len(t)), "episode_index": np.zeros(len(t), dtype=int)}
    content = io.BytesIO()
    pq.write_table(pa.table(columns), content)
    write_result(path, content.getvalue(), ExcitationError, REMEDY)


def _sampled(trajectory: FourierTrajectory, rate: float) -> tuple[Array, Array, Array, Array]:
    require(
        np.isfinite(rate) and rate > 0.0,
        f"{rate:g} set-points per second are requested",
        "Request at least one",
    )
    t = np.linspace(0.0, trajectory.duration, 1 + round(rate * trajectory.duration))
    return t, *trajectory.evaluate(t)


def _rounded(row: Sequence[Array]) -> list[list[float]]:
    # 0.0 is added so that no zero has a sign.
    return [[round(float(v), 7) + 0.0 for v in values] for values in row]
