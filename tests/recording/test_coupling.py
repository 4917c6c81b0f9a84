"""Wrists whose motors move several joints at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.foreign.channels import ChannelMap, coupled, coupling_matrix
from elastic_arm.recording.sides import Side

WRIST = {"b": {"a": 0.02, "b": 1.0}, "c": {"a": -0.01, "b": 0.5, "c": -1.0}}
JOINTS = ["a", "b", "c"]


def mapping(**changes: object) -> dict[str, object]:
    motor = {"position": {"key": "angle"}, "velocity": {"key": "speed"}, "effort": {"key": "torque"}}
    return {"times": {"rate": 100}, "joints": JOINTS, "motor": motor, "coupling": WRIST, **changes}


def test_angles_go_by_the_matrix_and_torques_keep_their_power(tmp_path: Path) -> None:
    """theta = C theta_motors joint by joint, and the power of all motors is that at the joints."""
    angle, speed, torque = np.random.default_rng(0).standard_normal((3, 50, 3))
    np.savez(tmp_path / "run.npz", angle=angle, speed=speed, torque=torque)
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping()))
    motor = import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml").motor
    np.testing.assert_allclose(motor.position[:, 2], -0.01 * angle[:, 0] + 0.5 * angle[:, 1] - angle[:, 2])
    np.testing.assert_array_equal(motor.position[:, 0], angle[:, 0])
    power = [np.sum(a * b, axis=1) for a, b in ((motor.velocity, motor.effort), (speed, torque))]
    np.testing.assert_allclose(*power, atol=1e-12)


def test_a_channel_map_has_the_same_coupling() -> None:
    """Bags are uncoupled as arrays are; what is not recorded stays so."""
    source = {"topic": "/drives", "field": "position"}
    joints = {name: {"motor": {"position": {**source, "name": name}}} for name in JOINTS}
    rules = ChannelMap.model_validate({"joints": joints, "coupling": WRIST})
    side = coupled(Side(np.arange(2), position=np.eye(2, 3)), coupling_matrix(rules.coupling, JOINTS))
    assert side is not None and side.effort is None and side.position is not None
    np.testing.assert_allclose(side.position, [[1.0, 0.02, -0.01], [0.0, 1.0, 0.5]])
    assert coupled(None, np.eye(3)) is None


@pytest.mark.parametrize(
    ("coupling", "words"),
    [({"d": {"a": 1.0}}, "no joint d"), ({"b": {"e": 1.0}}, "no joint e"), ({"b": {"a": 1.0}}, "cannot move"),
     ({"b": {"b": float("nan")}}, "not finite")],
)  # fmt: skip
def test_what_is_no_coupling_is_refused(coupling: dict[str, dict[str, float]], words: str, tmp_path: Path) -> None:
    """Unknown names, and motors that cannot move the joints apart, are named."""
    np.savez(tmp_path / "run.npz", angle=np.eye(3), speed=np.eye(3), torque=np.eye(3))
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(mapping(coupling=coupling)))
    with pytest.raises(RecordingError, match=words):
        import_arrays(tmp_path / "run.npz", tmp_path / "map.yaml")
