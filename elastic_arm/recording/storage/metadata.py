"""The data that rosbag2 stores next to the messages: quality of service, and metadata.yaml as Jazzy
writes it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import parse_yaml
from elastic_arm.recording.topics import LATCHED, STREAM_DEPTH

METADATA_KEY = "rosbag2_bagfile_information"
TORQUE_CHANNELS = ("joint_torque", "motor_torque")
# record and key by which rosbag2 keeps the same inside an MCAP file
INSIDE = ("rosbag2", "serialized_metadata")
_CURRENTS = "torques_from_currents"  # custom data of a bag: channels, by spaces
_GAINS = "firmware_gains"  # custom data of a bag: joint=number, by spaces
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    # name, type_name: `/joint_states`, `sensor_msgs/msg/JointState`; an empty type where the file
    # does not hold it
    name: str
    type_name: str
    # definition, encoding: text that defines the type, empty where the file holds none, and its
    # language: "ros2msg" or "ros2idl"
    definition: str
    type_hash: str  # RIHS01 hash of the type; may be empty
    qos: str  # quality of service offered, as YAML
    encoding: str = ""


@dataclass
class StoredFile:
    """A file of a bag in any storage format.

    Its messages come from `blocks(strict)`, block by block. The methods here apply to formats
    without the respective data.
    """

    path: Path
    # its topics by their numbers; those that stand only inside chunks appear once its blocks have
    # been run through
    channels: dict[int, Topic] = field(default_factory=dict)
    # what is wrong with the file, in words; empty for a whole one
    damage: list[str] = field(default_factory=list)

    def topic(self, channel: int) -> Topic:
        """Return the topic of a channel; with an empty type where the file gives no schema."""
        if channel not in self.channels:
            problem = (
                f"{self.path}: messages of channel {channel}, which has no description in the file"
            )
            raise RecordingError(problem, "Record again.")
        return self.channels[channel]

    def currents(self) -> tuple[str, ...]:
        """Return torque channels that the file states to be currents times a constant."""
        return ()

    def firmware_gains(self) -> dict[str, float]:
        """Return numbers of the servos' registers of the position gain that the file states."""
        return {}

    def check_lengths(self) -> None:
        """Raise an error if the messages are stated to unpack to more than the limit.

        This applies if all messages are kept in memory.
        """

    def expected(self, _: int) -> int:
        """Return the number of messages on a channel that the file states; 0 if unknown."""
        return 0


def offered_qos(topic: str) -> str:
    """Return the nodes' quality of service on a topic as rosbag2 writes it (YAML)."""
    latched = f"/{topic.rpartition('/')[2]}" in LATCHED
    profile = {
        "history": "keep_last",
        "depth": 1 if latched else STREAM_DEPTH,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False)


def metadata(
    file: str,
    topics: Sequence[Topic],
    counts: Mapping[str, int],
    span: tuple[int, int],
    currents: Sequence[str] = (),
    firmware_gains: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Return the content of metadata.yaml, under its single key, for a file with messages in a time
    span."""
    custom = {_CURRENTS: " ".join(currents)} if currents else {}
    if firmware_gains:
        custom[_GAINS] = " ".join(f"{name}={gain:.10g}" for name, gain in firmware_gains.items())
    written = {
        "starting_time": {"nanoseconds_since_epoch": span[0]},
        "duration": {"nanoseconds": span[1] - span[0]},
        "message_count": sum(counts.values()),
    }
    return {
        "version": 9,  # of Jazzy's rosbag2
        "storage_identifier": "mcap",
        **written,
        "topics_with_message_count": [
            {"topic_metadata": _topic(topic), "message_count": counts[topic.name]}
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **written}],
        "custom_data": custom or None,
        "ros_distro": "jazzy",
    }


def stated_currents(information: object) -> tuple[str, ...]:
    """Return torque channels that a bag's metadata states to be currents times a constant."""
    stated = _custom(information, _CURRENTS).split()
    return tuple(name for name in TORQUE_CHANNELS if name in stated)


def stated_gains(information: object) -> dict[str, float]:
    """Return the numbers of the servos' registers of the position gain that a bag's metadata
    states, by joint."""
    found = {}
    for word in _custom(information, _GAINS).split():
        name, _, number = word.rpartition("=")
        try:
            gain = float(number)
        except ValueError:
            continue  # not as this package writes it
        if name and 0.0 < gain < float("inf"):
            found[name] = gain
    return found


def _custom(information: object, key: str) -> str:
    """Return an entry of the custom data of a bag's metadata; empty where there is none."""
    custom = information.get("custom_data") if isinstance(information, dict) else None
    stated = custom.get(key) if isinstance(custom, dict) else None
    return stated if isinstance(stated, str) else ""


def plain_data(text: str) -> Any:
    """Return the data in a YAML text of a bag; None if it is empty or not YAML."""
    try:
        return parse_yaml(text) if text else None
    except yaml.YAMLError:
        return None


def _topic(topic: Topic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": plain_data(topic.qos) or [],
        "type_description_hash": topic.type_hash,
    }
