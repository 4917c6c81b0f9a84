"""Write recordings as bags: arrays are written into the bytes of many messages at once."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, message_types
from elastic_arm.recording.inspection.report import check_times
from elastic_arm.recording.recording import Recording, recordings_of
from elastic_arm.recording.sides import Array, Side, Stamps
from elastic_arm.recording.storage.stream_writer import Compression, StreamWriter
from elastic_arm.recording.topics import (
    JOINT_STATES,
    JOINT_TORQUES,
    MOTOR_STATES,
    OF_MOTOR,
    REFERENCE,
    ROBOT_DESCRIPTION,
    TRANSFORMS,
    TYPES,
    type_of,
)

if TYPE_CHECKING:
    from elastic_arm.robot import Robot

_DRAWN = 50.0  # Hz, of what is looked at
_ROWS = 10_000  # messages of a topic that are laid out at a time
_STATE = ("position", "velocity", "effort")
_NOT_STATES = ("acceleration", *OF_MOTOR)
_TORQUES = ("joint_torque", "motor_torque", "joint_torque_std", "motor_torque_std")


@dataclass(frozen=True)
class Stream:
    """The messages of one topic to be written, which differ only in stamps and numbers."""

    topic: str  # its name
    stamp_ns: Stamps  # (N,) times of the messages
    template: bytes  # one message as CDR bytes
    # (N, count) numbers that replace those of the template, by field path
    values: dict[str, Array] = field(default_factory=dict)

    def messages(self) -> Iterator[tuple[int, str, bytes]]:
        """Yield stamp, topic and CDR bytes of each message."""
        for first in range(0, len(self.stamp_ns), _ROWS):
            part = slice(first, first + _ROWS)
            for stamp, row in zip(self.stamp_ns[part].tolist(), self._laid(part), strict=True):
                yield stamp, self.topic, row.tobytes()

    def _laid(self, part: slice) -> np.ndarray:
        """Return the bytes (N, size) of messages."""
        layout = cdr.layout_of(memoryview(self.template), type_of(self.topic))
        stamps = self.stamp_ns[part]
        laid = np.tile(np.frombuffer(self.template, np.uint8), (len(stamps), 1))
        seconds, nanoseconds = np.divmod(stamps, 1_000_000_000)
        columns = {path: values[part] for path, values in self.values.items()}
        for path in layout.numbers:
            if path.endswith("header.stamp.sec"):
                columns[path] = seconds[:, None]
            elif path.endswith("header.stamp.nanosec"):
                columns[path] = nanoseconds[:, None]
        for path, values in columns.items():
            numbers = layout.numbers[path]
            items = np.ascontiguousarray(values, dtype=numbers.dtype).view(np.uint8)
            laid[:, numbers.at : numbers.at + items.shape[1]] = items
        return laid


LAST_STAMP_NS = 2**31 * 1_000_000_000  # seconds have 32 bits, one of them the sign


def write_recording(
    path: str | Path,
    recording: Recording,
    compression: Compression = "zstd",
    further: Mapping[str, Side] = MappingProxyType({}),
    drawn: Robot | None = None,
) -> Path:
    """Write a recording as a rosbag2 bag (folder with metadata.yaml and one MCAP file).

    Parameters
    ----------
    path
        Folder to create; must not exist.
    recording
        The recording; log times equal the stamps.
    compression
        "none", "lz4" or "zstd".
    further
        Additional topics: topic -> a side of the same joints, as sensor_msgs/JointState.
    drawn
        The arm for viewers: its URDF replaces that of the recording, and `/tf` moves its links.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    RecordingError
        If the folder exists or cannot be written, or the recording is empty or has another type.
    """
    recordings_of(recording, "recording")
    if not isinstance(path, str | Path):
        raise RecordingError(
            f"path is of type {type(path).__name__}", "Give the name of the folder to create."
        )
    folder = Path(path)
    streams = _streams(recording, further) if drawn is None else _drawn(drawn, recording, further)
    if not any(len(stream.stamp_ns) for stream in streams):
        raise RecordingError("the recording contains no samples", "Nothing was written.")
    first_ns = min(int(stream.stamp_ns[0]) for stream in streams if len(stream.stamp_ns))
    if first_ns < 0:
        problem = (
            f"the recording starts at {first_ns * 1e-9:.6g} s, before time zero, which"
            " stamps of a bag cannot represent"
        )
        raise RecordingError(problem, "Add a constant to all times.")
    last_ns = max(int(stream.stamp_ns[-1]) for stream in streams if len(stream.stamp_ns))
    if last_ns >= LAST_STAMP_NS:
        problem = (
            f"the recording ends at {last_ns * 1e-9:.10g} s; the stamps of ROS end at 2^31 s, in"
            " January 2038"
        )
        raise RecordingError(problem, "Subtract a constant from all times.")
    unhurried = float("inf")
    writer = StreamWriter(
        folder,
        compression,
        flush_every=unhurried,
        sync_every=unhurried,
        currents=recording.currents,
        firmware_gains=recording.firmware_gains,
    )
    try:
        for stream in streams:
            writer.add_topic(stream.topic, type_of(stream.topic))
        in_order = heapq.merge(*(stream.messages() for stream in streams), key=itemgetter(0))
        for stamp, topic, data in in_order:
            writer.write(topic, data, stamp)
        writer.close()
    finally:
        writer.abandon()
    return folder


def _streams(recording: Recording, further: Mapping[str, Side]) -> list[Stream]:
    joints = list(recording.joints)
    streams = []
    if recording.robot_description is not None:
        message = _message("std_msgs/msg/String", data=recording.robot_description)
        streams.append(Stream(ROBOT_DESCRIPTION, np.array([recording.start_ns], np.int64), message))
    for topic, side in (
        (JOINT_STATES, recording.link),
        (MOTOR_STATES, recording.motor),
        *further.items(),
    ):
        if side is None:
            continue
        check_times(side.stamp_ns, topic)
        channels = {
            name: values for name, values in side.channels().items() if name not in _NOT_STATES
        }
        others = {name: values for name, values in side.channels().items() if name in OF_MOTOR}
        if channels or not others:
            streams.append(_of_joints(topic, joints, side.stamp_ns, _STATE, channels))
        for name, values in others.items():
            own = OF_MOTOR[name]
            streams.append(_of_joints(own, joints, side.stamp_ns, _STATE, {"effort": values}))
    has_motor = any(stream.topic == MOTOR_STATES for stream in streams)
    if recording.link is not None and recording.link.effort is not None and not has_motor:
        # Without a motor side nothing else marks the effort as the joint torque sensor's.
        torque = {"joint_torque": recording.link.effort}
        streams.append(_of_joints(JOINT_TORQUES, joints, recording.link.stamp_ns, _TORQUES, torque))
    if recording.reference is not None:
        streams.append(_reference(joints, recording.reference))
    return streams


def _drawn(robot: Robot, recording: Recording, further: Mapping[str, Side]) -> list[Stream]:
    """Return the streams with the arm's URDF and the positions of its links; without positions if
    an angle was not recorded."""
    # Few bags are drawn, and what that takes is slow to import.
    from scipy.spatial.transform import Rotation

    from elastic_arm.robot.urdf_export import to_urdf, urdf_placements

    streams = _streams(replace(recording, robot_description=to_urdf(robot)), further)
    sides = (side for side in (recording.link, recording.motor) if side is not None)
    side = next(
        (side for side in sides if side.position is not None and np.isfinite(side.position).all()),
        None,
    )
    if side is None:
        return streams
    rate = len(side) * 1e9 / (side.stamp_ns[-1] - side.stamp_ns[0] + 1)
    seen = side.at(slice(None, None, max(int(rate / _DRAWN), 1)))
    assert seen.position is not None
    types = message_types.typestore().types
    vector = types["geometry_msgs/msg/Vector3"]
    quaternion = types["geometry_msgs/msg/Quaternion"]
    still = types["geometry_msgs/msg/Transform"](
        vector(0.0, 0.0, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
    )
    stamped = []
    values = {}
    for k, (parent, child, placement) in enumerate(urdf_placements(robot, seen.position)):
        stamped.append(types["geometry_msgs/msg/TransformStamped"](_header(parent), child, still))
        turn = Rotation.from_matrix(
            placement[:, :3, :3].copy()
        ).as_quat()  # older SciPy takes no read-only arrays
        # The seven numbers of a transform lie side by side.
        values[f"transforms.{k}.transform.translation.x"] = np.concatenate(
            [placement[:, :3, 3], turn], axis=1
        )
    return [
        *streams,
        Stream(
            TRANSFORMS, seen.stamp_ns, _message(type_of(TRANSFORMS), transforms=stamped), values
        ),
    ]


def _of_joints(
    topic: str, joints: list[str], stamp_ns: Stamps, fields: Sequence[str], values: dict[str, Array]
) -> Stream:
    """Return messages that name joints, with numbers in the fields for which there are values."""
    blank = {name: np.zeros(len(joints) if name in values else 0) for name in fields}
    return Stream(
        topic, stamp_ns, _message(type_of(topic), header=_header(), name=joints, **blank), values
    )


def _reference(joints: list[str], side: Side) -> Stream:
    fields = {
        "position": "positions",
        "velocity": "velocities",
        "acceleration": "accelerations",
        "effort": "effort",
    }
    channels = side.channels()
    types = message_types.typestore().types
    blank = {
        path: np.zeros(len(joints) if name in channels else 0) for name, path in fields.items()
    }
    zero = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"](**blank, time_from_start=zero)
    message = _message(TYPES[REFERENCE], header=_header(), joint_names=joints, points=[point])
    values = {f"points.0.{fields[name]}": numbers for name, numbers in channels.items()}
    return Stream(REFERENCE, side.stamp_ns, message, values)


def _header(frame: str = "") -> Any:
    types = message_types.typestore().types
    return types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=frame
    )


def _message(type_name: str, **fields: Any) -> bytes:
    store = message_types.typestore()
    return bytes(store.serialize_cdr(store.types[type_name](**fields), type_name))
