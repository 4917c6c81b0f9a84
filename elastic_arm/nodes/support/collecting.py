"""Convert the messages of two state topics to samples of the arm."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.errors import RecordingError
from elastic_arm.nodes.support.pairing import Losses, Pairing
from elastic_arm.nodes.support.wire import Inbox
from elastic_arm.recording import Samples, topics
from elastic_arm.recording.foreign.channels import (
    CHANNEL_NAMES,
    ChannelMap,
    SideChannels,
)
from elastic_arm.recording.sides import SAMPLED
from elastic_arm.recording.topics import OF_MOTOR

FIELDS = ("position", "velocity", "effort")
NAMED = {topics.JOINT_STATES: "link", topics.MOTOR_STATES: "motor"}
SIDES = {"both": tuple(NAMED), "link": (topics.JOINT_STATES,), "motor": (topics.MOTOR_STATES,)}
# A topic that says nothing for so long, seconds, has gone silent; but only when somebody has looked
# so often: after a stall of this process its messages are still on their way in.
SILENCE = 1.0
LOOKS = 5


@dataclass
class Faults:
    """Messages that could not be used."""

    foreign: int = 0  # they do not name all joints of the arm
    not_finite: int = 0  # they hold a number that is none
    changed: int = 0  # they lack, or add, a channel that those before had, or had not


@dataclass(frozen=True)
class DriverSide:
    """One side of all joints: its topic, and the channels of each joint."""

    topic: str
    joints: Sequence[SideChannels]

    @staticmethod
    def of(channels: ChannelMap, side: str, names: Sequence[str]) -> DriverSide | None:
        """Return a side of the joints according to a map; None if the map does not contain it.

        Raises a RecordingError if the map contains channels that a live graph cannot provide.
        """
        if missing := [name for name in names if name not in channels.joints]:
            raise RecordingError(
                f"the channel map lacks {', '.join(missing)}", "List every joint of the arm."
            )
        if channels.time != "header" or channels.coupling:
            raise RecordingError(
                "the channel map has arrival times or coupled motors",
                "Record a bag, and diagnose it with --channels; live nodes use stamps and"
                " joints unchanged.",
            )
        joints = [getattr(channels.joints[name], side) for name in names]
        present = [dict(one.present()) for one in joints]
        named = set().union(*present)
        of_motors = [name for name in OF_MOTOR if name in named]
        if of_motors:
            raise RecordingError(
                f"the channel map has {of_motors[0]}, which live nodes do not convert to torques",
                "Record a bag, and diagnose it with --channels.",
            )
        topics = {channel.topic for one in present for channel in one.values()}
        if not topics:
            return None
        if len(topics) > 1 or any(one.keys() != present[0].keys() for one in present):
            raise RecordingError(
                f"the {side} side comes from {', '.join(sorted(topics))}, or its joints have"
                " different channels",
                "Live nodes need one topic of type sensor_msgs/JointState per side, with the"
                " same channels for all joints.",
            )
        return DriverSide(topics.pop(), joints)

    def read(self, names: tuple[str, ...], numbers: dict[str, Array]) -> dict[str, Array] | None:
        """Return the fields (N, n) in SI units at the output; None for other messages.

        A field that was not recorded is (N, 0).
        """
        rows = len(next(iter(numbers.values())))
        found: dict[str, Array] = {}
        for field in CHANNEL_NAMES:
            columns = []
            for joint in self.joints:
                channel = getattr(joint, field)
                if channel is None:
                    continue
                named = names.index(channel.name) if channel.name in names else None
                place = named if channel.index is None else channel.index
                values = numbers.get(channel.field)
                if values is None or place is None or place >= values.shape[1]:
                    return None
                columns.append(channel.applied(values[:, place], field))
            found[field] = np.column_stack(columns) if columns else np.empty((rows, 0))
        return found


class Collector:
    """Gathers messages of both sides and makes samples of them.

    joints: the joints wanted, in the order of the samples' columns; messages may name them in any
    order; shown: full names of the topics, as a node has them in its namespace; channels: A map of
    a driver's topics, names and units; the suite's own when None.
    """

    def __init__(
        self,
        joints: tuple[str, ...],
        sides: str = "both",
        shown: Callable[[str], str] = lambda topic: topic,
        channels: ChannelMap | None = None,
    ) -> None:
        self.joints = joints
        self._shown = shown
        given = (
            {}
            if channels is None
            else {t: DriverSide.of(channels, NAMED[t], joints) for t in SIDES[sides]}
        )
        self._driver = {topic: side for topic, side in given.items() if side is not None}
        # Side, by the topic that the suite has it on -> the topic that it comes on.
        self._sources = {
            t: self._driver[t].topic if channels else t
            for t in SIDES[sides]
            if not channels or given[t]
        }
        self.inboxes = {topic: Inbox(topics.type_of(topic)) for topic in self._sources.values()}
        self._heard = dict.fromkeys(self.inboxes, time.monotonic())
        self._empty = dict.fromkeys(self.inboxes, 0)
        self.reset()

    def reset(self) -> None:
        """Discard everything that was received."""
        for inbox in self.inboxes.values():
            inbox.clear()
        self.pairing = Pairing()
        self.faults = Faults()
        self.last_ns = 0
        self._origin_ns: int | None = None
        self._fields: dict[str, tuple[str, ...]] = {}

    @property
    def losses(self) -> Losses:
        """The messages that did not become a sample of both sides."""
        return self.pairing.losses

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels of an arm with all sensors."""
        return tuple(
            name
            for topic in self._sources
            for name, (side, _) in SAMPLED.items()
            if side == NAMED[topic]
        )

    def take(self, everything: bool = False) -> Samples | None:
        """Return the samples that are ready, in order of time, or None.

        They are never older than those returned before.
        """
        add = dict(zip(NAMED, (self.pairing.add_link, self.pairing.add_motor), strict=True))
        for topic, inbox in self.inboxes.items():
            self._empty[topic] += 1
            if len(inbox):
                self._heard[topic] = time.monotonic()
                self._empty[topic] = 0
            for names, stamps, numbers in inbox.take():
                for side in (side for side, source in self._sources.items() if source == topic):
                    there, rows = self._rows(side, names, stamps, numbers)
                    add[side](there, rows)
                    # the side that is not measured is no reason to wait
                    if len(self._sources) == 1:
                        other = next(one for one in NAMED if one != side)
                        add[other](there, np.empty((len(there), 0)))
        pairs = self.pairing.take(everything)
        if pairs is None:
            return None
        self.last_ns = int(pairs.stamp_ns[-1])
        if self._origin_ns is None:
            self._origin_ns = int(pairs.stamp_ns[0])
        parts: dict[tuple[str, str], Array] = {}
        for topic, rows in zip(NAMED, (pairs.link, pairs.motor), strict=True):
            given = self._fields.get(topic, ())
            split = np.split(rows, len(given), axis=1) if given else []
            parts |= {(NAMED[topic], field): part for field, part in zip(given, split, strict=True)}
        found: dict[str, Any] = {name: parts.get(place) for name, place in SAMPLED.items()}
        t = np.asarray((pairs.stamp_ns - self._origin_ns) * 1e-9, dtype=np.float64)
        return Samples(t=t, stamp_ns=pairs.stamp_ns, **found)

    def problems(self) -> list[str]:
        """Return in words the problems of the incoming messages."""
        now = time.monotonic()
        said = [
            f"no messages on {self._shown(topic)} for {now - heard:.0f} s"
            for topic, heard in self._heard.items()
            if now - heard > SILENCE and self._empty[topic] >= LOOKS
        ]
        faults = self.faults
        losses = self.losses
        unreadable = sum(box.unreadable for box in self.inboxes.values())
        overflowed = sum(box.overflowed for box in self.inboxes.values())
        counts = {
            f"messages do not contain the joints {', '.join(self.joints)}": faults.foreign,
            "messages contain numbers that are not finite": faults.not_finite,
            "messages have other fields than before": faults.changed,
            "messages cannot be read": unreadable,
            "messages were dropped because this node was busy": overflowed,
            "samples were too late": losses.late,
            "samples have no counterpart on the other topic": losses.unmatched,
        }
        return said + [f"{count} {what}" for what, count in counts.items() if count]

    def _rows(
        self,
        topic: str,
        names: tuple[str, ...],
        stamps: NDArray[np.int64],
        numbers: dict[str, NDArray],
    ) -> tuple[NDArray[np.int64], Array]:
        """Return the stamps of the usable messages and their fields next to each other, (N, fields
        * n), in the order of the arm."""
        if topic in self._driver:
            read = self._driver[topic].read(names, numbers)
            names, numbers = (self.joints, read) if read is not None else ((), numbers)
        given = tuple(field for field in FIELDS if numbers[field].shape[1])
        fields = self._fields.setdefault(topic, given) if self._usable(names) else given
        nothing = stamps[:0], np.empty((0, len(fields) * len(self.joints)))
        if not self._usable(names):
            self.faults.foreign += len(stamps)
            return nothing
        if given != fields or any(numbers[field].shape[1] != len(names) for field in given):
            self.faults.changed += len(stamps)
            return nothing
        order = [names.index(joint) for joint in self.joints]
        rows = np.concatenate([numbers[field][:, order] for field in fields], axis=1)
        finite = np.isfinite(rows).all(axis=1)
        self.faults.not_finite += int(np.sum(~finite))
        return stamps[finite], rows[finite]

    def _usable(self, names: tuple[str, ...]) -> bool:
        return set(self.joints) <= set(names)
