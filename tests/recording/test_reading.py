"""Bags of other writers become recordings."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from elastic_arm.recording import Recording, message_types, read_recording, write_recording
from elastic_arm.recording.inspection.check import check_bag
from elastic_arm.recording.inspection.info import bag_info
from tests.helpers.bags import (
    JOINT_STATE,
    JOINTS,
    assert_equal,
    joint_state,
    side,
    stamps,
    states,
    write_foreign,
)


def _packed(writer: Writer) -> None:
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)


def _filed(writer: Writer) -> None:
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)


@pytest.mark.parametrize(
    "configure", [None, _packed, _filed], ids=["plain", "zstd chunks", "zstd file"]
)
def test_bags_of_another_writer_are_read(tmp_path: Path, configure) -> None:
    """Bags by rosbags are read, plain, with compressed chunks and compressed as a file."""
    link, motor = (states(topic, stamps(300)) for topic in ("/joint_states", "/motor_states"))
    both = [message for pair in zip(link, motor, strict=True) for message in pair]
    recording = read_recording(write_foreign(tmp_path / "bag", both, configure))
    np.testing.assert_allclose(
        recording.link.position, np.arange(300)[:, None] + [0, 0.1, 0.2], rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(recording.link.stamp_ns, stamps(300))
    np.testing.assert_array_equal(recording.motor.effort, recording.link.effort)


def test_joint_order_may_change_within_a_bag(tmp_path: Path) -> None:
    """Joints are matched by name, also where messages of several orders and lengths are mixed in
    one chunk."""
    rng = np.random.default_rng(3)
    messages = []
    for row, stamp in enumerate(stamps(400)):
        names = list(rng.permutation(JOINTS))
        base = [row + JOINTS.index(name) / 10 for name in names]
        frame = "base" * int(rng.integers(0, 3))
        messages.append(
            (
                "/joint_states",
                JOINT_STATE,
                int(stamp),
                joint_state(stamp, names, base, base, base, frame),
            )
        )
    recording = read_recording(write_foreign(tmp_path / "bag", messages))
    assert recording.joints == JOINTS
    np.testing.assert_allclose(
        recording.link.position, np.arange(400)[:, None] + [0, 0.1, 0.2], rtol=0, atol=1e-12
    )


def test_topics_in_irregular_turn_are_told_apart(tmp_path: Path) -> None:
    """Two topics and a foreign one, interleaved at random, are each read whole and in order."""
    rng = np.random.default_rng(5)
    queues = [states("/joint_states", stamps(2000)), states("/motor_states", stamps(1500))]
    text = message_types.typestore().serialize_cdr(
        message_types.typestore().types["std_msgs/msg/String"]("hello"), "std_msgs/msg/String"
    )
    queues.append([("/chatter", "std_msgs/msg/String", int(t), bytes(text)) for t in stamps(1000)])
    messages = []
    while any(queues):
        queue = queues[int(rng.choice([i for i, q in enumerate(queues) if q]))]
        messages.append(queue.pop(0))
    recording = read_recording(write_foreign(tmp_path / "bag", messages))
    np.testing.assert_array_equal(recording.link.stamp_ns, stamps(2000))
    np.testing.assert_array_equal(recording.motor.stamp_ns, stamps(1500))
    np.testing.assert_allclose(
        recording.motor.velocity[:, 0], np.arange(1500) + 0.01, rtol=0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("chunked", "index", "compression"),
    [
        (False, IndexType.NONE, CompressionType.NONE),
        (True, IndexType.ALL, CompressionType.LZ4),
        (True, IndexType.ALL, CompressionType.ZSTD),
        (True, IndexType.NONE, CompressionType.NONE),
    ],
    ids=["unchunked", "lz4", "zstd", "chunks without indexes"],
)
def test_files_of_the_mcap_library_are_read(
    tmp_path: Path, chunked: bool, index: IndexType, compression: CompressionType
) -> None:
    """Chunked or not, indexed or not, with definitions inside the chunks: the same recording."""
    text, _ = message_types.definition(JOINT_STATE)
    file = tmp_path / "run.mcap"
    with open(file, "wb") as stream:
        writer = McapWriter(
            stream,
            chunk_size=20_000,
            use_chunking=chunked,
            index_types=index,
            compression=compression,
        )
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", text.encode())
        for topic in ("/joint_states", "/motor_states"):
            channel = writer.register_channel(topic, "cdr", schema)
            for _, _, log_ns, data in states(topic, stamps(1000)):
                writer.add_message(channel, log_ns, data, log_ns)
        writer.finish()
    recording = read_recording(file)
    np.testing.assert_array_equal(recording.link.stamp_ns, stamps(1000))
    np.testing.assert_allclose(
        recording.motor.velocity[:, 1], np.arange(1000) + 0.11, rtol=0, atol=1e-12
    )
    assert bag_info(file).compression == [compression.name.lower() if chunked else "unchunked"]


def test_several_bags_make_one_recording(tmp_path: Path) -> None:
    """Two bags of one run, and a folder of several files, read as if never split."""
    first = stamps(200)
    second = stamps(200, start_ns=int(stamps(201)[-1]))
    bags = [
        write_foreign(
            tmp_path / name, states("/joint_states", part) + states("/motor_states", part)
        )
        for name, part in (("a", first), ("b", second))
    ]
    joined = read_recording(bags)
    np.testing.assert_array_equal(joined.motor.stamp_ns, stamps(400))
    (tmp_path / "split").mkdir()
    for number, bag in enumerate(bags):
        next(bag.glob("*.mcap")).rename(tmp_path / "split" / f"run_{number}.mcap")
    assert_equal(read_recording(tmp_path / "split"), joined)


def test_a_bag_split_by_size_is_read_in_the_order_of_its_metadata(tmp_path: Path) -> None:
    """As `ros2 bag record --max-bag-size` writes it: the tenth file follows the ninth."""
    parts = np.array_split(stamps(240), 12)
    folder = tmp_path / "bag"
    for number, part in enumerate(parts):
        messages = states("/joint_states", part) + states("/motor_states", part)
        bag = write_foreign(tmp_path / f"part_{number}", messages)
        folder.mkdir(exist_ok=True)
        next(bag.glob("*.mcap")).rename(folder / f"bag_{number}.mcap")
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    information["relative_file_paths"] = [f"bag_{number}.mcap" for number in range(12)]
    information.pop("files", None)
    information["message_count"] = 480
    for topic in information["topics_with_message_count"]:
        topic["message_count"] = 240
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    recording = read_recording(folder)
    np.testing.assert_array_equal(recording.link.stamp_ns, stamps(240))
    np.testing.assert_array_equal(recording.motor.stamp_ns, stamps(240))
    assert not [one for one in check_bag(folder).findings if one.severity == "error"]


def test_one_side_alone_is_read_with_its_effort_as_motor_torque(tmp_path: Path) -> None:
    """Without /motor_states the effort of /joint_states is the motor's torque, and the result says
    so."""
    recording = read_recording(
        write_foreign(tmp_path / "bag", states("/joint_states", stamps(100)))
    )
    samples = recording.samples()
    assert samples.tau_J is None
    assert samples.theta is None
    np.testing.assert_allclose(samples.tau_m[:, 0], np.arange(100) + 0.02, rtol=0, atol=1e-12)
    assert any("interpreted as the motor torque" in note for note in recording.notes)


def test_motor_side_alone_is_read(tmp_path: Path) -> None:
    """A bag with /motor_states alone, the commonest industrial arm, gives theta and tau_m and
    nothing else."""
    samples = read_recording(
        write_foreign(tmp_path / "bag", states("/motor_states", stamps(100)))
    ).samples()
    assert samples.q is None
    assert samples.theta is not None
    assert samples.tau_m is not None


def test_a_channel_that_is_nan_throughout_counts_as_missing(tmp_path: Path) -> None:
    """ROS 2 control fills what it does not measure with NaN: no channel, and a note."""
    nan = [float("nan")] * 3
    messages = [
        (topic, JOINT_STATE, int(t), joint_state(t, JOINTS, [1, 2, 3], nan, [1, 2, 3]))
        for t in stamps(50)
        for topic in ("/joint_states", "/motor_states")
    ]
    recording = read_recording(write_foreign(tmp_path / "bag", messages))
    assert recording.link.velocity is None
    assert any("NaN throughout" in note for note in recording.notes)


def test_a_gripper_on_the_same_topic_is_set_aside(tmp_path: Path) -> None:
    """Messages of other joints on /joint_states are left out, with a note, once the arm's joints
    are named."""
    gripper = [
        ("/joint_states", JOINT_STATE, int(t), joint_state(t, ["finger"], [0.1], [0.0], [0.0]))
        for t in stamps(100) + 300_000
    ]
    messages = sorted(
        states("/joint_states", stamps(100)) + gripper, key=lambda message: message[2]
    )
    recording = read_recording(write_foreign(tmp_path / "bag", messages), joints=JOINTS)
    np.testing.assert_array_equal(recording.link.stamp_ns, stamps(100))
    assert any("other joints" in note for note in recording.notes)


def test_joints_follow_the_robot_description_in_the_bag(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """Columns stand in the order of the URDF in the bag, whatever the messages say."""
    urdf = (
        "<robot name='r'><joint name='wrist' type='revolute'/><joint name='arm'"
        " type='revolute'/></robot>"
    )
    given = Recording(
        ("arm", "wrist"), side(rng, stamps(50), 2), side(rng, stamps(50), 2), robot_description=urdf
    )
    recording = read_recording(write_recording(tmp_path / "bag", given))
    assert recording.joints == ("wrist", "arm")
    np.testing.assert_array_equal(recording.link.position, given.link.position[:, ::-1])


def test_numbered_joints_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """joint_10 comes after joint_9, though the messages sort by letters."""
    names = [f"joint_{i}" for i in (1, 10, 2, 9)]
    messages = [
        ("/motor_states", JOINT_STATE, int(t), joint_state(t, names, [1, 10, 2, 9]))
        for t in stamps(20)
    ]
    recording = read_recording(write_foreign(tmp_path / "bag", messages))
    assert recording.joints == ("joint_1", "joint_2", "joint_9", "joint_10")
    assert recording.motor.position[0].tolist() == [1, 2, 9, 10]
