"""Datasets of robot learners in, and recordings as arrays out and back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.foreign.array_export import export_arrays
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_arrays, import_runs
from elastic_arm.recording.foreign.guess import guess_mapping
from tests.helpers.bags import assert_equal, stamps, two_sided
from tests.helpers.command_line import refusal

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
h5py = pytest.importorskip("h5py")

EPISODES = 3
LENGTH = 80
JOINTS = ["pan", "lift"]


def motion(seed: int) -> np.ndarray:
    """(LENGTH, 2) degrees."""
    t = np.arange(LENGTH) / 30.0
    return np.degrees(np.sin(np.outer(t, [1.0 + 0.1 * seed, 2.0]) + seed))


def frames(episodes: list[int]) -> dict[str, object]:
    """The columns of a LeRobot file that holds some episodes."""
    state = np.concatenate([motion(k) for k in episodes])
    step = np.tile(np.arange(LENGTH), len(episodes))
    return {
        "observation.state": state.astype(np.float32).tolist(),
        "action": (state + 1.0).astype(np.float32).tolist(),
        "timestamp": (step / 30.0).astype(np.float32),
        "frame_index": step,
        "episode_index": np.repeat(episodes, LENGTH),
        "index": np.arange(len(step)),
        "next.done": step == LENGTH - 1,
        "task": ["lift"] * len(step),
    }


def lerobot(root: Path, version: int) -> Path:
    """A dataset as LeRobot's versions lay it out: a file an episode, or files of several."""
    (root / "meta" / "episodes").mkdir(parents=True)
    (root / "meta" / "info.json").write_text("{}")
    pq.write_table(
        pa.table({"length": [LENGTH] * EPISODES}), root / "meta" / "episodes" / "file-000.parquet"
    )
    (root / "data" / "chunk-000").mkdir(parents=True)
    parts = [[0], [1], [2]] if version == 2 else [[0, 1], [2]]
    for k, part in enumerate(parts):
        name = f"episode_{k:06d}" if version == 2 else f"file-{k:03d}"
        pq.write_table(pa.table(frames(part)), root / "data" / "chunk-000" / f"{name}.parquet")
    return root


