"""Arrays become recordings as their mappings describe."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from elastic_arm.errors import RecordingError
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag
from tests.helpers.bags import assert_equal, imported, write_yaml

ROOT = Path(__file__).parents[2]


KUKA = ROOT.parent / "shared" / "data" / "kuka_lwr4"


MAPPING = {
    "times": {"key": "t"},
    "joints": ["joint_1", "joint_2"],
    "link": {"position": {"key": "q", "unit": "deg"}},
    "motor": {
        "effort": {
            "key": "i",
            "unit": "A",
            "torque_constant": [0.1, 0.2],
            "ratio": 100,
            "sign": [1, -1],
        }
    },
    "ignore": ["junk"],
}


def make_arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    t = 1.7e9 + np.arange(50) * 0.005
    return {
        "t": t,
        "q": rng.normal(size=(50, 2)),
        "i": rng.normal(size=(50, 2)),
        "junk": np.zeros(3),
    }


def test_npz_csv_and_mat_give_the_same_recording(tmp_path: Path) -> None:
    """The same arrays in three formats become the same recording, in SI units, and survive the
    bag."""
    arrays = make_arrays()
    np.savez(tmp_path / "a.npz", **arrays)
    scipy.io.savemat(tmp_path / "a.mat", {**arrays, "q": arrays["q"].T})
    table = np.column_stack([arrays["t"], arrays["q"], arrays["i"]])
    np.savetxt(
        tmp_path / "a.csv", table, fmt="%.17g", delimiter=",", header="t,q1,q2,i1,i2", comments=""
    )
    mapping = write_yaml(tmp_path / "map.yaml", MAPPING)
    by_column = {
        **MAPPING,
        "link": {"position": {**MAPPING["link"]["position"], "key": ["q1", "q2"]}},
        "motor": {"effort": {**MAPPING["motor"]["effort"], "key": ["i1", "i2"]}},
    }
    recording = import_arrays(tmp_path / "a.npz", mapping)
    np.testing.assert_allclose(recording.link.position, np.deg2rad(arrays["q"]))
    np.testing.assert_allclose(recording.motor.effort, arrays["i"] * [10, -20])
    assert recording.currents == ("motor_torque",)
    bag = write_recording(tmp_path / "stated", recording)
    assert (
        read_recording(bag).currents
        == read_recording(bag / "stated_0.mcap").currents
        == ("motor_torque",)
    )
    np.testing.assert_array_equal(recording.link.stamp_ns[0], 1_700_000_000_000_000_000)
    assert_equal(import_arrays(tmp_path / "a.mat", mapping), recording)
    assert_equal(
        import_arrays(tmp_path / "a.csv", write_yaml(tmp_path / "c.yaml", by_column)), recording
    )
    assert_equal(read_recording(write_recording(tmp_path / "bag", recording)), recording)


@pytest.mark.parametrize("wrong", ["number", "time"])
def test_samples_that_no_bag_could_hold_are_to_be_mended_in_the_file(
    wrong: str, tmp_path: Path
) -> None:
    """The remedy is no repair of a bag, as there is none yet."""
    times = np.arange(10) / 300
    angles = np.zeros((10, 1))
    (angles if wrong == "number" else times)[5:6] = np.inf if wrong == "number" else 0.0
    np.savez(tmp_path / "a.npz", q=angles, t=times)
    with pytest.raises(RecordingError, match="Correct these samples in the file") as told:
        imported(tmp_path / "a.npz", "a", "t", link={"position": {"key": "q"}})
    assert "--repair" not in str(told.value)


def test_a_constant_rate_stands_in_for_times(tmp_path: Path) -> None:
    """Arrays without times are timed by a rate."""
    np.savez(tmp_path / "a.npz", q=np.zeros((10, 1)))
    recording = imported(tmp_path / "a.npz", "a", 300.0, link={"position": {"key": "q"}})
    assert recording.link.stamp_ns.tolist() == [round(k * 1e9 / 300) for k in range(10)]


def test_a_force_beside_currents_has_no_constant(tmp_path: Path) -> None:
    """A linear axis has its force in N, the joint above it a current: null where a constant has no
    place."""
    arrays = make_arrays()
    np.savez(tmp_path / "a.npz", **arrays)
    effort = {"key": "i", "unit": ["N", "A"], "torque_constant": [None, 0.2], "ratio": [None, 100]}
    content = {**MAPPING, "motor": {"effort": effort}}
    recording = import_arrays(tmp_path / "a.npz", write_yaml(tmp_path / "map.yaml", content))
    np.testing.assert_allclose(recording.motor.effort, arrays["i"] * [1.0, 20.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times": {"key": "time"}}, "no array time; the arrays are t, q, i, junk"),
        ({"ignore": []}, "arrays junk are not mapped"),
        ({"joints": ["a", "b", "c"]}, "has 2 values for 3 joints"),
        ({"joints": ["a", "a"]}, "duplicate name"),
        (
            {"link": {"position": {"key": "q", "columns": [0]}}},
            "q has shape (50, 1); expected 50 samples of 2 joints",
        ),
        ({"link": {"position": {"key": "junk"}}, "ignore": ["q"]}, "junk has shape"),
        ({"times": {}}, "give either a key or a rate"),
        ({"robot_description": "no.urdf"}, "no.urdf: no such file"),
        (
            {"link": {"position": {"key": "q", "unit": "degrees"}}},
            "position.unit: is 'degrees'. Choose one of 'rad',",
        ),
        (
            {"link": {"position": {"key": "q", "unit": ["rad", "degrees"]}}},
            "position.unit[1]: is 'degrees'. Choose",
        ),
        (
            {"link": {"position": {"key": "q", "offset": "zero"}}},
            "link.position.offset: is 'zero', not a number. Correct",
        ),
    ],
)
def test_wrong_mappings_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    """Each mistake in a mapping is named."""
    np.savez(tmp_path / "a.npz", **make_arrays())
    with pytest.raises(RecordingError) as caught:
        import_arrays(tmp_path / "a.npz", write_yaml(tmp_path / "map.yaml", {**MAPPING, **change}))
    assert words in str(caught.value)


def test_a_table_may_be_parted_by_blanks_or_have_one_column(tmp_path: Path) -> None:
    """What numpy's savetxt writes, names behind a comment mark, is read; so is a single column."""
    table = np.column_stack([np.arange(20) * 0.01, np.sin(np.arange(20))])
    np.savetxt(tmp_path / "blanks.csv", table, header="t   q")
    np.savetxt(tmp_path / "one.csv", table[:, 1], header="q", comments="")
    for name, times in (("blanks", "t"), ("one", 100.0)):
        recording = imported(tmp_path / f"{name}.csv", "a", times, link={"position": {"key": "q"}})
        np.testing.assert_allclose(recording.link.position, table[:, 1:])


