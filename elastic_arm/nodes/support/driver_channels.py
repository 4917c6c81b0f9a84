"""The joint states of a driver, under other names and in other units, by a channel map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import CHANNEL_NAMES, ChannelMap, SideChannels


@dataclass(frozen=True)
class DriverSide:
    """One side of all joints: the topic that it comes on, and the channels of each joint."""

    topic: str
    joints: Sequence[SideChannels]

    @staticmethod
    def of(channels: ChannelMap, side: str, names: Sequence[str]) -> DriverSide | None:
        """Return a side of the joints as a map has it; None where it has nothing of it.

        Raises a RecordingError if the map holds what a live graph does not give.
        """
        if missing := [name for name in names if name not in channels.joints]:
            raise RecordingError(f"the channel map lacks {', '.join(missing)}", "Name every joint of the arm.")
        if channels.time != "header" or channels.coupling:
            raise RecordingError(
                "the channel map has arrival times or coupled motors",
                "Record a bag, and diagnose that with --channels; live nodes take stamps and joints as they come.",
            )
        joints = [getattr(channels.joints[name], side) for name in names]
        present = [dict(one.present()) for one in joints]
        topics = {channel.topic for one in present for channel in one.values()}
        if not topics:
            return None
        if len(topics) > 1 or any(one.keys() != present[0].keys() for one in present):
            raise RecordingError(
                f"the {side} side comes on {', '.join(sorted(topics))}, or not all joints have the same channels",
                "Live nodes take a side from one topic of sensor_msgs/JointState, alike for all joints.",
            )
        return DriverSide(topics.pop(), joints)

    def read(self, names: tuple[str, ...], numbers: dict[str, Array]) -> dict[str, Array] | None:
        """Return the fields (N, n) in SI units at the output, one that was not recorded (N, 0); None if it is no such
        message."""
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
