"""From bags to recordings."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, message_types
from elastic_arm.recording.decoding import Decoder
from elastic_arm.recording.foreign.channels import ChannelMap, load_channels
from elastic_arm.recording.foreign.mapping import mapped_side
from elastic_arm.recording.inspection.quality import check_times, checked
from elastic_arm.recording.joint_names import matched_names
from elastic_arm.recording.namespaces import choose_namespace, local_name
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.series import Piece, Series
from elastic_arm.recording.sides import Side, joints_with
from elastic_arm.recording.storage.bag import Bag, BagFile, Block, open_bag
from elastic_arm.recording.timebase.joining import pair
from elastic_arm.recording.topics import (
    JOINT_STATES,
    JOINT_TORQUES,
    MOTOR_STATES,
    REFERENCE,
    ROBOT_DESCRIPTION,
    TYPES,
)

_DIGITS = 18  # of the number of a joint
_CONTRACT = (JOINT_STATES, MOTOR_STATES, JOINT_TORQUES, REFERENCE)
_STATE = {name: name for name in ("position", "velocity", "effort")}
_POINT = {
    "position": "points.0.positions",
    "velocity": "points.0.velocities",
    "acceleration": "points.0.accelerations",
    "effort": "points.0.effort",
}


@dataclass
class Content:
    """The topics of one or several bags.

    Parameters
    ----------
    series, decoders
        By topic, those requested; the series once all is read.
    robot_description
        The last URDF on /robot_description.
    topics
        All topics that have messages, with their types.
    messages
        Number of messages on all topics.
    damage
        What was wrong with the bags.
    namespace
        Of the arm; names in `series` and `decoders` are those within it.
    """

    series: dict[str, Series] = field(default_factory=dict)
    decoders: dict[str, Decoder] = field(default_factory=dict)
    robot_description: str | None = None
    topics: dict[str, str] = field(default_factory=dict)
    messages: int = 0
    damage: list[str] = field(default_factory=list)
    namespace: str = ""

    def take(self, file: BagFile, block: Block, wanted: Collection[str]) -> None:
        """Decode a block.

        Parameters
        ----------
        file
            The file of the block.
        block
            Messages of any topics.
        wanted
            The topics to decode; of the others messages are counted alone.
        """
        for channel, count in block.counts().items():
            topic = file.topic(channel)
            self.topics[topic.name] = topic.type_name
            self.messages += count
            name = local_name(topic.name, self.namespace)
            if name is not None and name in wanted:
                self.decoders.setdefault(name, Decoder(name, topic.type_name)).add(file, channel, block)
            elif name == ROBOT_DESCRIPTION and topic.type_name == TYPES[ROBOT_DESCRIPTION]:
                data = block.spans(channel).message(-1)
                begin, end = cdr.layout_of(data, topic.type_name, message_types.typestore()).text["data"]
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
        A rosbag2 folder, an .mcap or .db3 file, or several of them (parts of one run, or its topics).
    channels
        A channel map or its file, for bags that use other names, units or signs.
    joints
        The joints wanted, in robot-description order; by default all, in the order of the URDF in the bag, or else of
        the numbers in their names.
    arrival
        Take the times at which messages were recorded for their stamps.
    namespace
        Of the arm, where the bag holds several; a channel map names whole topics instead.

    Raises
    ------
    RecordingError
        Naming what is missing or wrong: which topic, joint, field, time; and what to do.
    """
    paths = [path] if isinstance(path, str | Path) else list(path)
    if not paths:
        raise RecordingError("no bag was given", "Name at least one.")
    if isinstance(channels, str | Path):
        channels = load_channels(channels)
    bags = [open_bag(each) for each in paths]
    source = ", ".join(str(bag.path) for bag in bags)
    if channels is not None and namespace is not None:
        raise RecordingError("a channel map and a namespace are given", "Name whole topics in the map.")
    chosen = choose_namespace(bags, namespace) if channels is None else ""
    source += f" ({chosen})" if chosen else ""
    content = read_content(bags, _CONTRACT if channels is None else channels.topics(), namespace=chosen)
    if arrival:
        content.series = {topic: series.by_arrival() for topic, series in content.series.items()}
    try:
        recording = _contract_recording(content, joints) if channels is None else _mapped_recording(content, channels)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error.problem}", error.remedy) from None
    if channels is not None and joints is not None:
        recording = recording.select(joints)
    if channels is None:
        recording = replace(recording, currents=tuple(dict.fromkeys(name for bag in bags for name in bag.currents())))
    return replace(recording, source=source, notes=(*content.damage, *recording.notes))


