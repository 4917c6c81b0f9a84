"""Foreign bags and arrays become recordings by what their maps say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording import load_channels, message_types, read_recording, write_recording
from elastic_arm.recording.foreign.arrays import import_arrays, load_array_map
from elastic_arm.recording.inspection.check import check_bag
from tests.helpers.bags import JOINT_STATE, JOINTS, assert_equal, joint_state, stamps, states, write_foreign

ROOT = Path(__file__).parents[2]
KUKA = ROOT.parent / "shared" / "data" / "kuka_lwr4"


def write_yaml(path: Path, content: object) -> Path:
    """Write `content` as YAML."""
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def test_the_documented_maps_are_valid(tmp_path: Path) -> None:
    """The examples of docs/channel_maps.md load as they stand."""
    text = (ROOT / "docs" / "channel_maps.md").read_text()
    blocks = [block.split("```")[0] for block in text.split("```yaml\n")[1:]]
    kinds = []
    for block in blocks:
        content = yaml.safe_load(block)
        file = write_yaml(tmp_path / "map.yaml", content)
        kinds.append(type(load_array_map(file) if "times" in content else load_channels(file)).__name__)
    assert kinds == ["ChannelMap", "ChannelMap", "ArrayMap"]


def test_names_units_signs_and_ratios_are_applied(tmp_path: Path) -> None:
    """Degrees, rotor turns, rpm, currents and a reversed axis come out in SI units at the harmonic-drive output."""
    names = ["A2", "A1"]
    messages = []
    for row, stamp in enumerate(stamps(100)):
        messages.append(("/links", JOINT_STATE, int(stamp), joint_state(stamp, names, [row, 90.0], [1.0, 2.0])))
        messages.append(("/drives", JOINT_STATE, int(stamp), joint_state(stamp, names, [121, 242], [60, 30], [2, 3])))
    motor = {"topic": "/drives", "ratio": 121}
    channels = {
        "defaults": {
            "link": {
                "position": {"topic": "/links", "unit": "deg"},
                "velocity": {"topic": "/links", "unit": "deg/s"},
            },
            "motor": {
                "position": {**motor, "unit": "turns"},
                "velocity": {**motor, "unit": "rpm"},
                "effort": {**motor, "unit": "A", "torque_constant": 0.5},
            },
        },
        "joints": {
            "joint_1": {"name": "A1", "link": {"position": {"sign": -1}}},
            "joint_2": {"name": "A2", "motor": {"effort": {"factor": 2.0}}},
        },
    }
    bag = write_foreign(tmp_path / "bag", messages)
    recording = read_recording(bag, write_yaml(tmp_path / "map.yaml", channels))
    assert recording.joints == ("joint_1", "joint_2")
    np.testing.assert_allclose(recording.link.position[:, 0], -np.pi / 2)
    np.testing.assert_allclose(recording.link.position[:, 1], np.deg2rad(np.arange(100)))
    np.testing.assert_allclose(recording.link.velocity[0], np.deg2rad([2.0, 1.0]))
    np.testing.assert_allclose(recording.motor.position[0], [4 * np.pi, 2 * np.pi])
    np.testing.assert_allclose(recording.motor.velocity[0], np.array([1.0, 2.0]) * np.pi / 121)
    np.testing.assert_allclose(recording.motor.effort[0], [3 * 0.5 * 121, 2 * 0.5 * 121 * 2])
    assert recording.link.effort is None
    assert check_bag(bag, load_channels(tmp_path / "map.yaml")).ok


def test_arrays_without_header_and_names_are_read_by_index(tmp_path: Path) -> None:
    """A Float64MultiArray of currents is read by index, timed by its arrival, and joined to the angles' stamps."""
    store = message_types.typestore()
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    array = "std_msgs/msg/Float64MultiArray"
    messages = []
    for row, stamp in enumerate(stamps(200)):
        currents = store.types[array](layout, np.array([row, 10.0 + row]))
        messages.append(("/currents", array, int(stamp), bytes(store.serialize_cdr(currents, array))))
        messages.append(("/angles", JOINT_STATE, int(stamp), joint_state(stamp, ["a", "b"], [row, -row])))
    current = {"topic": "/currents", "field": "data", "unit": "A", "torque_constant": 0.1, "ratio": 50}
    joints = {
        name: {
            "motor": {"position": {"topic": "/angles", "name": name}, "effort": {**current, "index": index}},
        }
        for index, name in enumerate("ab")
    }
    channels = write_yaml(tmp_path / "map.yaml", {"time": "arrival", "joints": joints})
    recording = read_recording(write_foreign(tmp_path / "bag", messages), channels)
    np.testing.assert_allclose(recording.motor.effort, np.arange(200)[:, None] * 5.0 + [0, 50])
    np.testing.assert_allclose(recording.motor.position[:, 1], -np.arange(200))
    for joint in joints.values():
        del joint["motor"]["effort"]["index"]
    guess = write_yaml(tmp_path / "guess.yaml", {"time": "arrival", "joints": joints})
    with pytest.raises(RecordingError, match=r"several numbers in field 'data'.*its index"):
        read_recording(tmp_path / "bag", guess)


