"""The recorder on a disk that fills up while the arm moves."""

from pathlib import Path

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from elastic_arm.recording import read_recording
from tests.helpers.ros_graph import ros_graph
from tests.helpers.small_disk import mounted


@pytest.mark.graph
def test_a_disk_that_fills_up_ends_the_recorder_alone(tmp_path: Path) -> None:
    """It ends with one line and code 2, what was written is read again, and the arm goes on."""
    with mounted(tmp_path / "disk", 300) as disk, ros_graph(tmp_path) as graph:
        heard = graph.listen(JointState, "/motor_states")
        recorder = graph.start("recorder", bag=disk / "bag")
        simulator = graph.start("simulator", rate=500.0)
        graph.until(lambda: recorder.process.poll() is not None, "the disk is full")
        assert recorder.process.returncode == 2
        (line,) = [line for line in recorder.output.splitlines() if "recording to" not in line]
        assert line.startswith("error: ") and "No space left on device" in line
        motor = read_recording(disk / "bag").motor
        assert len(motor) > 500
        assert set(np.diff(motor.stamp_ns)) == {2_000_000}
        count = len(heard)
        graph.until(lambda: len(heard) > count + 100, "the arm goes on")
        assert simulator.stop() == 0
