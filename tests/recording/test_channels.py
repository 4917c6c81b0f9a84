"""Foreign bags and arrays become recordings by what their maps say."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.recording import load_channels, message_types, read_recording, write_recording
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import load_array_map
from elastic_arm.recording.foreign.channels import (
    ChannelMap,
    ChannelScale,
    coupled,
    coupling_matrix,
)
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.sides import Side
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    imported,
    joint_state,
    stamps,
    states,
    write_foreign,
    write_yaml,
)

ROOT = Path(__file__).parents[2]


def test_the_documented_maps_are_valid(tmp_path: Path) -> None:
    """The examples of docs/channel_maps.md load as they stand."""
    text = (ROOT / "docs" / "channel_maps.md").read_text()
    blocks = [block.split("```")[0] for block in text.split("```yaml\n")[1:]]
    kinds = []
    for block in blocks:
        content = yaml.safe_load(block)
        file = write_yaml(tmp_path / "map.yaml", content)
        kinds.append(
            type(load_array_map(file) if "times" in content else load_channels(file)).__name__
        )
    assert kinds == ["ChannelMap", "ChannelMap", "ArrayMap"]


def test_names_units_signs_and_ratios_are_applied(tmp_path: Path) -> None:
    """Degrees, rotor turns, rpm, currents and a reversed axis come out in SI units at the
    harmonic-drive output."""
    names = ["A2", "A1"]
    messages = []
    for row, stamp in enumerate(stamps(100)):
        messages.append(
            ("/links", JOINT_STATE, int(stamp), joint_state(stamp, names, [row, 90.0], [1.0, 2.0]))
        )
        messages.append(
            (
                "/drives",
                JOINT_STATE,
                int(stamp),
                joint_state(stamp, names, [121, 242], [60, 30], [2, 3]),
            )
        )
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
    assert recording.currents == ("motor_torque",)
    assert check_bag(bag, load_channels(tmp_path / "map.yaml")).ok


def test_arrays_without_header_and_names_are_read_by_index(tmp_path: Path) -> None:
    """A Float64MultiArray of currents is read by index, timed by its arrival, and joined to the
    angles' stamps."""
    store = message_types.typestore()
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    array = "std_msgs/msg/Float64MultiArray"
    messages = []
    for row, stamp in enumerate(stamps(200)):
        currents = store.types[array](layout, np.array([row, 10.0 + row]))
        messages.append(
            ("/currents", array, int(stamp), bytes(store.serialize_cdr(currents, array)))
        )
        messages.append(
            ("/angles", JOINT_STATE, int(stamp), joint_state(stamp, ["a", "b"], [row, -row]))
        )
    current = {
        "topic": "/currents",
        "field": "data",
        "unit": "A",
        "torque_constant": 0.1,
        "ratio": 50,
    }
    joints = {
        name: {
            "motor": {
                "position": {"topic": "/angles", "name": name},
                "effort": {**current, "index": index},
            }
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
    channels = write_yaml(
        tmp_path / "map.yaml", {"joints": {name: {"link": side} for name in JOINTS}}
    )
    samples = read_recording(
        write_foreign(tmp_path / "b", states("/joint_states", stamps(50))), channels
    ).samples()
    assert samples.tau_J is not None
    assert samples.tau_m is None


def test_commands_of_any_topic_are_the_reference(tmp_path: Path) -> None:
    """A map's `command` is read as a side is, in its own units, and survives the suite's own
    bag."""
    messages = [m for stamp in stamps(60) for m in states("/joint_states", [stamp])]
    messages += [
        ("/targets", JOINT_STATE, int(t), joint_state(t, ["x", "y"], [k, -k]))
        for k, t in enumerate(stamps(30))
    ]
    joints = {
        JOINTS[k]: {
            "motor": {"position": {"topic": "/joint_states", "name": JOINTS[k]}},
            "command": {"position": {"topic": "/targets", "name": "xy"[k], "unit": "deg"}},
        }
        for k in range(2)
    }
    bag = write_foreign(tmp_path / "bag", sorted(messages, key=lambda message: message[2]))
    recording = read_recording(bag, write_yaml(tmp_path / "map.yaml", {"joints": joints}))
    np.testing.assert_allclose(
        recording.reference.position, np.deg2rad(np.outer(np.arange(30), [1, -1]))
    )
    np.testing.assert_array_equal(recording.reference.stamp_ns, stamps(30))
    again = read_recording(write_recording(tmp_path / "own", recording)).reference
    np.testing.assert_array_equal(again.position, recording.reference.position)


CHANNEL = {"topic": "/x"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"joints": {}}, "joints: has 0 entries, but needs at least 1"),
        ({"joint": {}}, "joint: unknown key"),
        (
            {"joints": {"a": {"link": {"position": {**CHANNEL, "unit": "degrees"}}}}},
            "joints.a.link.position.unit",
        ),
        (
            {"joints": {"a": {"link": {"position": {**CHANNEL, "unit": "Nm"}}}}},
            "position cannot have unit Nm",
        ),
        (
            {"joints": {"a": {"motor": {"effort": {**CHANNEL, "unit": "A"}}}}},
            "unit A needs torque_constant",
        ),
        ({"joints": {"a": {"motor": {"effort": {**CHANNEL, "unit": "Nm_motor"}}}}}, "needs ratio"),
        (
            {"joints": {"a": {"motor": {"effort": {**CHANNEL, "sign": 2}}}}},
            "joints.a.motor.effort.sign",
        ),
        (
            {"joints": {"a": {"motor": {"effort": {**CHANNEL, "factor": 0}}}}},
            "factor must be a finite number",
        ),
        (
            {"joints": {"a": {"motor": {"effort": {"field": "effort"}}}}},
            "joints.a.motor.effort.topic: missing field",
        ),
        (
            {"joints": {"a": {"link": {"position": {**CHANNEL, "index": True}}}}},
            "index: is yes or no, not a number",
        ),
        ({"joints": {"a": {"link": {"position": CHANNEL}}, "b": {}}}, "b has no channel"),
        ({"joints": {"a": {"link": [1]}}}, "joints.a.link"),
        (["a"], "contains no fields"),
    ],
)
def test_wrong_channel_maps_are_refused_by_field(
    tmp_path: Path, content: object, words: str
) -> None:
    """Each mistake in a map is named with the field it is in."""
    with pytest.raises(RecordingError) as caught:
        load_channels(write_yaml(tmp_path / "map.yaml", content))
    assert words in str(caught.value)
    assert "map.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"topic": "/nowhere"}, "no messages on /nowhere"),
        (
            {"name": "elbow"},
            "no message on /motor_states contains elbow; the joints are joint_1, joint_2, joint_3",
        ),
        ({"field": "torque"}, "no numbers in field 'torque'"),
        ({"field": "effort", "index": 7}, "no number 7 in field 'effort'"),
    ],
)
def test_maps_that_do_not_fit_the_bag_are_refused(
    tmp_path: Path, change: dict[str, object], words: str
) -> None:
    """What the map names and the bag lacks is said, with what there is."""
    source = {"topic": "/motor_states", "name": "joint_2", "field": "effort", **change}
    channels = write_yaml(tmp_path / "map.yaml", {"joints": {"a": {"motor": {"effort": source}}}})
    with pytest.raises(RecordingError) as caught:
        read_recording(
            write_foreign(tmp_path / "bag", states("/motor_states", stamps(30))), channels
        )
    assert words in str(caught.value)


