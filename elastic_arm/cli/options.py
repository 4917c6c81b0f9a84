"""Options that several subcommands share, and the objects that they read."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from elastic_arm.errors import EffectError, ElasticArmError, RecordingError, RobotError
from elastic_arm.robot import Robot, load_robot
from elastic_arm.robot.plausible import doubtful

if TYPE_CHECKING:
    from elastic_arm.effects import Catalogue
    from elastic_arm.recording import ChannelMap, Recording


Model = Annotated[str, typer.Option(help="Model of the arm: mod1, mod2 or mod3.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for scripts.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print only errors, and JSON if requested.")]
Channels = Annotated[
    Path | None,
    typer.Option(help="Channel map (YAML) for bags of other robots; see docs/channel_maps.md."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]
Refit = Annotated[
    bool,
    typer.Option(
        "--refit", help="Treat the parameters of the description as inexact, and fit them."
    ),
]
OutFolder = Annotated[Path, typer.Option("--out", help="Folder for the results.")]


class ClockChoice(StrEnum):
    """What the times of samples are."""

    auto = "auto"
    stamps = "stamps"
    regular = "regular"
    arrival = "arrival"


Clock = Annotated[
    ClockChoice,
    typer.Option(
        "--clock",
        help=(
            "Sample times: the stamps, a regular clock, or the arrival times of messages; by"
            " default inferred from the data."
        ),
    ),
]


def topics(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return what a shell offers for a topic: those of the bags before it."""
    from elastic_arm.recording.storage.messages import read_topics

    offered: set[str] = set()
    # Arguments stay unread where the line ends with an option that has no value yet.
    for bag in ctx.args:
        try:
            offered |= {topic.name for topic in read_topics(bag)}
        except ElasticArmError:
            continue  # a bag that is refused is so when the command runs
    return sorted(name for name in offered if name.startswith(incomplete))


def namespaces(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return what a shell offers for a namespace: those of the topics of the bags before it."""
    from elastic_arm.recording.topics import JOINT_STATES

    own = [name for name in topics(ctx, "") if name.endswith(JOINT_STATES)]
    offered = {name.removesuffix(JOINT_STATES).strip("/") for name in own}
    return sorted(name for name in offered if name and name.startswith(incomplete))


Namespace = Annotated[
    str | None,
    typer.Option(
        help="Namespace of the arm if bags contain several: left for /left/joint_states etc.",
        autocompletion=namespaces,
    ),
]
Motion = Annotated[
    float | None,
    typer.Option(
        "--motion",
        min=10.0,
        metavar="SECONDS",
        help="Maximum duration of motion used from a recording.",
    ),
]
RobotFile = Annotated[
    Path | None, typer.Option("--robot", help="Arm file, URDF or MJCF; by default the nominal arm.")
]
Chain = Annotated[
    str | None,
    typer.Option(
        "--chain",
        metavar="BASE:TIP",
        help="First and last link of the arm in a URDF, or first and last body in an MJCF.",
        show_default=False,
    ),
]
At = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar="JOINT=VALUE,…",
        help="Positions of fixed joints outside the chain of an MJCF, or the name of a keyframe.",
        show_default=False,
    ),
]


def completions(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return what a shell offers for an effect.

    Its id; behind a colon joints of --robot; then its parameters.
    """
    from elastic_arm.effects import EFFECTS

    *given, last = incomplete.split(":")
    offered = list(EFFECTS)
    if len(given) == 1:
        try:
            offered = list(load_robot(ctx.params.get("robot_file")).joint_names)
        except ElasticArmError:
            offered = []  # a file that is refused is so when the command runs
    elif given:
        stated, comma, _ = last.rpartition(",")
        names = (
            [entry.name for entry in EFFECTS[given[0]].parameters] if given[0] in EFFECTS else []
        )
        offered = [f"{stated}{comma}{name}=" for name in names]
    return [text for one in offered if (text := ":".join([*given, one])).startswith(incomplete)]


PriorsFile = Annotated[
    Path | None,
    typer.Option(
        "--priors",
        help="Priors (YAML) for errors of masses, stiffnesses and sensors (`sensors: {ID: std}`);"
        " see docs/diagnosis.md.",
    ),
]
KnownEffects = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="EFFECT[:JOINT][:NAME=VALUE]",
        autocompletion=completions,
        help=(
            "Known effects, which are fitted first as part of the model. NAME=VALUE is the"
            " starting value."
        ),
    ),
]
EffectsFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "--effects", is_eager=True, help="Python file with your own effects; may be repeated."
    ),
]


