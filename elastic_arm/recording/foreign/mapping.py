"""Build the sides of a recording from the topics of a foreign bag and its channel map."""

from collections.abc import Mapping

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import (
    CHANNEL_NAMES,
    Channel,
    ChannelMap,
    ChannelName,
    SideName,
    coupled,
    coupling_matrix,
)
from elastic_arm.recording.inspection.report import Finding, checked
from elastic_arm.recording.series import Series
from elastic_arm.recording.sides import Array, Side
from elastic_arm.recording.timebase.joining import pair


def mapped_side(
    channels: ChannelMap, side_name: SideName, series: Mapping[str, Series], found: list[Finding]
) -> Side | None:
    """Build one side of all joints; None if the map has no channel of it.

    `found` receives the corrections. Channels of one topic share its stamps; channels of other
    topics are interpolated to the stamps of the first.
    """
    built: Side | None = None
    for channel_name in CHANNEL_NAMES:
        sources = {
            joint: source
            for joint, both in channels.joints.items()
            if (source := getattr(getattr(both, side_name), channel_name)) is not None
        }
        if not sources:
            continue
        side = _channel(sources, channel_name, series, channels, found)
        if built is not None:
            built, side = pair(
                built, side, f"{side_name} {channel_name}", f"the {side_name} side", found
            )
        built = side if built is None else built.filled(side)
    if side_name == "motor":
        built = coupled(built, coupling_matrix(channels.coupling, list(channels.joints)))
    return built


def _channel(
    sources: dict[str, Channel],
    name: ChannelName,
    series: Mapping[str, Series],
    channels: ChannelMap,
    found: list[Finding],
) -> Side:
    """Build one channel at the stamps of the first joint's topic; NaN for joints without a
    source."""
    by_topic: dict[str, list[str]] = {}
    for joint, source in sources.items():
        by_topic.setdefault(source.topic, []).append(joint)
    built: Side | None = None
    all_joints = list(channels.joints)
    for topic, joints in by_topic.items():
        messages = series.get(topic)
        if messages is None or not messages.count:
            raise RecordingError(
                f"no messages on {topic}, which the channel map gives for {', '.join(joints)}",
                "Topics of the map with messages:"
                f" {', '.join(t for t, s in series.items() if s.count) or 'none'}; elastic-arm bag"
                " info lists those of the bag.",
            )
        for part, some in _parts(messages, {joint: sources[joint] for joint in joints}):
            part = part.fullest({sources[joint].field for joint in some}, found)
            values = np.column_stack([_one(part, sources[joint], name) for joint in some])
            side = checked(Side(part.stamp_ns, **{name: values}), topic, some)
            side = side.spread([all_joints.index(joint) for joint in some], len(all_joints))
            found += part.findings
            if built is not None:
                built, side = pair(
                    built, side, f"{topic} ({', '.join(some)})", next(iter(by_topic)), found
                )
            built = side if built is None else built.filled(side)
    if built is None:
        raise RecordingError(f"the channel map gives no source for {name}")
    return built


def _parts(messages: Series, sources: Mapping[str, Channel]) -> list[tuple[Series, list[str]]]:
    """Return the messages that name joints together, with the joints to take from them; all
    messages if none has names."""
    if not messages.names() or any(source.index is not None for source in sources.values()):
        return [(messages, list(sources))]
    called = {source.name: joint for joint, source in sources.items()}
    found = []
    for part, names in messages.holding(list(called)):
        found.append((part, [called[name] for name in names]))
    return found


def _one(messages: Series, source: Channel, name: ChannelName) -> Array:
    if source.index is not None:
        return source.applied(messages.column(source.field, source.index), name)
    if not messages.names():
        if messages.width(source.field) > 1:
            problem = (
                f"{messages.topic} has several numbers in field {source.field!r} without names"
            )
            raise RecordingError(problem, f"Give {source.name} its index in the channel map.")
        return source.applied(messages.column(source.field, 0), name)
    values = messages.columns(source.field, (source.name,))
    if values is None:
        problem = f"{messages.topic} has no numbers in field {source.field!r}"
        raise RecordingError(problem, "Choose another field in the channel map.")
    return source.applied(values[:, 0], name)