def test_bad_arrays_are_refused(tmp_path: Path) -> None:
    """Infinite numbers, times that go back, pickles and unknown formats are refused by name."""
    mapping = write_yaml(tmp_path / "map.yaml", MAPPING)
    for name, row, value, words in (
        ("q", 7, np.inf, "position of joint_1 is inf"),
        ("t", 9, 1.0, "back in time"),
    ):
        arrays = make_arrays()
        arrays[name].flat[row * (2 if name == "q" else 1)] = value
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(RecordingError, match=words):
            import_arrays(tmp_path / "bad.npz", mapping)
    np.savez(tmp_path / "pickle.npz", **{**make_arrays(), "q": np.array([{}], dtype=object)})
    with pytest.raises(RecordingError, match="cannot be read"):
        import_arrays(tmp_path / "pickle.npz", mapping)
    np.savez(tmp_path / "words.npz", **{**make_arrays(), "q": np.array([["a", "b"]] * 50)})
    with pytest.raises(RecordingError, match="not a table of numbers"):
        import_arrays(tmp_path / "words.npz", mapping)
    (tmp_path / "a.docx").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"extensions \.csv, \.tsv, \.txt"):
        import_arrays(tmp_path / "a.docx", mapping)


@pytest.mark.skipif(not KUKA.exists(), reason=f"the KUKA LWR 4+ recordings are not in {KUKA}")
@pytest.mark.parametrize("run", [1, 2, 3])
def test_kuka_recordings_are_imported_exactly(tmp_path: Path, run: int) -> None:
    """Seven joints, both angles and sensed torques bit by bit; stamps within half a nanosecond of
    the doubles."""
    file = KUKA / f"measurements_{run}.npz"
    folder = write_recording(
        tmp_path / "bag", import_arrays(file, ROOT / "examples" / "kuka_lwr4" / "import.yaml")
    )
    recording = read_recording(folder)
    with np.load(file) as arrays:
        np.testing.assert_array_equal(recording.link.position, arrays["positions"])
        np.testing.assert_array_equal(recording.link.velocity, arrays["velocities"])
        np.testing.assert_array_equal(recording.link.effort, arrays["torques"])
        seconds, rest = np.divmod(arrays["times"].ravel(), 1.0)
    np.testing.assert_array_equal(recording.link.stamp_ns // 10**9, seconds.astype(np.int64))
    np.testing.assert_allclose(recording.link.stamp_ns % 10**9, rest * 1e9, rtol=0, atol=0.5)
    assert recording.motor is None
    assert recording.n == 7
    assert check_bag(folder).ok
