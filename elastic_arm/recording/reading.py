"""Read bags as recordings."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr
from elastic_arm.recording.foreign.channels import SIDE_NAMES, ChannelMap, load_channels
from elastic_arm.recording.foreign.mapping import mapped_side
from elastic_arm.recording.inspection.report import Finding, check_times, checked, note, warning
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.series import Decoder, Series
from elastic_arm.recording.sides import Side, joints_with, matched_names
from elastic_arm.recording.storage.bag import Bag, BagFile, open_bag
from elastic_arm.recording.storage.mcap_scan import McapBlock
from elastic_arm.recording.storage.messages import topics_of
from elastic_arm.recording.timebase.joining import pair
from elastic_arm.recording.timebase.ordering import LATE_NS
from elastic_arm.recording.topics import (
    JOINT_STATES,
    JOINT_TORQUES,
    MOTOR_STATES,
    OF_MOTOR,
    REFERENCE,
    ROBOT_DESCRIPTION,
    TYPES,
)

PART = 400_000  # messages of a part of a long bag: three minutes of two topics at 1 kHz
_CONTRACT = (JOINT_STATES, MOTOR_STATES, JOINT_TORQUES, *OF_MOTOR.values(), REFERENCE)
_STATE = {name: name for name in ("position", "velocity", "effort")}
_POINT = {
    "position": "points.0.positions",
    "velocity": "points.0.velocities",
    "acceleration": "points.0.accelerations",
    "effort": "points.0.effort",
}


@dataclass
class Content:
    """The topics of one or several bags."""

    # By topic, those requested; the series once all is read
    series: dict[str, Series] = field(default_factory=dict)
    decoders: dict[str, Decoder] = field(default_factory=dict)
    robot_description: str | None = None  # The last URDF on /robot_description
    # All topics that have messages, with their types
    topics: dict[str, str] = field(default_factory=dict)
    messages: int = 0  # Number of messages on all topics
    damage: list[str] = field(default_factory=list)  # What was wrong with the bags
    promised: int | None = None  # Number of messages by metadata.yaml; None where it does not say
    source: str = (
        ""  # The bags by name; their torque channels that are currents times a torque constant
    )
    currents: tuple[str, ...] = ()
    # joint -> number in its servo's register of the position gain
    firmware_gains: dict[str, float] = field(default_factory=dict)
    namespace: str = ""  # Of the arm; names in `series` and `decoders` are those within it

    @property
    def share(self) -> float:
        """How much of the bags has been read, as far as they state their size."""
        return min(self.messages / (self.promised or self.messages or 1), 1.0)

    def decoded(self) -> Self:
        """Convert the messages decoded since the last call to series; return itself."""
        self.series = {topic: decoder.series() for topic, decoder in self.decoders.items()}
        self.decoders = {}
        return self

    def take(self, file: BagFile, block: McapBlock, wanted: Collection[str]) -> None:
        """Decode the wanted topics of a block; count the messages of the others."""
        for channel, count in block.counts().items():
            topic = file.topic(channel)
            self.topics[topic.name] = topic.type_name
            self.messages += count
            name = local_name(topic.name, self.namespace)
            if name is not None and name in wanted:
                self.decoders.setdefault(name, Decoder(name, topic.type_name)).add(
                    file, channel, block
                )
            elif name == ROBOT_DESCRIPTION and topic.type_name == TYPES[ROBOT_DESCRIPTION]:
                data = block.spans(channel).message(-1)
                begin, end = cdr.layout_of(data, topic.type_name).text["data"]
                self.robot_description = bytes(data[begin:end]).decode(errors="replace")


def read_recording(
    path: str | Path | Sequence[str | Path],
    channels: ChannelMap | str | Path | None = None,
    joints: Sequence[str] | None = None,
    *,
    arrival: bool = False,
    namespace: str | None = None,
) -> Recording:
    """Read one or several bags as one recording.

    Parameters
    ----------
    path
        A rosbag2 folder, an .mcap or .db3 file, or several of them (parts of one run, or its
        topics).
    channels
        A channel map or its file, for bags that use other names, units or signs.
    joints
        The requested joints in robot-description order; by default all, in the order of the URDF in
        the bag, or otherwise of the numbers in their names.
    arrival
        Use the times at which messages were recorded as their stamps.
    namespace
        Namespace of the arm if the bag contains several; a channel map uses full topic names.

    Raises
    ------
    RecordingError
        Naming what is missing or wrong: which topic, joint, field, time; and what to do.
    """
    if isinstance(channels, str | Path):
        channels = load_channels(channels)
    (content,) = contents(path, channels, namespace)
    return recording_of(content, channels, joints, arrival=arrival)[0]


def contents(
    path: str | Path | Sequence[str | Path],
    channels: ChannelMap | None = None,
    namespace: str | None = None,
    *,
    wanted: Collection[str] | None = None,
    strict: bool = True,
    most: float = np.inf,
) -> Iterator[Content]:
    """Yield the topics of bags that are parts of one recording, or the topics `wanted`, with their
    series.

    They are yielded after every `most` messages and at the end. With `strict`, a damaged chunk is
    an error; otherwise it is skipped and noted.
    """
    paths = [path] if isinstance(path, str | Path) else list(path)
    if not paths:
        raise RecordingError("no bag was given", "Give at least one.")
    if channels is not None and namespace is not None:
        raise RecordingError(
            "both a channel map and a namespace are given", "Use full topic names in the map."
        )
    bags = [open_bag(each) for each in paths]
    if wanted is None:
        wanted = _CONTRACT if channels is None else channels.topics()
        namespace = choose_namespace(bags, namespace) if channels is None else ""
    namespace = namespace or ""
    names = ", ".join(str(bag.path) for bag in bags)
    content = Content(source=f"{names} ({namespace})" if namespace else names, namespace=namespace)
    for bag in bags:
        if bag.metadata is not None and bag.metadata.message_count is not None:
            content.promised = (content.promised or 0) + bag.metadata.message_count
    before = 0
    for bag in bags:
        for file in bag.files:
            if most == np.inf:
                file.check_lengths()
            for block in file.blocks(strict):
                content.take(file, block, wanted)
                if content.messages - before >= most:
                    before = content.messages
                    yield content.decoded()
        content.damage += bag.all_damage()
        content.currents = tuple(dict.fromkeys((*content.currents, *bag.currents())))
        content.firmware_gains |= bag.firmware_gains()
    yield content.decoded()


def read_parts(
    path: str | Path,
    channels: ChannelMap | None = None,
    joints: Sequence[str] | None = None,
    *,
    arrival: bool = False,
    namespace: str | None = None,
    most: float = PART,
) -> Iterator[tuple[Recording, float]]:
    """Read a bag as :func:`read_recording` does, in parts of `most` messages.

    Yields each part and the share of the bag that has been read.

    A bag with fewer messages is one part. Parts that lack a topic of the first part are left out.
    If the clock was set back between parts, the later part begins one second after the earlier one,
    as it does within a part.
    """
    topics: set[str] = set()
    end: int | None = None
    later = 0
    for content in contents(path, channels, namespace, most=most):
        topics = topics or set(content.series) - {REFERENCE}
        if topics <= set(content.series):
            read = recording_of(content, channels, joints, arrival=arrival)[0]
            if end is not None and (back := end - read.start_ns - later) > LATE_NS:
                later += back + LATE_NS
            read = read.moved(later) if later else read
            end = read.start_ns + round(read.duration * 1e9)
            yield read, content.share


def choose_namespace(bags: Sequence[Bag], wanted: str | None = None) -> str:
    """Return the namespace of the arm to read, "" for the root.

    By default, it is the root if it contains states, and otherwise the only namespace that does.
    """
    found = sorted(
        {
            topic.name.removesuffix(states)
            for bag in bags
            for topic in topics_of(bag.files)
            for states in (JOINT_STATES, MOTOR_STATES)
            if topic.name.endswith(states) and topic.type_name == TYPES[states]
        }
    )
    if wanted is None:
        if len(found) > 1 and "" not in found:
            source = ", ".join(str(bag.path) for bag in bags)
            raise RecordingError(
                f"{source} contains {len(found)} arms: {', '.join(found)}",
                "Choose one: --namespace.",
            )
        return found[0] if found else ""
    namespace = f"/{wanted.strip('/')}".rstrip("/")
    if namespace not in found:
        source = ", ".join(str(bag.path) for bag in bags)
        held = ", ".join(name or "/" for name in found) or "none"
        raise RecordingError(
            f"{source} contains no arm in the namespace {namespace or '/'}",
            f"The namespaces are: {held}.",
        )
    return namespace


def local_name(topic: str, namespace: str) -> str | None:
    """Return the name of a topic within a namespace; None for a topic outside of it."""
    if not namespace:
        return topic
    return topic.removeprefix(namespace) if topic.startswith(f"{namespace}/") else None


def recording_of(
    content: Content,
    channels: ChannelMap | None,
    joints: Sequence[str] | None,
    *,
    arrival: bool = False,
) -> tuple[Recording, list[Finding]]:
    """Return the recording of decoded topics, and the assumptions and corrections.

    Its notes state them as well.
    """
    source = content.source
    series = content.series
    if arrival or (channels is not None and channels.time != "header"):
        series = {topic: each.by_arrival() for topic, each in series.items()}
    found: list[Finding] = []
    try:
        if channels is None:
            recording = _contract_recording(series, content, joints, found)
        else:
            recording = _mapped_recording(series, content, channels, found)
            recording = recording if joints is None else recording.select(joints)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error.problem}", error.remedy) from None
    found = list(dict.fromkeys(found))
    notes = tuple(
        dict.fromkeys((*content.damage, *(finding.message for finding in found), *recording.notes))
    )
    return replace(recording, source=source, notes=notes), found


def _mapped_recording(
    series: Mapping[str, Series], content: Content, channels: ChannelMap, found: list[Finding]
) -> Recording:
    link, motor, command = (mapped_side(channels, side, series, found) for side in SIDE_NAMES)
    joints = tuple(channels.joints)
    urdf = content.robot_description
    return Recording(
        joints,
        link,
        motor,
        command,
        robot_description=urdf,
        currents=channels.currents(),
        firmware_gains=content.firmware_gains,
    )


def _contract_recording(
    series: Mapping[str, Series],
    content: Content,
    wanted: Sequence[str] | None,
    found: list[Finding],
) -> Recording:
    for topic, each in series.items():
        if each.type_name != TYPES[topic]:
            raise RecordingError(
                f"{topic} has type {each.type_name}, not {TYPES[topic]}",
                "Describe it in a channel map.",
            )
    states = [series[topic] for topic in (JOINT_STATES, MOTOR_STATES) if topic in series]
    if not states:
        listed = (
            ", ".join(f"{topic} ({name})" for topic, name in content.topics.items())
            or "no messages at all"
        )
        raise RecordingError(
            f"neither {JOINT_STATES} nor {MOTOR_STATES} was recorded; the bag contains {listed}",
            "Record one of them, or give the topics of the joints in a channel map (--channels).",
        )
    joints = _joints(states, wanted, content.robot_description)
    sides = {
        topic: _side(series.get(topic), joints, _STATE, found)
        for topic in (JOINT_STATES, MOTOR_STATES)
    }
    link, motor = _place_torques(sides[JOINT_STATES], sides[MOTOR_STATES], series, joints, found)
    for channel, topic in OF_MOTOR.items():
        own = _side(series.get(topic), joints, {channel: "effort"}, found)
        motor = _with_own(motor, own, topic, found)
    reference = _reference(series.get(REFERENCE), joints, found)
    called = joints if wanted is None else tuple(wanted)
    if called != joints:
        found.append(
            note(
                f"{', '.join(joints)} match {', '.join(called)} after removing the common part"
                " of the names"
            )
        )
    known = content.firmware_gains
    gains = {new: known[old] for old, new in zip(joints, called, strict=True) if old in known}
    return Recording(
        called,
        link,
        motor,
        reference,
        content.robot_description,
        currents=content.currents,
        firmware_gains=gains,
    )


def _place_torques(
    link: Side | None,
    motor: Side | None,
    series: Mapping[str, Series],
    joints: tuple[str, ...],
    found: list[Finding],
) -> tuple[Side | None, Side | None]:
    """Decide whether /joint_states.effort is the joint torque or the motor torque, and use torques
    that only /joint_torques contains."""
    torques = series.get(JOINT_TORQUES)
    sensed = _side(torques, joints, {"effort": "joint_torque"}, found)
    driven = _side(torques, joints, {"effort": "motor_torque"}, found)
    if (
        link is not None
        and link.effort is not None
        and motor is None
        and (sensed is None or sensed.effort is None)
    ):
        found.append(
            note(
                f"{JOINT_STATES}.effort is interpreted as the motor torque because"
                f" {MOTOR_STATES} was not recorded"
            )
        )
        motor = Side(link.stamp_ns, effort=link.effort)
        link = replace(link, effort=None)
    if (
        link is not None
        and link.effort is None
        and sensed is not None
        and sensed.effort is not None
    ):
        link = _with_torque(link, sensed, "joint_torque", JOINT_STATES, found)
    if driven is not None and driven.effort is not None:
        if motor is None:
            motor = driven
        elif motor.effort is None:
            motor = _with_torque(motor, driven, "motor_torque", MOTOR_STATES, found)
    return link, motor


def _with_torque(side: Side, torques: Side, name: str, topic: str, found: list[Finding]) -> Side:
    side, torques = pair(side, torques, f"{JOINT_TORQUES}.{name}", topic, found)
    return replace(side, effort=torques.effort)


def _with_own(
    motor: Side | None, own: Side | None, topic: str, found: list[Finding]
) -> Side | None:
    """Return the motor side with a channel that has a topic of its own."""
    if motor is None or own is None:
        return own if motor is None else motor
    motor, own = pair(motor, own, topic, MOTOR_STATES, found)
    return motor.filled(own)


def _joints(
    states: Sequence[Series], wanted: Sequence[str] | None, urdf: str | None
) -> tuple[str, ...]:
    names = list(dict.fromkeys(name for series in states for name in series.names()))
    if not names:
        raise RecordingError(
            f"{states[0].topic} contains no joint names",
            "The publisher has to fill the field name.",
        )
    if wanted is not None:
        matched = matched_names(wanted, names)
        if matched is None:
            missing = [name for name in wanted if name not in names]
            raise RecordingError(
                f"not recorded: joint {', '.join(missing)}; the recorded joints are"
                f" {', '.join(names)}",
                "Give the description of the recorded arm (--robot), or map its names in a channel"
                " map (--channels).",
            )
        return tuple(matched)
    known = urdf_joints(urdf)
    recorded = set(names)
    if recorded <= set(known):
        return tuple(name for name in known if name in recorded)
    numbers = {name: _number_at_end(name) for name in names}
    if (
        all(numbers.values())
        and len({name.removesuffix(digits) for name, digits in numbers.items()}) == 1
    ):
        return tuple(sorted(names, key=lambda name: int(numbers[name])))
    return tuple(names)


def _number_at_end(name: str) -> str:
    """Return the digits at the end of a name; empty if there are too many to count joints."""
    # From the end, as a search from the start would look through each run of digits once for every
    # digit of it.
    found = re.match(r"\d*", name[::-1])
    # more digits are no number of a joint
    return "" if found is None or found.end() > 18 else found[0][::-1]


def urdf_joints(urdf: str | None) -> list[str]:
    """Return the names of all joints of a URDF; empty if it cannot be read."""
    try:
        return [
            joint.get("name", "") for joint in ElementTree.fromstring(urdf or "").findall("joint")
        ]
    except ElementTree.ParseError:
        return []


def _side(
    series: Series | None, joints: tuple[str, ...], paths: dict[str, str], found: list[Finding]
) -> Side | None:
    """Build a side from the messages that contain the joints; several kinds of messages are joined
    if each contains only some."""
    if series is None:
        return None
    side: Side | None = None
    parts = series.holding(joints)
    used = sum(part.count for part, _ in parts)
    if used < series.count:
        others = series.keep(
            lambda piece: not any(set(names) <= set(piece.names) for _, names in parts)
        )
        absent = [joint for joint in joints if joint not in others.names()]
        which = f"without {', '.join(absent)}" if len(absent) < len(joints) else "of other joints"
        last = float(others.log_ns.max() - series.log_ns.min()) * 1e-9
        words = f"messages on {series.topic} {which} were skipped, the last after {last:.1f} s"
        found.append(note(f"{series.count - used} {words}"))
    for part, names in parts:
        part = part.fullest(paths.values(), found)
        channels: dict[str, Any] = {name: part.columns(path, names) for name, path in paths.items()}
        own = Side(part.stamp_ns, **channels)
        if len(names) < len(joints):
            own = own.spread([joints.index(joint) for joint in names], len(joints))
        found += part.findings
        if side is None:
            side = own
            continue
        words = (
            f"{series.topic} contains separate messages for {', '.join(names)}, which are merged"
        )
        found.append(note(words))
        own = checked(own.holding(), series.topic, joints)
        side, own = pair(
            side, own, f"messages of {', '.join(names)}", "those of the other joints", found
        )
        side = side.filled(own)
    assert side is not None
    for name, values in side.channels().items():
        there = joints_with(values)
        if not there.any():
            missing = f"{series.topic}.{paths[name]} is NaN throughout and counts as not recorded"
            found.append(warning("nan_channel", missing))
            side = replace(side, **{name: None})  # type: ignore[arg-type]
        elif not there.all():
            without = ", ".join(joint for joint, one in zip(joints, there, strict=True) if not one)
            found.append(
                note(f"{series.topic}.{paths[name]} is missing for {without}", "absent_channel")
            )
    return checked(side, series.topic, joints)


def _reference(series: Series | None, joints: tuple[str, ...], found: list[Finding]) -> Side | None:
    """Build the reference. It is not a measurement, so an unusable one is left out with a note."""
    if series is None:
        return None
    try:
        side = _side(series, joints, _POINT, found)
        if side is None:
            return None
        series, _ = series.holding(joints)[0]
        seconds, nanoseconds = (
            series.column(f"points.0.time_from_start.{part}", 0) for part in ("sec", "nanosec")
        )
        ahead = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)
        check_times(side.stamp_ns + ahead, REFERENCE)
        return replace(side, stamp_ns=side.stamp_ns + ahead)
    except RecordingError as error:
        found.append(note(f"{REFERENCE} was skipped: {error.problem}"))
        return None
