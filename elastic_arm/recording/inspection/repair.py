"""Write a usable copy of a bag; the bag itself is never changed."""

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from elastic_arm.arrays import Mask
from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import ChannelMap
from elastic_arm.recording.reading import contents
from elastic_arm.recording.series import Series
from elastic_arm.recording.storage.bag import bag_stem
from elastic_arm.recording.storage.messages import read_messages, read_topics
from elastic_arm.recording.storage.stream_writer import StreamWriter
from elastic_arm.recording.topics import (
    JOINT_STATES,
    JOINT_TORQUES,
    MOTOR_STATES,
    OF_MOTOR,
    TYPES,
)

_MENDED = (JOINT_STATES, MOTOR_STATES, JOINT_TORQUES, *OF_MOTOR.values())


@dataclass
class Repair:
    """The result of a repair: the new bag, its number of messages, and what was left out or could
    not be repaired."""

    path: Path
    kept: int = 0
    dropped: list[str] = field(default_factory=list)


def repair_bag(
    path: str | Path, out: str | Path | None = None, channels: ChannelMap | None = None
) -> Repair:
    """Copy the usable content of a bag into a new bag, by default `<name>_repaired` next to it.

    Damaged chunks, torn ends and messages with non-finite numbers in the joint topics (or the
    fields of a channel map) are left out. Stamps are not changed, because readers sort messages.
    """
    path = Path(path)
    repair = Repair(Path(out) if out is not None else path.with_name(f"{bag_stem(path)}_repaired"))
    topics = list(read_topics(path))
    # Of all arms that are in it, by their namespaces.
    of_arms = {
        t.name
        for t in topics
        for name in _MENDED
        if t.name.endswith(name) and t.type_name == TYPES[name]
    }
    mapped = {} if channels is None else channels.fields()
    (content,) = contents(path, wanted=of_arms | set(mapped), strict=False)
    if not content.messages:
        raise RecordingError(f"{path}: no data can be saved", "Record again.")
    repair.dropped += content.damage
    keep = {
        topic: _finite(series, mapped.get(topic), repair.dropped)
        for topic, series in content.series.items()
    }
    seen: Counter[str] = Counter()
    late = 0
    with StreamWriter(repair.path, sync_every=float("inf")) as writer:
        for topic in topics:
            # Without a definition in the bag the writer takes the type's known one.
            writer.add_topic(
                topic.name, topic.type_name, topic.definition or None, topic.type_hash, topic.qos
            )
        for message in read_messages(path, strict=False):
            number = seen[message.topic]
            seen[message.topic] += 1
            if min(message.log_ns, message.publish_ns) < 0:
                late += 1
            elif message.topic not in keep or keep[message.topic][number]:
                writer.write(message.topic, message.data, message.log_ns, message.publish_ns)
                repair.kept += 1
    if late:
        repair.dropped.append(f"{late} messages logged or sent after the year 2262")
    return repair


def _finite(series: Series, fields: set[str] | None, dropped: list[str]) -> Mask:
    """Return which messages (N,) of a topic, in log order, contain finite numbers; `dropped`
    receives those left out."""
    good = np.ones(series.count, np.bool_)
    log_ns = np.empty(series.count, np.int64)
    for piece in series.pieces:
        own = (
            piece.values
            if fields is None
            else {path: piece.values[path] for path in fields & piece.values.keys()}
        )
        good[piece.rows] = replace(piece, values=own).finite()
        log_ns[piece.rows] = piece.log_ns
        for path, values in own.items():
            mostly = np.isfinite(values).mean(axis=0) < 0.5
            names = [name for name, none in zip(piece.names, mostly.tolist(), strict=False) if none]
            dropped += [
                f"{series.topic}.{path} of {name} is mostly not finite and is unchanged"
                for name in names
            ]
    if not good.all():
        dropped.append(
            f"{(~good).sum()} of {series.count} messages on {series.topic} with numbers that are"
            " not finite"
        )
    return good[np.argsort(log_ns, kind="stable")]