@pytest.mark.parametrize("version", [2, 3])
def test_the_episodes_of_a_lerobot_dataset_are_recordings(tmp_path: Path, version: int) -> None:
    """A guess for the folder is imported as it is, but for degrees: state, command and times of
    each episode."""
    root = lerobot(tmp_path / "set", version)
    draft = guess_mapping(load_arrays(root), JOINTS)
    (tmp_path / "map.yaml").write_text(draft.to_yaml())
    runs = import_runs(root, tmp_path / "map.yaml")
    assert list(runs) == [f"episode_index_{k}" for k in range(EPISODES)]
    for k, run in enumerate(runs.values()):
        np.testing.assert_allclose(run.link.position, np.deg2rad(motion(k)), rtol=0, atol=1e-6)
        np.testing.assert_allclose(
            run.reference.position, np.deg2rad(motion(k) + 1.0), rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(
            run.link.stamp_ns, np.arange(LENGTH) / 30.0 * 1e9, rtol=0, atol=1000
        )
        again = read_recording(write_recording(tmp_path / f"bag_{k}", run))
        assert_equal(again, run)
    with pytest.raises(
        RecordingError, match=r"contains 3 runs\. Give the number of one run under rows\.value"
    ):
        import_arrays(root, tmp_path / "map.yaml")
    one = draft.to_yaml().replace(
        "rows: {key: episode_index}", "rows: {key: episode_index, value: 1}"
    )
    (tmp_path / "map.yaml").write_text(one)
    assert_equal(import_arrays(root, tmp_path / "map.yaml"), runs["episode_index_1"])
    (tmp_path / "map.yaml").write_text(one.replace("value: 1", "value: 7"))
    with pytest.raises(RecordingError, match=r"no row has episode_index 7. Choose one of 0, 1, 2"):
        import_arrays(root, tmp_path / "map.yaml")


def test_hdf5_files_of_aloha_kind_are_recordings(tmp_path: Path) -> None:
    """Groups become dots, pictures are no arrays, and the files of a folder are runs in the order
    of their numbers."""
    for k in (2, 10):
        with h5py.File(tmp_path / f"episode_{k}.hdf5", "w") as file:
            file["observations/qpos"] = np.radians(motion(k))
            file["observations/effort"] = 3.0 * motion(k)
            file["action"] = np.radians(motion(k)) + 0.1
            file["observations/images/top"] = np.zeros((LENGTH, 4, 4, 3))
            file["compress_len"] = np.ones((2, LENGTH + k))
    draft = guess_mapping(load_arrays(tmp_path), JOINTS)
    assert draft.missing == ["times.rate"]
    (tmp_path / "map.yaml").write_text(draft.to_yaml().replace("{rate: }", "{rate: 50}"))
    runs = import_runs(tmp_path, tmp_path / "map.yaml")
    assert list(runs) == ["file_index_0", "file_index_1"]
    for k, run in zip((2, 10), runs.values(), strict=True):
        np.testing.assert_array_equal(run.link.position, np.radians(motion(k)))
        np.testing.assert_array_equal(run.motor.effort, 3.0 * motion(k))
        np.testing.assert_array_equal(run.reference.position, np.radians(motion(k)) + 0.1)
        assert run.link.stamp_ns[:2].tolist() == [0, 20_000_000]


def test_files_that_name_others_are_refused(tmp_path: Path) -> None:
    """External storage and virtual datasets read whatever file they name."""
    (tmp_path / "secret").write_bytes(np.arange(10.0).tobytes())
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("q", (10,), "f8", external=[(str(tmp_path / "secret"), 0, 80)])
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file["q"] = np.arange(10.0)
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource(tmp_path / "source.h5", "q", (10,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("q", layout)
        file["linked"] = h5py.ExternalLink(str(tmp_path / "source.h5"), "q")
    for name in ("external", "virtual"):
        with pytest.raises(RecordingError, match="q is in other files"):
            load_arrays(tmp_path / f"{name}.h5")
    with h5py.File(tmp_path / "virtual.h5", "a") as file:
        del file["q"]
        file["t"] = np.arange(3.0)
        file["same"] = h5py.SoftLink("/t")
    found = load_arrays(tmp_path / "virtual.h5")
    assert found["t"].tolist() == [0.0, 1.0, 2.0]
    assert (
        found["linked"][0].startswith("a link to q of ")
        and "source.h5, which is not" in found["linked"][0]
    )
    assert found["same"].tolist() == ["a link to /t, which is not followed"]
    (tmp_path / "map.yaml").write_text(
        "times: {key: t}\njoints: [j]\nlink: {position: {key: linked}}"
    )
    with pytest.raises(
        RecordingError,
        match=r"linked is not a table of numbers but of str[0-9]*: \['a link to q of ",
    ):
        import_runs(tmp_path / "virtual.h5", tmp_path / "map.yaml")
    (tmp_path / "set").mkdir()
    for k in range(2):
        (tmp_path / "set" / f"episode_{k}.h5").write_bytes((tmp_path / "virtual.h5").read_bytes())
    with pytest.raises(RecordingError, match="linked is not a table of numbers but of str"):
        import_runs(tmp_path / "set", tmp_path / "map.yaml")


@pytest.mark.parametrize("lists", [False, True])
def test_a_small_file_of_equal_numbers_is_not_unpacked_beyond_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lists: bool
) -> None:
    """The sizes that a Parquet file states are those of its packed pages."""
    zeros = pa.array(np.zeros(2_000_000))
    column = pa.FixedSizeListArray.from_arrays(zeros, 2) if lists else zeros
    pq.write_table(pa.table({"q": column}), tmp_path / "run.parquet", compression="zstd")
    assert (tmp_path / "run.parquet").stat().st_size < 100_000
    monkeypatch.setenv("ELASTIC_ARM_MAX_UNPACKED_MB", "10")
    with pytest.raises(RecordingError, match="unpacks to 16000000 bytes; the limit is 10000000"):
        load_arrays(tmp_path / "run.parquet")


def test_holes_texts_and_truths_refuse_no_parquet_file(tmp_path: Path) -> None:
    """A null is no number, a list that is missing a row of them."""
    columns = {
        "q": [1.0, None, 3.0],
        "n": [1, 2, None],
        "x": [[1.0, 2.0], None, [3.0, 4.0]],
        "ok": [True, False, None],
    }
    pq.write_table(
        pa.table({**columns, "name": ["a", "b", None], "ragged": [[1.0], [], [1.0]]}),
        tmp_path / "a.parquet",
    )
    arrays = load_arrays(tmp_path / "a.parquet")
    np.testing.assert_array_equal(arrays["q"], [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(arrays["n"], [1.0, 2.0, np.nan])
    np.testing.assert_array_equal(arrays["x"], [[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]])
    np.testing.assert_array_equal(arrays["ragged"], [[1.0], [np.nan], [1.0]])
    assert arrays["name"].tolist() == ["a", "b", ""] and "name" in arrays.faults


@pytest.fixture
def recording() -> Recording:
    """Sides of different rates and stamps, commands, a URDF, torques from currents, and names that
    need quotes."""
    rng = np.random.default_rng(0)
    whole = two_sided(rng, 50)
    position = whole.link.position.copy()
    position[:, 1] = np.nan
    command = Side(stamps(20, 2_000_003), *rng.normal(size=(4, 20, 3)))
    link = Side(stamps(13, 4_000_001), position[:13], effort=whole.link.effort[:13])
    names = ("a,b [mNm] ", 'the "second"\njoint', "c")
    return Recording(
        names, link, whole.motor, command, "<robot name='x'/>\n", currents=("motor_torque",)
    )


@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.parquet", "run.h5"])
@pytest.mark.parametrize("sides", ["all", "motor"])
def test_a_bag_as_arrays_and_back_is_the_same_bag(
    tmp_path: Path, name: str, sides: str, recording: Recording
) -> None:
    """Stamps and numbers of all sides to the bit, by the mapping that the export writes."""
    if sides == "motor":
        recording = replace(recording, link=None, reference=None)
    first = read_recording(write_recording(tmp_path / "first", recording))
    said = export_arrays(first, tmp_path / name)
    assert (
        "50 samples of the motor side" in "\n".join(said)
        and f"bag import {tmp_path / name} --map" in said[-1]
    )
    again = import_arrays(tmp_path / name, tmp_path / "run.yaml")
    second = read_recording(write_recording(tmp_path / "second", again))
    assert_equal(second, first)
    assert second.currents == first.currents and all(
        "mNm according to its name" in note for note in again.notes
    )


def test_sides_are_joined_on_request_alone_and_with_a_word(
    tmp_path: Path, recording: Recording
) -> None:
    """One time base is that of the slower side, which is said with the numbers of samples."""
    recording = replace(recording, joints=("a", "b", "c"))
    said = export_arrays(recording, tmp_path / "run.csv", joined=True)
    samples = recording.samples()
    arrays = load_arrays(tmp_path / "run.csv")
    np.testing.assert_array_equal(arrays["time"], samples.t)
    np.testing.assert_array_equal(arrays["tau_m.b"], samples.tau_m[:, 1])
    assert (
        f"{len(samples)} samples on one time base of 13 of the link side and 50 of the motor side"
        in said[0]
    )
    assert any("interpolated" in line for line in said) and "without the commands" in said[-1]


def test_other_endings_are_refused(tmp_path: Path) -> None:
    """The ending chooses the format."""
    with pytest.raises(RecordingError, match=r"extensions .csv, .npz, .parquet, .h5"):
        export_arrays(two_sided(np.random.default_rng(0), 50), tmp_path / "run.xlsx")
    assert "extensions .csv" in refusal("bag", "export", tmp_path, "--out", tmp_path / "run.xlsx")


@pytest.mark.parametrize("older", [False, True], ids=["list", "motors"])
def test_columns_are_those_of_the_joints_by_the_names_of_the_dataset(
    tmp_path: Path, older: bool
) -> None:
    """A gripper between the joints, and another order, are told by meta/info.json, not assumed."""
    root = lerobot(tmp_path / "set", 3)
    names = ["shoulder_lift.pos", "shoulder_pan.pos"]
    feature = {"names": {"motors": names} if older else names}
    pictures = {"names": ["height", "width", "channels"], "dtype": "video"}
    features = {"observation.state": feature, "action": feature, "observation.image": pictures}
    (root / "meta" / "info.json").write_text(json.dumps({"features": features}))
    draft = guess_mapping(load_arrays(root), ["shoulder_pan", "shoulder_lift"])
    text = draft.to_yaml()
    assert text.count("columns: [1, 0]") == 2 and "an assumption" not in text
    assert text.count("by their names in meta/info.json") == 2
    (tmp_path / "map.yaml").write_text(text)
    run = import_runs(root, tmp_path / "map.yaml")["episode_index_0"]
    np.testing.assert_allclose(run.link.position, np.deg2rad(motion(0)[:, ::-1]), rtol=0, atol=1e-6)
    others = guess_mapping(load_arrays(root), ["base", "arm"])
    assert "which is an assumption" in others.to_yaml()


def test_a_damaged_description_of_a_dataset_is_told(tmp_path: Path) -> None:
    """The error names the file."""
    root = lerobot(tmp_path / "set", 3)
    (root / "meta" / "info.json").write_text("{")
    with pytest.raises(RecordingError, match=r"info\.json is no description of a dataset"):
        load_arrays(root)