def load_arm(
    path: Path | None,
    chain: str | None = None,
    at: str | None = None,
    catalogue: Catalogue | None = None,
) -> Robot:
    """Read a robot description and check that its effects exist.

    Of a URDF or MJCF the part that `chain` names.

    Raises a RobotError or an EffectError that names the file.
    """
    robot = load_robot(path, chain, at)
    if not robot.effects:
        return robot
    # The catalogue takes a while to load, and few descriptions state effects.
    from elastic_arm.effects import robot_effects

    try:
        robot_effects(robot, catalogue)
    except EffectError as error:
        raise EffectError(f"{path}: {error.problem}", error.remedy) from None
    return robot


def refuse_doubtful(robot: Robot) -> None:
    """Raise a RobotError for numbers that no arm has: no motion is to be made of them."""
    if doubts := doubtful(robot):
        more = (
            f" (and {len(doubts) - 1} more: `elastic-arm describe` lists them)"
            if len(doubts) > 1
            else ""
        )
        raise RobotError(
            f"{doubts[0]}{more}", "Correct the description, or state limits in an overlay."
        )


def channel_map(path: Path | None) -> ChannelMap | None:
    """Read a channel map; None where none is given."""
    from elastic_arm.recording import load_channels

    return None if path is None else load_channels(path)


def bags_in(paths: Sequence[Path]) -> list[Path]:
    """Return bags; of a folder of bags those in it."""
    from elastic_arm.recording.storage.bag import METADATA

    found = []
    for path in paths:
        # Path.glob raises for names that are too long.
        a_bag = os.path.exists(path / METADATA) or not os.path.isdir(path)
        inside = [] if a_bag else sorted(path.glob("*"))
        # A folder that holds files of a bag is one, though it lacks its metadata.
        whole = any(one.suffix in (".mcap", ".db3") for one in inside)
        bags = [one for one in inside if os.path.exists(one / METADATA)]
        found += [path] if whole or not bags else bags
    return found


def require_bags(bags: Sequence[Path]) -> None:
    """Raise if a recording is not there, or given twice.

    It would count double, or judge a fit that has seen it.

    Raises a RecordingError naming the recording.
    """
    from elastic_arm.recording.storage.bag import WHAT_IS_A_BAG

    seen: set[Path] = set()
    for bag in bags:
        # Path.exists raises for names that are too long.
        if not os.path.exists(bag):
            raise RecordingError(f"{bag} does not exist", WHAT_IS_A_BAG)
        if bag.resolve() in seen:
            raise RecordingError(
                f"{bag} is given twice", "Give every recording once, and validate on another one."
            )
        seen.add(bag.resolve())


def read_motion(
    path: Path,
    channels: ChannelMap | None,
    robot: Robot,
    clock: ClockChoice,
    namespace: str | None,
    report: Callable[[str, float], None],
    usual: float,
    most: float | None = None,
) -> Recording:
    """Read a recording as :func:`read_by_clock` does.

    Of a long one only the motion that determines most.

    report: called with what is being read, and the share of it that is; usual: s of motion for
    three joints, and fewer for more; most: s of motion that are asked for instead.
    """
    from elastic_arm.estimation.segments import MostTelling
    from elastic_arm.recording.reading import read_parts

    telling = MostTelling(robot, most or usual, exact=most is not None)
    arrival = clock is ClockChoice.arrival
    for part, share in read_parts(
        path, channels, robot.joint_names, arrival=arrival, namespace=namespace
    ):
        telling.add(part)
        report(f"reading {path}: {telling.moving:.0f} s of motion", share)
    return _by_clock(telling.recording(), path, robot, clock)


def read_by_clock(
    path: Path,
    channels: ChannelMap | None,
    robot: Robot,
    clock: ClockChoice,
    namespace: str | None = None,
) -> Recording:
    """Read a recording with the clock that the user states.

    Its notes state what cannot be right of it.

    Raises a RecordingError naming what is missing or wrong.
    """
    # Not every command that takes these options reads a bag.
    from elastic_arm.recording import read_recording

    joints = robot.joint_names
    arrival = clock is ClockChoice.arrival
    recording = read_recording(path, channels, joints, arrival=arrival, namespace=namespace)
    return _by_clock(recording, path, robot, clock)


def _by_clock(recording: Recording, path: Path, robot: Robot, clock: ClockChoice) -> Recording:
    from elastic_arm.recording.inspection.check import doubts
    from elastic_arm.recording.inspection.dead_torques import without_dead_torques
    from elastic_arm.recording.made_torque import is_commanded

    wrong = tuple(f"{path}: {words}." for words in doubts(recording, robot))
    recording = replace(recording, notes=(*recording.notes, *wrong))
    # Drivers without a torque may send zeros, beside which commands would count for nothing.
    kept, _ = without_dead_torques(recording, robot)
    if is_commanded(kept) and any(joint.controller is not None for joint in robot.joints):
        recording = kept
    if clock is ClockChoice.auto:
        return recording
    return replace(recording, clock="regular" if clock is ClockChoice.regular else "stamps")