def test_the_joint_torque_sensor_is_believed_when_a_map_says_so(tmp_path: Path) -> None:
    """With a map the effort of /joint_states is what the map says, without /motor_states too."""
    source = {"topic": "/joint_states"}
    side = {"position": source, "effort": source}
    channels = write_yaml(tmp_path / "map.yaml", {"joints": {name: {"link": side} for name in JOINTS}})
    samples = read_recording(write_foreign(tmp_path / "b", states("/joint_states", stamps(50))), channels).samples()
    assert samples.tau_J is not None
    assert samples.tau_m is None


CHANNEL = {"topic": "/x"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"joints": {}}, "joints: has 0 entries, needs 1 or more"),
        ({"joint": {}}, "joint: unknown key"),
        ({"joints": {"a": {"link": {"position": {**CHANNEL, "unit": "degrees"}}}}}, "joints.a.link.position.unit"),
        ({"joints": {"a": {"link": {"position": {**CHANNEL, "unit": "Nm"}}}}}, "position cannot have unit Nm"),
        ({"joints": {"a": {"motor": {"effort": {**CHANNEL, "unit": "A"}}}}}, "unit A needs torque_constant"),
        ({"joints": {"a": {"motor": {"effort": {**CHANNEL, "unit": "Nm_motor"}}}}}, "needs ratio"),
        ({"joints": {"a": {"motor": {"effort": {**CHANNEL, "sign": 2}}}}}, "joints.a.motor.effort.sign"),
        ({"joints": {"a": {"motor": {"effort": {**CHANNEL, "factor": 0}}}}}, "factor must be a finite number"),
        ({"joints": {"a": {"motor": {"effort": {"field": "effort"}}}}}, "joints.a.motor.effort.topic: missing field"),
        ({"joints": {"a": {"link": {"position": CHANNEL}}, "b": {}}}, "every joint needs the same ones"),
        ({"joints": {"a": {"link": [1]}}}, "joints.a.link"),
        (["a"], "holds no fields"),
    ],
)
def test_wrong_channel_maps_are_refused_by_field(tmp_path: Path, content: object, words: str) -> None:
    """Each mistake in a map is named with the field it is in."""
    with pytest.raises(RecordingError) as caught:
        load_channels(write_yaml(tmp_path / "map.yaml", content))
    assert words in str(caught.value)
    assert "map.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"topic": "/nowhere"}, "no messages on /nowhere"),
        ({"name": "elbow"}, "joint elbow is missing in 30 messages. Joints there: joint_1, joint_2, joint_3"),
        ({"field": "torque"}, "no numbers in field 'torque'"),
        ({"field": "effort", "index": 7}, "no number 7 in field 'effort'"),
    ],
)
def test_maps_that_do_not_fit_the_bag_are_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    """What the map names and the bag lacks is said, with what there is."""
    source = {"topic": "/motor_states", "name": "joint_2", "field": "effort", **change}
    channels = write_yaml(tmp_path / "map.yaml", {"joints": {"a": {"motor": {"effort": source}}}})
    with pytest.raises(RecordingError) as caught:
        read_recording(write_foreign(tmp_path / "bag", states("/motor_states", stamps(30))), channels)
    assert words in str(caught.value)


MAPPING = {
    "times": {"key": "t"},
    "joints": ["joint_1", "joint_2"],
    "link": {"position": {"key": "q", "unit": "deg"}},
    "motor": {"effort": {"key": "i", "unit": "A", "torque_constant": [0.1, 0.2], "ratio": 100, "sign": [1, -1]}},
    "ignore": ["junk"],
}


def make_arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    t = 1.7e9 + np.arange(50) * 0.005
    return {"t": t, "q": rng.normal(size=(50, 2)), "i": rng.normal(size=(50, 2)), "junk": np.zeros(3)}