def test_a_linear_axis_has_lengths_and_forces() -> None:
    """Positions in mm, speeds in mm/s and forces in N; a motor shaft's torque by its rad per m is a
    force."""
    assert ChannelScale(unit="mm").scale("position") == pytest.approx(1e-3)
    assert ChannelScale(unit="mm/s").scale("velocity") == pytest.approx(1e-3)
    assert ChannelScale(unit="N", factor=35.15).scale("effort") == pytest.approx(35.15)
    assert ChannelScale(unit="Nm_motor", ratio=628.0).scale("effort") == pytest.approx(628.0)
    with pytest.raises(ValueError, match="effort cannot have unit mm"):
        ChannelScale(unit="mm").check_unit("effort")


WRIST = {"b": {"a": 0.02, "b": 1.0}, "c": {"a": -0.01, "b": 0.5, "c": -1.0}}
AXES = ["a", "b", "c"]
MOTORS = {"position": {"key": "angle"}, "velocity": {"key": "speed"}, "effort": {"key": "torque"}}


def test_angles_go_by_the_matrix_and_torques_keep_their_power(tmp_path: Path) -> None:
    """theta = C theta_motors joint by joint, and the power of all motors is that at the joints."""
    angle, speed, torque = np.random.default_rng(0).standard_normal((3, 50, 3))
    np.savez(tmp_path / "run.npz", angle=angle, speed=speed, torque=torque)
    motor = imported(tmp_path / "run.npz", AXES, 100.0, motor=MOTORS, coupling=WRIST).motor
    np.testing.assert_allclose(
        motor.position[:, 2], -0.01 * angle[:, 0] + 0.5 * angle[:, 1] - angle[:, 2]
    )
    np.testing.assert_array_equal(motor.position[:, 0], angle[:, 0])
    power = [np.sum(a * b, axis=1) for a, b in ((motor.velocity, motor.effort), (speed, torque))]
    np.testing.assert_allclose(*power, atol=1e-12)


