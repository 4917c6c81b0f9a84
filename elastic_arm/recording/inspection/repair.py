"""A usable copy of a bag, beside it; the bag itself is never touched."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elastic_arm.errors import RecordingError
from elastic_arm.recording.reading import read_content
from elastic_arm.recording.series import Series
from elastic_arm.recording.sides import Stamps
from elastic_arm.recording.storage.bag import bag_stem, open_bag
from elastic_arm.recording.storage.messages import read_messages, read_topics
from elastic_arm.recording.stream_writer import StreamWriter
from elastic_arm.recording.topics import JOINT_STATES, JOINT_TORQUES, MOTOR_STATES, TYPES

_MENDED = (JOINT_STATES, MOTOR_STATES, JOINT_TORQUES)


@dataclass
class Repair:
    """What a repair did.

    Parameters
    ----------
    path
        The new bag.
    kept
        Messages in it.
    dropped
        What was left out, and what could not be mended, in words.
    """

    path: Path
    kept: int = 0
    dropped: list[str] = field(default_factory=list)


def repair_bag(path: str | Path, out: str | Path | None = None) -> Repair:
    """Copy what is usable of a bag into a new one.

    Damaged chunks and torn ends are left out. Of the joint topics so are messages that are not finite, and the fewest
    messages without which the stamps advance.

    Parameters
    ----------
    path
        Bag folder, .mcap or .db3 file.
    out
        New folder; `<name>_repaired` beside the bag by default.

    Raises
    ------
    RecordingError
        If nothing can be read, or the new bag cannot be written.
    """
    path = Path(path)
    repair = Repair(Path(out) if out is not None else path.with_name(f"{bag_stem(path)}_repaired"))
    content = read_content([open_bag(path)], _MENDED, strict=False)
    if not content.messages:
        raise RecordingError(f"{path}: nothing in it can be saved", "Record again.")
    repair.dropped += content.damage
    keep = {
        topic: _usable(series, repair.dropped)
        for topic, series in content.series.items()
        if series.type_name == TYPES[topic]
    }
    seen: Counter[str] = Counter()
    late = 0
    with StreamWriter(repair.path, sync_every=float("inf")) as writer:
        for topic in read_topics(path):
            # Without a definition in the bag the writer takes the type's known one.
            writer.add_topic(topic.name, topic.type_name, topic.definition or None, topic.type_hash, topic.qos)
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


def _usable(series: Series, dropped: list[str]) -> NDArray[np.bool_]:
    """(N,) True for the messages of a topic, in log order, that can be used; `dropped` gets what is left out."""
    finite = np.ones(series.count, dtype=bool)
    for name, joint, values in series.all_columns():
        good = np.isfinite(values)
        if good.sum() >= len(good) / 2:
            finite &= good
        else:
            dropped.append(f"{series.topic}.{name} of {joint} is mostly not finite and was left as it is")
    keep = finite.copy()
    rows = np.flatnonzero(finite)
    keep[rows] = _longest_advance(series.stamp_ns[rows])
    for count, reason in (
        (series.count - int(finite.sum()), "with numbers that are not finite"),
        (int(finite.sum() - keep.sum()), "whose stamps repeat or jump back in time"),
    ):
        if count:
            dropped.append(f"{count} of {series.count} messages on {series.topic} {reason}")
    return keep


def _longest_advance(stamp_ns: Stamps) -> NDArray[np.bool_]:
    """Mark a longest strictly increasing subsequence (patience sorting): so the fewest messages are left out."""
    if np.all(np.diff(stamp_ns) > 0):
        return np.ones(len(stamp_ns), dtype=bool)
    tails: list[int] = []
    last: list[int] = []
    before = np.full(len(stamp_ns), -1)
    for row, stamp in enumerate(stamp_ns.tolist()):
        place = bisect_left(tails, stamp)
        if place == len(tails):
            tails.append(stamp)
            last.append(row)
        else:
            tails[place], last[place] = stamp, row
        before[row] = last[place - 1] if place else -1
    keep = np.zeros(len(stamp_ns), dtype=bool)
    row = last[-1] if last else -1
    while row >= 0:
        keep[row] = True
        row = int(before[row])
    return keep
