"""Bags for the tests of the recording package, some written by libraries that are not ours."""

import shutil
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side, message_types, read_recording
from elastic_arm.recording.foreign.arrays import import_arrays
from elastic_arm.recording.inspection.check import check_bag

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINTS = ("joint_1", "joint_2", "joint_3")
START_NS = 1_700_000_000_123_456_789


def stamps(count: int, step_ns: int = 1_000_000, start_ns: int = START_NS) -> np.ndarray:
    """(count,) equally spaced stamps."""
    return start_ns + step_ns * np.arange(count, dtype=np.int64)


def side(rng: np.random.Generator, stamp_ns: np.ndarray, n: int = 3) -> Side:
    """Random numbers, so that no two values are alike."""
    return Side(stamp_ns, *(rng.normal(size=(len(stamp_ns), n)) for _ in range(3)))


def two_sided(rng: np.random.Generator, count: int, n: int = 3) -> Recording:
    """A recording of both sides on one clock."""
    names = tuple(f"joint_{i + 1}" for i in range(n))
    return Recording(names, side(rng, stamps(count), n), side(rng, stamps(count), n))


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position: Iterable[float] = (),
    velocity: Iterable[float] = (),
    effort: Iterable[float] = (),
    frame: str = "",
) -> bytes:
    """One sensor_msgs/JointState as CDR, by rosbags."""
    store = message_types.typestore()
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
    numbers = [np.array(list(values), dtype=np.float64) for values in (position, velocity, effort)]
    return bytes(
        store.serialize_cdr(types[JOINT_STATE](header, list(names), *numbers), JOINT_STATE)
    )


def write_foreign(
    folder: Path,
    messages: Iterable[tuple[str, str, int, bytes]],
    configure: Callable[[Writer], None] | None = None,
    storage: StoragePlugin = StoragePlugin.MCAP,
) -> Path:
    """Write (topic, type, log time, bytes) with rosbags' own writer."""
    shutil.rmtree(folder, ignore_errors=True)
    writer = Writer(folder, version=9, storage_plugin=storage)
    if configure is not None:
        configure(writer)
    connections: dict[str, object] = {}
    with writer:
        for topic, type_name, log_ns, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, type_name, typestore=message_types.typestore()
                )
            writer.write(connections[topic], log_ns, data)
    return folder


def write_sqlite(
    folder: Path,
    messages: Iterable[tuple[str, str, int, bytes]],
    configure: Callable[[Writer], None] | None = None,
) -> Path:
    """The same, stored with SQLite."""
    return write_foreign(folder, messages, configure, StoragePlugin.SQLITE3)


def states(
    topic: str, stamp_ns: Iterable[int], names: Sequence[str] = JOINTS
) -> list[tuple[str, str, int, bytes]]:
    """JointState messages whose numbers tell joint and row: position row + joint/10, velocity and
    effort beyond."""
    rows = []
    for row, stamp in enumerate(stamp_ns):
        base = [row + (JOINTS.index(name) if name in JOINTS else 5) / 10 for name in names]
        data = joint_state(
            int(stamp), names, base, [b + 0.01 for b in base], [b + 0.02 for b in base]
        )
        rows.append((topic, JOINT_STATE, int(stamp), data))
    return rows


def flat(recording: Recording) -> dict[str, np.ndarray]:
    """All arrays of a recording by name, to compare two of them."""
    arrays = {}
    for name, values in recording.sides().items():
        arrays[f"{name}.stamp_ns"] = values.stamp_ns
        arrays |= {f"{name}.{channel}": numbers for channel, numbers in values.channels().items()}
    return arrays


def assert_equal(one: Recording, other: Recording) -> None:
    """Fail unless both recordings hold the same bits."""
    left, right = flat(one), flat(other)
    assert left.keys() == right.keys()
    for name, values in left.items():
        np.testing.assert_array_equal(values, right[name], err_msg=name)
    assert one.joints == other.joints
    assert one.robot_description == other.robot_description


def both(stamp_ns: Iterable[int]) -> list[tuple[str, str, int, bytes]]:
    """Messages of both sides in turn."""
    pairs = zip(states("/joint_states", stamp_ns), states("/motor_states", stamp_ns), strict=True)
    return [message for pair in pairs for message in pair]


def codes(path: Path, **options: Any) -> set[str]:
    """Codes of all that the check finds but notes."""
    return {
        finding.code
        for finding in check_bag(path, **options).findings
        if finding.severity != "note"
    }


def write_yaml(path: Path, content: object) -> Path:
    """Write `content` as YAML."""
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def imported(path: Path, joints: Sequence[str], times: object, **mapping: object) -> Recording:
    """Import arrays by a mapping of these joints; `times` is a rate in Hz, the name of an array, or
    a block."""
    block = (
        times if isinstance(times, dict) else {"rate" if isinstance(times, float) else "key": times}
    )
    return import_arrays(
        path,
        write_yaml(path.parent / "map.yaml", {"times": block, "joints": list(joints), **mapping}),
    )


def holds_samples(bag: Path) -> bool:
    """Return whether a bag that is being recorded holds both sides by now."""
    try:
        recording = read_recording(bag)
    except RecordingError:
        return False
    return recording.link is not None and recording.motor is not None