def test_a_channel_map_has_the_same_coupling() -> None:
    """Bags are uncoupled as arrays are; what is not recorded stays so."""
    source = {"topic": "/drives", "field": "position"}
    joints = {name: {"motor": {"position": {**source, "name": name}}} for name in AXES}
    rules = ChannelMap.model_validate({"joints": joints, "coupling": WRIST})
    side = coupled(Side(np.arange(2), position=np.eye(2, 3)), coupling_matrix(rules.coupling, AXES))
    assert side is not None and side.effort is None and side.position is not None
    np.testing.assert_allclose(side.position, [[1.0, 0.02, -0.01], [0.0, 1.0, 0.5]])
    assert coupled(None, np.eye(3)) is None


@pytest.mark.parametrize(
    ("coupling", "words"),
    [
        ({"d": {"a": 1.0}}, "unknown joint d"),
        ({"b": {"e": 1.0}}, "unknown joint e"),
        ({"b": {"a": 1.0}}, "cannot move"),
        ({"b": {"b": float("nan")}}, "not finite"),
    ],
)
def test_what_is_no_coupling_is_refused(
    coupling: dict[str, dict[str, float]], words: str, tmp_path: Path
) -> None:
    """Unknown names, and motors that cannot move the joints apart, are named."""
    np.savez(tmp_path / "run.npz", angle=np.eye(3), speed=np.eye(3), torque=np.eye(3))
    with pytest.raises(RecordingError, match=words):
        imported(tmp_path / "run.npz", AXES, 100.0, motor=MOTORS, coupling=coupling)


def test_a_bag_and_the_other_kind_of_map_are_named(tmp_path: Path) -> None:
    """A bag is not imported, as a folder or as a file; a channel map is no mapping of arrays, nor
    the other way round."""
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    (bag / "a.mcap").write_bytes(b"")
    for path in (bag, bag / "a.mcap"):
        with pytest.raises(RecordingError, match="is a bag, which needs no import") as caught:
            load_arrays(path)
        assert "--channels" in caught.value.remedy
    of_bag = tmp_path / "channels.yaml"
    of_bag.write_text("defaults: {link: {position: {topic: /a}}}\njoints: {a: {}}\n")
    of_arrays = tmp_path / "import.yaml"
    of_arrays.write_text("times: {key: t}\njoints: [a]\nlink: {position: {key: q}}\n")
    with pytest.raises(RecordingError, match="is a channel map") as caught:
        load_array_map(of_bag)
    assert "--channels" in caught.value.remedy
    with pytest.raises(RecordingError, match="is a mapping of arrays") as caught:
        load_channels(of_arrays)
    assert "bag import" in caught.value.remedy