def read_content(bags: Sequence[Bag], wanted: Collection[str], strict: bool = True, namespace: str = "") -> Content:
    """Decode the topics `wanted`; with `strict` a damaged chunk raises, otherwise it is skipped and noted.

    Parameters
    ----------
    bags
        Opened bags, parts of one recording.
    wanted
        The topics to decode.
    strict
        Raise for a damaged chunk; otherwise skip it and note it.
    namespace
        Of the arm, as :func:`~elastic_arm.recording.namespaces.choose_namespace` returns it.

    Raises
    ------
    RecordingError
        If a chunk or message is damaged.
    """
    content = Content(namespace=namespace)
    for bag in bags:
        for file in bag.files:
            for block in file.blocks(strict):
                content.take(file, block, wanted)
        content.damage += bag.all_damage()
    content.series = {topic: decoder.series() for topic, decoder in content.decoders.items()}
    return content


def _mapped_recording(content: Content, channels: ChannelMap) -> Recording:
    link, of_link = mapped_side(channels, "link", content.series)
    motor, of_motor = mapped_side(channels, "motor", content.series)
    command, of_command = mapped_side(channels, "command", content.series)
    return Recording(
        tuple(channels.joints),
        link,
        motor,
        command,
        robot_description=content.robot_description,
        notes=(*of_link, *of_motor, *of_command),
        currents=channels.currents(),
    )


def _contract_recording(content: Content, wanted: Sequence[str] | None) -> Recording:
    for topic, series in content.series.items():
        if series.type_name != TYPES[topic]:
            raise RecordingError(
                f"{topic} has type {series.type_name}, not {TYPES[topic]}", "Describe it in a channel map."
            )
    states = [content.series[topic] for topic in (JOINT_STATES, MOTOR_STATES) if topic in content.series]
    if not states:
        listed = ", ".join(f"{topic} ({name})" for topic, name in content.topics.items()) or "no messages at all"
        raise RecordingError(
            f"neither {JOINT_STATES} nor {MOTOR_STATES} was recorded; there is {listed}",
            "Record one of them, or name in a channel map (--channels) the topics that hold the joints.",
        )
    joints = _joints(states, wanted, content.robot_description)
    notes: list[str] = []
    sides = {topic: _side(content.series.get(topic), joints, _STATE, notes) for topic in (JOINT_STATES, MOTOR_STATES)}
    link, motor = _place_torques(sides[JOINT_STATES], sides[MOTOR_STATES], content, joints, notes)
    reference = _reference(content.series.get(REFERENCE), joints, notes)
    called = joints if wanted is None else tuple(wanted)
    if called != joints:
        notes.append(f"{', '.join(joints)} are {', '.join(called)} by their names without what all of them share")
    return Recording(called, link, motor, reference, content.robot_description, notes=tuple(notes))


def _place_torques(
    link: Side | None, motor: Side | None, content: Content, joints: tuple[str, ...], notes: list[str]
) -> tuple[Side | None, Side | None]:
    """Decide what /joint_states.effort measured, and take torques that stand in /joint_torques alone."""
    sensed: Side | None = None
    driven: Side | None = None
    if JOINT_TORQUES in content.series:
        sensed = _side(content.series[JOINT_TORQUES], joints, {"effort": "joint_torque"}, notes)
        driven = _side(content.series[JOINT_TORQUES], joints, {"effort": "motor_torque"}, notes)
    if link is not None and link.effort is not None and motor is None and (sensed is None or sensed.effort is None):
        notes.append(f"{JOINT_STATES}.effort was taken as the motor torque, as {MOTOR_STATES} was not recorded")
        motor = Side(link.stamp_ns, effort=link.effort)
        link = replace(link, effort=None)
    if link is not None and link.effort is None and sensed is not None and sensed.effort is not None:
        link, sensed, words = pair(link, sensed, f"{JOINT_TORQUES}.joint_torque", JOINT_STATES)
        link = replace(link, effort=sensed.effort)
        notes.extend(words)
    if motor is None and driven is not None and driven.effort is not None:
        motor = driven
    elif motor is not None and motor.effort is None and driven is not None and driven.effort is not None:
        motor, driven, words = pair(motor, driven, f"{JOINT_TORQUES}.motor_torque", MOTOR_STATES)
        motor = replace(motor, effort=driven.effort)
        notes.extend(words)
    return link, motor