def test_npz_csv_and_mat_give_the_same_recording(tmp_path: Path) -> None:
    """The same arrays in three formats become the same recording, in SI units, and survive the bag."""
    arrays = make_arrays()
    np.savez(tmp_path / "a.npz", **arrays)
    scipy.io.savemat(tmp_path / "a.mat", {**arrays, "q": arrays["q"].T})
    table = np.column_stack([arrays["t"], arrays["q"], arrays["i"]])
    np.savetxt(tmp_path / "a.csv", table, fmt="%.17g", delimiter=",", header="t,q1,q2,i1,i2", comments="")
    mapping = write_yaml(tmp_path / "map.yaml", MAPPING)
    by_column = {
        **MAPPING,
        "link": {"position": {**MAPPING["link"]["position"], "key": ["q1", "q2"]}},
        "motor": {"effort": {**MAPPING["motor"]["effort"], "key": ["i1", "i2"]}},
    }
    recording = import_arrays(tmp_path / "a.npz", mapping)
    np.testing.assert_allclose(recording.link.position, np.deg2rad(arrays["q"]))
    np.testing.assert_allclose(recording.motor.effort, arrays["i"] * [10, -20])
    np.testing.assert_array_equal(recording.link.stamp_ns[0], 1_700_000_000_000_000_000)
    assert_equal(import_arrays(tmp_path / "a.mat", mapping), recording)
    assert_equal(import_arrays(tmp_path / "a.csv", write_yaml(tmp_path / "c.yaml", by_column)), recording)
    assert_equal(read_recording(write_recording(tmp_path / "bag", recording)), recording)


def test_a_constant_rate_stands_in_for_times(tmp_path: Path) -> None:
    """Arrays without times are timed by a rate."""
    np.savez(tmp_path / "a.npz", q=np.zeros((10, 1)))
    content = {"times": {"rate": 300}, "joints": ["a"], "link": {"position": {"key": "q"}}}
    recording = import_arrays(tmp_path / "a.npz", write_yaml(tmp_path / "map.yaml", content))
    assert recording.link.stamp_ns.tolist() == [round(k * 1e9 / 300) for k in range(10)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times": {"key": "time"}}, "no array time; there is t, q, i, junk"),
        ({"ignore": []}, "arrays junk are not mapped"),
        ({"joints": ["a", "b", "c"]}, "has 2 values for 3 joints"),
        ({"joints": ["a", "a"]}, "a name occurs twice"),
        ({"link": {"position": {"key": "q", "columns": [0]}}}, "q has shape (50, 1); 50 samples of 2 joints"),
        ({"link": {"position": {"key": "junk"}}, "ignore": ["q"]}, "junk has shape"),
        ({"times": {}}, "give either key or rate"),
        ({"robot_description": "no.urdf"}, "no.urdf: no such file"),
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
    joint = {"joints": ["a"], "link": {"position": {"key": "q"}}}
    for name, times in (("blanks", {"key": "t"}), ("one", {"rate": 100})):
        mapping = write_yaml(tmp_path / f"{name}.yaml", {"times": times, **joint})
        recording = import_arrays(tmp_path / f"{name}.csv", mapping)
        np.testing.assert_allclose(recording.link.position, table[:, 1:])


def test_bad_arrays_are_refused(tmp_path: Path) -> None:
    """NaN, times that go back, pickles and unknown formats are refused by name."""
    mapping = write_yaml(tmp_path / "map.yaml", MAPPING)
    for name, row, value, words in (("q", 7, np.nan, "position of joint_1 is nan"), ("t", 9, 1.0, "back in time")):
        arrays = make_arrays()
        arrays[name].flat[row * (2 if name == "q" else 1)] = value
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(RecordingError, match=words):
            import_arrays(tmp_path / "bad.npz", mapping)
    np.savez(tmp_path / "pickle.npz", **{**make_arrays(), "q": np.array([{}], dtype=object)})
    with pytest.raises(RecordingError, match="cannot be read"):
        import_arrays(tmp_path / "pickle.npz", mapping)
    for suffix in ("npz", "csv", "mat"):
        for content in (b"", b"\x00no arrays"):
            (tmp_path / f"other.{suffix}").write_bytes(content)
            with pytest.raises(RecordingError, match=f"other.{suffix}"):
                import_arrays(tmp_path / f"other.{suffix}", mapping)
    np.savez(tmp_path / "words.npz", **{**make_arrays(), "q": np.array([["a", "b"]] * 50)})
    with pytest.raises(RecordingError, match="no table of numbers"):
        import_arrays(tmp_path / "words.npz", mapping)
    (tmp_path / "a.xlsx").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"none of \.npz, \.csv, \.mat"):
        import_arrays(tmp_path / "a.xlsx", mapping)


@pytest.mark.skipif(not KUKA.exists(), reason=f"the KUKA LWR 4+ recordings are not in {KUKA}")
@pytest.mark.parametrize("run", [1, 2, 3])
def test_kuka_recordings_are_imported_exactly(tmp_path: Path, run: int) -> None:
    """Seven joints, both angles and sensed torques bit by bit; stamps within half a nanosecond of the doubles."""
    file = KUKA / f"measurements_{run}.npz"
    folder = write_recording(tmp_path / "bag", import_arrays(file, ROOT / "examples" / "kuka_lwr4" / "import.yaml"))
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
