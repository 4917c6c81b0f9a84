"""Recordings go into bags and come out again, and other libraries read the same."""

from pathlib import Path

import numpy as np
import pinocchio
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, message_types, read_recording, write_recording
from elastic_arm.recording.storage.stream_writer import StreamWriter
from elastic_arm.robot import Robot
from tests.helpers.bags import JOINT_STATE, JOINTS, assert_equal, side, stamps, two_sided
from tests.helpers.random_arms import random_arm

COMPRESSIONS = ("none", "lz4", "zstd")


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("n", [1, 3, 7])
def test_round_trip_is_exact(
    tmp_path: Path, rng: np.random.Generator, compression: str, n: int
) -> None:
    """What is written is read back bit by bit, over several chunks, for any number of joints and
    compression."""
    recording = two_sided(rng, 6000, n)
    assert_equal(
        read_recording(write_recording(tmp_path / "bag", recording, compression)), recording
    )


def test_sides_with_stamps_of_their_own_round_trip(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Jittered stamps, other rates, missing channels, a reference with acceleration and a URDF all
    survive."""
    jitter = np.sort(stamps(5000) + rng.integers(-200_000, 200_000, 5000))
    link = Side(jitter, position=rng.normal(size=(5000, 3)))
    motor = side(rng, stamps(2500, 2_000_000))
    reference = Side(
        stamps(5000),
        *(rng.normal(size=(5000, 3)) for _ in range(2)),
        None,
        rng.normal(size=(5000, 3)),
    )
    recording = Recording(JOINTS, link, motor, reference, robot_description="<robot name='a'/>")
    assert_equal(read_recording(write_recording(tmp_path / "bag", recording)), recording)


def test_joint_torques_alone_stay_joint_torques(tmp_path: Path, rng: np.random.Generator) -> None:
    """A link side with torque sensors and no motor side comes back as it was, not as motor
    torque."""
    recording = Recording(JOINTS, link=side(rng, stamps(500)))
    assert_equal(read_recording(write_recording(tmp_path / "bag", recording)), recording)


def test_rosbag2_reads_the_same_numbers(tmp_path: Path, rng: np.random.Generator) -> None:
    """The reader of `ros2 bag`, which comes with ROS alone, finds all messages and their types."""
    rosbag2_py = pytest.importorskip("rosbag2_py", reason="rosbag2 comes with ROS, not as a wheel")
    serialization = pytest.importorskip("rclpy.serialization")
    utilities = pytest.importorskip("rosidl_runtime_py.utilities")
    recording = two_sided(rng, 300)
    folder = write_recording(tmp_path / "bag", recording)
    reader = rosbag2_py.SequentialReader()
    reader.open(
        rosbag2_py.StorageOptions(uri=str(folder), storage_id="mcap"),
        rosbag2_py.ConverterOptions("cdr", "cdr"),
    )
    types = {topic.name: topic.type for topic in reader.get_all_topics_and_types()}
    positions = []
    while reader.has_next():
        topic, data, log_ns = reader.read_next()
        message = serialization.deserialize_message(data, utilities.get_message(types[topic]))
        stamp = message.header.stamp
        assert log_ns == stamp.sec * 10**9 + stamp.nanosec
        positions += [list(message.position)] if topic == "/joint_states" else []
    np.testing.assert_array_equal(positions, recording.link.position)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_rosbags_reads_the_same_numbers(
    tmp_path: Path, rng: np.random.Generator, compression: str
) -> None:
    """rosbags finds every message, in order of time, with the same numbers, names, types and
    hashes."""
    recording = two_sided(rng, 3000)
    folder = write_recording(tmp_path / "bag", recording, compression)
    rows: dict[str, list] = {"/joint_states": [], "/motor_states": []}
    last = 0
    with AnyReader([folder]) as reader:
        for connection in reader.connections:
            assert (connection.msgtype, connection.msgcount) == (JOINT_STATE, 3000)
            assert connection.digest == message_types.definition(JOINT_STATE)[1]
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert stamp_ns == log_ns >= last
            assert tuple(message.name) == JOINTS
            rows[connection.topic].append(
                np.concatenate([message.position, message.velocity, message.effort])
            )
            last = log_ns
    for topic, given in (("/joint_states", recording.link), ("/motor_states", recording.motor)):
        np.testing.assert_array_equal(
            rows[topic], np.hstack([given.position, given.velocity, given.effort])
        )


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_mcap_library_reads_the_same_numbers(
    tmp_path: Path, rng: np.random.Generator, compression: str
) -> None:
    """The MCAP project's own reader accepts checksums, indexes and summary, and decodes by the
    schemas in the file."""
    recording = two_sided(rng, 3000)
    folder = write_recording(tmp_path / "bag", recording, compression)
    positions = []
    with open(folder / "bag_0.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        statistics = reader.get_summary().statistics
        assert statistics.message_count == 6000
        assert statistics.message_start_time == recording.start_ns
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=["/motor_states"]):
            assert message.sequence == len(positions)
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            positions.append(decoded.position)
    np.testing.assert_array_equal(positions, recording.motor.position)


def test_transforms_move_the_links_of_the_urdf_beside_them(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """What viewers draw: at every stamp of /tf Pinocchio puts the links of /robot_description at
    the same places."""
    robot = random_arm(6, rng, prismatic={3})
    q = rng.uniform(-2.0, 2.0, (100, 6))
    at = 10_000_000 * np.arange(1, 101)  # 100 Hz, of which half is drawn
    folder = write_recording(
        tmp_path / "bag", Recording(robot.joint_names, Side(at, q)), drawn=robot
    )
    reader = make_reader((folder / "bag_0.mcap").open("rb"), decoder_factories=[DecoderFactory()])
    messages = [m for *_, m in reader.iter_decoded_messages(topics=["/tf"])]
    model = pinocchio.buildModelFromXML(read_recording(folder).robot_description)
    data = model.createData()
    assert len(messages) == 50
    for k, message in enumerate(messages):
        pinocchio.framesForwardKinematics(model, data, pinocchio_angles(model, robot, q[2 * k]))
        seen = {"world": np.eye(4)}
        for each in message.transforms:
            t = each.transform.translation
            r = each.transform.rotation
            inside = pinocchio.XYZQUATToSE3(
                np.array([t.x, t.y, t.z, r.x, r.y, r.z, r.w])
            ).homogeneous
            seen[each.child_frame_id] = seen[each.header.frame_id] @ inside
            assert each.header.stamp.nanosec == at[2 * k] % 1_000_000_000
            frame = data.oMf[model.getFrameId(each.child_frame_id)].homogeneous
            np.testing.assert_allclose(seen[each.child_frame_id], frame, atol=1e-9)
        assert set(robot.link_names) <= set(seen)


def pinocchio_angles(model: pinocchio.Model, robot: Robot, q: np.ndarray) -> np.ndarray:
    """Return angles as Pinocchio takes them: cosine and sine of joints without limits."""
    values = dict(zip(robot.joint_names, q, strict=True))
    each = (
        (values[name], joint.nq)
        for name, joint in zip(model.names[1:], model.joints[1:], strict=True)
    )
    return np.concatenate([[v] if nq == 1 else [np.cos(v), np.sin(v)] for v, nq in each])


def test_metadata_is_what_rosbag2_of_jazzy_writes(tmp_path: Path, rng: np.random.Generator) -> None:
    """metadata.yaml has every key of version 9, with counts, span and quality of service."""
    folder = write_recording(tmp_path / "bag", two_sided(rng, 100))
    told = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert set(told) == {
        *(
            "version",
            "storage_identifier",
            "duration",
            "starting_time",
            "message_count",
            "topics_with_message_count",
        ),
        *(
            "compression_format",
            "compression_mode",
            "relative_file_paths",
            "files",
            "custom_data",
            "ros_distro",
        ),
    }
    assert (told["version"], told["storage_identifier"], told["message_count"]) == (9, "mcap", 200)
    assert told["duration"]["nanoseconds"] == 99_000_000
    assert told["relative_file_paths"] == ["bag_0.mcap"]
    topic = told["topics_with_message_count"][0]["topic_metadata"]
    assert topic["type_description_hash"].startswith("RIHS01_")
    assert topic["offered_qos_profiles"][0]["reliability"] == "reliable"


def test_nothing_is_overwritten(tmp_path: Path, rng: np.random.Generator) -> None:
    """Writing onto an existing folder is refused, and the folder stays as it was."""
    recording = two_sided(rng, 50)
    folder = write_recording(tmp_path / "bag", recording)
    before = (folder / "bag_0.mcap").read_bytes()
    with pytest.raises(RecordingError, match="already exists"):
        write_recording(folder, two_sided(rng, 60))
    assert (folder / "bag_0.mcap").read_bytes() == before


def test_names_that_no_disk_takes_are_refused_in_words(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """A name of 300 letters is too long for a folder, whoever asks for it."""
    folder = tmp_path / ("n" * 300)
    with pytest.raises(RecordingError, match="too long"):
        write_recording(folder, two_sided(rng, 50))
    with pytest.raises(RecordingError, match="too long"):
        StreamWriter(folder)


def test_recordings_that_cannot_be_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """Empty recordings, stamps that do not advance and columns that do not fit the joints are
    refused on writing."""
    with pytest.raises(RecordingError, match="contains no samples"):
        write_recording(tmp_path / "a", Recording(JOINTS))
    with pytest.raises(RecordingError, match="/joint_states jumps back in time"):
        write_recording(tmp_path / "b", Recording(JOINTS, link=side(rng, stamps(20)[::-1].copy())))
    with pytest.raises(RecordingError, match="link position has 2 columns for 3 joints"):
        Recording(JOINTS, link=side(rng, stamps(20), 2))
    with pytest.raises(RecordingError, match="position has shape"):
        Side(stamps(20), position=np.zeros((19, 3)))
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("stated", [7, "motor_torque nothing", ["motor_torque"], {"a": 1}])
def test_what_a_bag_states_of_currents_is_taken_as_far_as_it_makes_sense(
    tmp_path: Path, rng: np.random.Generator, stated: object
) -> None:
    """A bag's own data hold anything; names of torque channels count, and nothing else."""
    folder = write_recording(tmp_path / "bag", two_sided(rng, 50))
    file = folder / "metadata.yaml"
    told = yaml.safe_load(file.read_text())
    told["rosbag2_bagfile_information"]["custom_data"] = {"torques_from_currents": stated}
    file.write_text(yaml.safe_dump(told))
    assert read_recording(folder).currents == (("motor_torque",) if isinstance(stated, str) else ())


def test_own_messages_match_their_ros_text() -> None:
    """Every .msg of elastic_arm_msgs parses, and an own message survives its round through CDR."""
    store = message_types.typestore()
    own = [name for name in store.fielddefs if name.startswith("elastic_arm_msgs/")]
    assert {"JointTorques", "ParameterEstimate", "GapDiagnosis"} <= {
        name.split("/")[-1] for name in own
    }
    for name in own:
        text, type_hash = message_types.definition(name)
        assert type_hash.startswith("RIHS01_")
        assert text
    torques = store.types["elastic_arm_msgs/msg/JointTorques"]
    header = store.types["std_msgs/msg/Header"](
        store.types["builtin_interfaces/msg/Time"](1, 2), ""
    )
    given = torques(header, ["a"], np.array([1.0]), np.array([2.0]), np.zeros(0), np.array([0.26]))
    again = store.deserialize_cdr(
        store.serialize_cdr(given, torques.__msgtype__), torques.__msgtype__
    )
    assert again.motor_torque.tolist() == [2.0]
    assert again.header.stamp.nanosec == 2
