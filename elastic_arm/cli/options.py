"""Options that several subcommands share, and what is read from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from elastic_arm.effects import Catalogue, robot_effects
from elastic_arm.errors import EffectError
from elastic_arm.recording import ChannelMap, Recording, read_recording
from elastic_arm.robot import Robot, load_robot


class ClockChoice(StrEnum):
    """What the times of samples are."""

    auto = "auto"
    stamps = "stamps"
    regular = "regular"
    arrival = "arrival"


ClockOption = Annotated[
    ClockChoice,
    typer.Option(
        "--clock",
        help="When samples were taken: at their stamps, regularly, when messages arrived; by the evidence otherwise.",
    ),
]
RobotFile = Annotated[Path | None, typer.Option("--robot", help="Arm file or URDF; the nominal arm by default.")]
EffectsFiles = Annotated[
    list[Path] | None,
    typer.Option("--effects", is_eager=True, help="Python file with effects of your own; may be given again."),
]


def load_arm(path: Path | None, chain: str | None = None, catalogue: Catalogue | None = None) -> Robot:
    """Read a robot description, of a URDF the part that `chain` names, and check that the effects it lists exist.

    Parameters
    ----------
    path
        Arm file or URDF; the nominal arm when None.
    chain
        First and last link of the arm in a URDF, "base:tip".
    catalogue
        Where effects are looked up; the default one when None.

    Raises
    ------
    RobotError, EffectError
        Naming the file.
    """
    robot = load_robot(path, chain)
    try:
        robot_effects(robot, catalogue)
    except EffectError as error:
        raise EffectError(f"{path}: {error.problem}", error.remedy) from None
    return robot


def read_by_clock(path: Path, channels: ChannelMap | None, joints: Sequence[str], clock: ClockChoice) -> Recording:
    """Read a recording whose stamps mean what the user demands.

    Parameters
    ----------
    path
        Of a bag.
    channels
        Of a foreign bag.
    joints
        Names, in robot-description order.
    clock
        What times of samples are.

    Raises
    ------
    RecordingError
        Naming what is missing or wrong.
    """
    recording = read_recording(path, channels, joints, arrival=clock is ClockChoice.arrival)
    if clock is ClockChoice.auto:
        return recording
    return replace(recording, clock="regular" if clock is ClockChoice.regular else "stamps")