def _joints(states: Sequence[Series], wanted: Sequence[str] | None, urdf: str | None) -> tuple[str, ...]:
    names = list(dict.fromkeys(name for series in states for name in series.names()))
    if not names:
        raise RecordingError(f"{states[0].topic} names no joints", "The publisher must fill the field name.")
    if wanted is not None:
        matched = matched_names(wanted, names)
        if matched is None:
            missing = [name for name in wanted if name not in names]
            raise RecordingError(
                f"joint {', '.join(missing)} was not recorded; there are {', '.join(names)}",
                "Give the description of the recorded arm (--robot), or map its names in a channel map (--channels).",
            )
        return tuple(matched)
    known = urdf_joints(urdf)
    recorded = set(names)
    if recorded <= set(known):
        return tuple(name for name in known if name in recorded)
    numbers = {name: _number_at_end(name) for name in names}
    if all(numbers.values()) and len({name.removesuffix(digits) for name, digits in numbers.items()}) == 1:
        return tuple(sorted(names, key=lambda name: int(numbers[name])))
    return tuple(names)


def _number_at_end(name: str) -> str:
    """Return the digits at the end of a name; nothing where they are too many to count joints."""
    # From the end, as a search from the start would look through each run of digits once for every digit of it.
    found = re.match(r"\d*", name[::-1])
    return "" if found is None or found.end() > _DIGITS else found[0][::-1]


def urdf_joints(urdf: str | None) -> list[str]:
    """Return the names of all joints of a URDF; none if there is no readable one."""
    try:
        return [joint.get("name", "") for joint in ElementTree.fromstring(urdf or "").findall("joint")]
    except ElementTree.ParseError:
        return []


def _side(series: Series | None, joints: tuple[str, ...], paths: dict[str, str], notes: list[str]) -> Side | None:
    """Build a side from the messages that hold all of `joints` (a gripper may publish on the same topic)."""
    if series is None:
        return None

    wanted = frozenset(joints)

    def whole(piece: Piece) -> bool:
        return wanted <= set(piece.names)

    if not all(whole(piece) for piece in series.pieces):
        if not any(map(whole, series.pieces)):
            _refuse_split(series, joints)
        kept = series.keep(whole)
        notes.append(f"{series.count - kept.count} messages on {series.topic} that hold other joints were left out")
        series = kept
    channels = {}
    for name, path in paths.items():
        values = series.columns(path, joints)
        if values is not None and not joints_with(values).any():
            notes.append(f"{series.topic}.{name} is NaN throughout and counts as not recorded")
        elif values is not None:
            channels[name] = values
            without = [joint for joint, there in zip(joints, joints_with(values), strict=True) if not there]
            notes += [f"{series.topic}.{name} is not there for {', '.join(without)}"] if without else []
    return checked(Side(series.stamp_ns, **channels), series.topic, joints)


def _refuse_split(series: Series, joints: tuple[str, ...]) -> None:
    sets = sorted({", ".join(piece.names) for piece in series.pieces})
    raise RecordingError(
        f"no message on {series.topic} holds all of {', '.join(joints)}; there are {' | '.join(sets)}",
        "Name the joints of the arm: give its robot description, or a channel map (--channels).",
    )


def _reference(series: Series | None, joints: tuple[str, ...], notes: list[str]) -> Side | None:
    """Build the reference; it is no measurement, so a useless one is left out with a note."""
    if series is None:
        return None
    try:
        side = _side(series, joints, _POINT, notes)
        if side is None:
            return None
        seconds, nanoseconds = (series.column(f"points.0.time_from_start.{part}", 0) for part in ("sec", "nanosec"))
        ahead = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)
        check_times(side.stamp_ns + ahead, REFERENCE)
        return replace(side, stamp_ns=side.stamp_ns + ahead)
    except RecordingError as error:
        notes.append(f"{REFERENCE} was left out: {error.problem}")
        return None
