"""Recordings of robot learners in, and recordings as arrays out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.array_export import export_arrays
from elastic_arm.recording.foreign.arrays import import_arrays
from tests.helpers.bags import two_sided

EPISODES, LENGTH = 3, 40
LEROBOT = """
times: {key: timestamp, unit: s}
joints: [pan, lift]
rows: {key: episode_index, value: 1}
link:
  position: {key: observation.state, unit: deg}
  effort: {key: observation.effort, unit: Nm}
ignore: [action, frame_index, index, task_index]
"""
ALOHA = """
times: {rate: 50}
joints: [pan, lift]
link: {position: {key: observations.qpos}, effort: {key: observations.effort}}
ignore: [action]
"""


@pytest.fixture
def values() -> np.ndarray:
    return np.random.default_rng(0).standard_normal((EPISODES * LENGTH, 2))


def test_an_episode_of_a_lerobot_dataset_is_a_recording(tmp_path: Path, values: np.ndarray) -> None:
    """Columns of lists are channels, one row a frame; `rows` takes one episode of several."""
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    frames = np.tile(np.arange(LENGTH), EPISODES)
    table = {
        "observation.state": values.tolist(),
        "observation.effort": (2.0 * values).tolist(),
        "action": values.tolist(),
        "timestamp": (frames / 30.0).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.repeat(np.arange(EPISODES), LENGTH),
        "index": np.arange(EPISODES * LENGTH),
        "task_index": np.zeros(EPISODES * LENGTH, dtype=int),
        "task": ["lift"] * (EPISODES * LENGTH),
    }
    pq.write_table(pa.table(table), tmp_path / "file-000.parquet")
    (tmp_path / "map.yaml").write_text(LEROBOT)
    recording = import_arrays(tmp_path / "file-000.parquet", tmp_path / "map.yaml")
    samples, own = recording.samples(), values[LENGTH : 2 * LENGTH]
    np.testing.assert_allclose(samples.q, np.deg2rad(own))
    np.testing.assert_allclose(samples.tau_J, 2.0 * own)
    (tmp_path / "map.yaml").write_text(LEROBOT.replace("value: 1", "value: 7"))
    with pytest.raises(RecordingError, match=r"no row has episode_index 7. Take one of 0, 1, 2"):
        import_arrays(tmp_path / "file-000.parquet", tmp_path / "map.yaml")


def test_hdf5_datasets_are_arrays_by_their_paths(tmp_path: Path, values: np.ndarray) -> None:
    """Groups become dots; pictures are no arrays."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "episode_0.hdf5", "w") as file:
        file["observations/qpos"], file["observations/effort"], file["action"] = values, 3.0 * values, values
        file["observations/images/top"] = np.zeros((len(values), 4, 4, 3), dtype=np.uint8)
    (tmp_path / "map.yaml").write_text(ALOHA)
    samples = import_arrays(tmp_path / "episode_0.hdf5", tmp_path / "map.yaml").samples()
    np.testing.assert_allclose(samples.q, values)
    np.testing.assert_allclose(samples.tau_J, 3.0 * values)


@pytest.mark.parametrize("name", ["run.parquet", "run.hdf5"])
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    """What is no Parquet and no HDF5 is named."""
    pytest.importorskip("pyarrow")
    pytest.importorskip("h5py")
    (tmp_path / name).write_bytes(b"PAR1 no such thing")
    (tmp_path / "map.yaml").write_text(ALOHA)
    with pytest.raises(RecordingError, match=f"{name} cannot be read") as error:
        import_arrays(tmp_path / name, tmp_path / "map.yaml")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.parquet"])
def test_what_is_exported_is_imported_again(tmp_path: Path, name: str) -> None:
    """A recording written as arrays and read back has the same channels, to the bit of its time base."""
    pytest.importorskip("pyarrow")
    recording = two_sided(np.random.default_rng(0), 50)
    samples, joints = recording.samples(), recording.joints
    export_arrays(recording, tmp_path / name)

    def key(channel: str) -> str:
        return channel if name.endswith("npz") else f"[{', '.join(f'{channel}.{joint}' for joint in joints)}]"

    (tmp_path / "map.yaml").write_text(
        f"times: {{key: time}}\njoints: [{', '.join(joints)}]\nignore: ['*']\n"
        f"link: {{position: {{key: {key('q')}}}, effort: {{key: {key('tau_J')}, unit: Nm}}}}\n"
        f"motor: {{effort: {{key: {key('tau_m')}, unit: Nm}}}}\n"
    )
    again = import_arrays(tmp_path / name, tmp_path / "map.yaml").samples()
    np.testing.assert_array_equal(again.q, samples.q)
    np.testing.assert_array_equal(again.tau_m, samples.tau_m)
    np.testing.assert_allclose(again.t, samples.t, atol=1e-9)


def test_other_endings_are_refused(tmp_path: Path) -> None:
    """The ending chooses the format."""
    with pytest.raises(RecordingError, match=r"none of .csv, .npz, .parquet"):
        export_arrays(two_sided(np.random.default_rng(0), 50), tmp_path / "run.xlsx")
