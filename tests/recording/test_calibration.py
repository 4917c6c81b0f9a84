"""LeRobot's default unit, per cent of calibrated ranges, by its calibration file."""

import json
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.arrays import import_arrays, import_runs
from elastic_arm.recording.foreign.guess import guess_mapping

RANGES = {"pan": (1000, 3048), "gripper": (2000, 3024)}  # half a turn, a quarter of one
MAPPING = """
times: {rate: 50}
joints: [pan, gripper]
calibration: so101.json
link: {position: {key: state}}
command: {position: {key: action}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a mapping, its calibration and arrays in per cent."""
    motors = {
        name: {"id": 1, "drive_mode": 0, "homing_offset": 5, "range_min": low, "range_max": high}
        for name, (low, high) in RANGES.items()
    }
    (tmp_path / "so101.json").write_text(json.dumps(motors))
    (tmp_path / "map.yaml").write_text(MAPPING)
    share = np.linspace(-1.0, 1.0, 40)
    state = np.stack([100.0 * share, 50.0 + 50.0 * share], axis=1)
    np.savez(tmp_path / "run.npz", state=state, action=0.5 * state)
    return tmp_path


def test_per_cent_of_positions_and_commands_become_angles(folder: Path) -> None:
    """Half a turn about its middle, and the gripper's quarter from its lower end."""
    found = import_arrays(folder / "run.npz", folder / "map.yaml")
    assert found.link is not None and found.link.position is not None
    assert found.reference is not None and found.reference.position is not None
    angles = np.rad2deg(found.link.position)
    np.testing.assert_allclose(angles[[0, -1]], [[-90.0, 0.0], [90.0, 90.0]], atol=1e-9)
    np.testing.assert_allclose(found.reference.position, 0.5 * found.link.position)


def test_a_unit_that_is_stated_is_kept(folder: Path) -> None:
    """Positions in degrees stay so beside a calibration."""
    text = MAPPING.replace("{key: state}", "{key: state, unit: deg}")
    (folder / "map.yaml").write_text(text)
    found = import_arrays(folder / "run.npz", folder / "map.yaml")
    assert found.link is not None and found.link.position is not None
    assert np.rad2deg(found.link.position[-1, 0]) == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "is no JSON"),
        ('{"pan": {"range_min": 5}}', "pan.range_max: Field required"),
        ('{"pan": {"range_min": 9, "range_max": 5}}', "range_max 5 is not above 9"),
        ('{"shoulder": {"range_min": 1, "range_max": 5}}', "has no joint pan, gripper"),
    ],
)
def test_a_file_that_is_no_calibration_is_told(folder: Path, content: str, words: str) -> None:
    """The error names file and entry."""
    (folder / "so101.json").write_text(content)
    with pytest.raises(RecordingError, match=words):
        import_arrays(folder / "run.npz", folder / "map.yaml")


def test_the_calibration_may_be_an_option(folder: Path, tmp_path: Path) -> None:
    """It takes the place of the one of the mapping, and a draft states it instead of units."""
    expected = import_arrays(folder / "run.npz", folder / "map.yaml")
    (folder / "map.yaml").write_text(MAPPING.replace("calibration: so101.json\n", ""))
    (found,) = import_runs(folder / "run.npz", folder / "map.yaml", folder / "so101.json").values()
    np.testing.assert_allclose(found.link.position, expected.link.position)
    np.testing.assert_allclose(found.reference.position, expected.reference.position)
    t = np.arange(400) / 50.0
    state = 90.0 * np.sin(np.stack([t, 1.3 * t], axis=1))
    arrays = {"timestamp": t, "state": state, "action": 1.1 * state}
    text = guess_mapping(arrays, ["pan", "gripper"], calibration="so101.json").to_yaml()
    assert "calibration: so101.json" in text
    assert "unit: deg" not in text and "factor" not in text
    assert text.count("by the calibration") == 2
