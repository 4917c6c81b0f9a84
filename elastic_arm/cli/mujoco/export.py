"""`elastic-arm export`: an arm as a file of another simulator, or in a user's own file."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import new_table, out, print_json, reports_errors
from elastic_arm.cli.outputs import Force, claim_file
from elastic_arm.effects import Catalogue
from elastic_arm.errors import RobotError
from elastic_arm.formatting import JointUnits, rounded
from elastic_arm.mujoco import Exported, export_mjcf, export_new_mjcf, export_urdf, export_usd
from elastic_arm.mujoco.changed_numbers import Change
from elastic_arm.mujoco.closed_loop import has_servos, latest, with_controllers
from elastic_arm.mujoco.judgement import Judging, closed_loop
from elastic_arm.mujoco.left_out import Left
from elastic_arm.mujoco.torque_file import Language, export_torque
from elastic_arm.recording.made_torque import at_common_gain
from elastic_arm.results import ClosedLoopError
from elastic_arm.robot import Robot
from elastic_arm.robot.loading import is_mjcf, parse_chain
from elastic_arm.robot.mjcf import open_mjcf


class Format(StrEnum):
    """What is written."""

    mjcf = "mjcf"
    urdf = "urdf"
    usd = "usd"
    c = "c"
    python = "python"
    casadi = "casadi"


def format_of(file: Path, asked: Format | None) -> Format:
    """Return the format of a file to be written, by its ending where none is asked for."""
    by_ending = {
        ".urdf": [Format.urdf],
        ".usda": [Format.usd],
        ".mjcf": [Format.mjcf],
        ".xml": [Format.mjcf, Format.urdf],
        ".c": [Format.c],
        ".py": [Format.python],
        ".casadi": [Format.casadi],
    }
    possible = by_ending.get(file.suffix.lower(), [] if asked is None else [asked])
    if not possible or (asked is not None and asked not in possible):
        what = "any format" if asked is None else f"the format {asked.value}"
        remedy = (
            "Name it .urdf (Gazebo makes SDF of it: `gz sdf -p`), .usda, .xml or .mjcf for an MJCF,"
            " or .c, .py or .casadi for its torque as a function."
        )
        raise RobotError(f"the extension of {file} does not match {what}", remedy)
    return possible[0] if asked is None else asked


@reports_errors
def export(
    robot_file: Annotated[
        Path, typer.Argument(metavar="ROBOT", help="Arm file, URDF or MJCF to export.")
    ],
    file: Annotated[Path, typer.Option("--out", help="File to write.", show_default=False)],
    to: Annotated[
        Format | None,
        typer.Option(
            "--to", help="Format; by default from the file extension.", show_default=False
        ),
    ] = None,
    base: Annotated[
        Path | None,
        typer.Option(
            help=("Your own file, in which only numbers change; without it, a new file is written.")
        ),
    ] = None,
    chain: options.Chain = None,
    at: options.At = None,
    effects_files: options.EffectsFiles = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="BAG",
            help="Recorded commands for a closed-loop test of --base and the written MJCF.",
        ),
    ] = None,
    json: options.Json = False,
    force: Force = False,
) -> None:
    """Write an arm, such as a diagnosis' robot.yaml, as MJCF, URDF or USD, or its torque as a
    function in C, Python or CasADi, and list the changes and the omissions.

    With --base, your own file is copied and only its numbers change: inertials,
    armature, damping, friction, gravity, sensor delays. The command lists effects
    and numbers that the format cannot represent (Stribeck friction, hysteresis,
    ripple, …) with their size and the missing torque.
    elastic_arm.mujoco.attach adds their laws to a model from the same robot.yaml.

    Examples:

        elastic-arm export diagnosis/robot.yaml --base arm.xml --out arm_corrected.xml

        elastic-arm export identified/robot.yaml --base arm.urdf --out arm_identified.urdf

        elastic-arm export my_elastic_arm.yaml --out my_elastic_arm.xml

        elastic-arm export diagnosis/robot.yaml --out arm.usda

        elastic-arm export identified/robot.yaml --to c --out arm_torque.c
    """
    kind = format_of(file, to)
    claim_file(file, force=force)
    catalogue = Catalogue.default().with_files(effects_files or ())
    of_base = base is not None
    robot = options.load_arm(
        robot_file, None if of_base else chain, None if of_base else at, catalogue
    )
    ends = None if chain is None else parse_chain(chain)
    if base is None:
        new: dict[Format, Any] = {
            Format.mjcf: export_new_mjcf,
            Format.urdf: export_urdf,
            Format.usd: export_usd,
        }
        new |= {
            Format(language): partial(export_torque, language=language) for language in Language
        }
        done = new[kind](robot, None, file, catalogue=catalogue)
    elif kind not in (Format.mjcf, Format.urdf):
        what = "USD file" if kind is Format.usd else "torque function"
        raise RobotError(f"a {what} is always a new file", "Leave out --base.")
    elif kind is Format.mjcf:
        done = export_mjcf(robot, base, file, chain=ends, at=at, catalogue=catalogue)
    else:
        done = export_urdf(robot, base, file, chain=ends, catalogue=catalogue)
    # What was left out of the arm when it was read is not in the file either.
    done = replace(done, notes=(*robot.notes, *done.notes))
    errors = _played(base, done, robot, chain, at, validate) if validate else {}
    if json:
        print_json(
            {
                "files": [str(path) for path in done.files],
                "changes": [asdict(change) for change in done.changes],
                "left": [one.to_dict() for one in done.left],
                "stand_ins": list(done.stand_ins),
                "notes": list(done.notes),
                **(
                    {"closed_loop": {name: one.to_dict() for name, one in errors.items()}}
                    if errors
                    else {}
                ),
            }
        )
    else:
        print_export(done, new=base is None)
        print_closed_loop(errors)


def _played(
    base: Path | None,
    done: Exported,
    robot: Robot,
    chain: str | None,
    at: str | None,
    bags: Sequence[Path],
) -> dict[str, ClosedLoopError]:
    """Return how the user's model and the file that was written move under recorded commands."""
    if base is None or not is_mjcf(base):
        raise RobotError("--validate compares with an MJCF of yours", "Give it with --base.")
    ends = None if chain is None else parse_chain(chain)
    before = open_mjcf(base, ends, at)
    alone = open_mjcf(done.files[0], ends, at)
    after = with_controllers(alone, robot)
    recordings = [options.read_by_clock(bag, None, robot, options.ClockChoice.auto) for bag in bags]
    at_common_gain(before.robot, recordings)
    judging = list(map(Judging, recordings))
    late = max((latest(one) for one in (before, after) if has_servos(one)), default=0.0)
    played = [closed_loop(one, judging, late) for one in (before, after, alone)]
    errors = [one.errors.tolist() for one in played if one is not None]
    if len(errors) < len(played):
        raise RobotError(
            "the bags contain no commands, or the model has no servos", "Omit --validate."
        )
    return {
        name: ClosedLoopError(described, written, robot.units.at(name, "rad"), alone=by_file)
        for name, described, written, by_file in zip(robot.joint_names, *errors, strict=True)
    }


def print_closed_loop(errors: Mapping[str, ClosedLoopError], written: str = "as written") -> None:
    """Print by how much each joint errs under the recorded commands, as described and corrected.

    written: what the corrected arm is called.
    """
    if not errors:
        return
    units = {one.unit for one in errors.values()}
    unit = "mrad" if units == {"rad"} else "mrad or mm"
    table = new_table(f"closed loop, {unit}", *errors, right=tuple(errors))
    rows: dict[str, list[float | None]] = {
        "description": [one.described for one in errors.values()],
        written: [one.corrected for one in errors.values()],
        "corrected MJCF alone": [one.alone for one in errors.values()],
        "all corrections": [one.refused for one in errors.values()],
    }
    for name, values in rows.items():
        if any(value is not None for value in values):
            table.add_row(
                name,
                *("–" if v is None or not np.isfinite(v) else f"{1e3 * v:.4g}" for v in values),
            )
    out.print(table)
    out.print(
        "[dim]closed loop: root mean square errors of the angles under the recorded commands"
        " of the validation recordings[/]"
    )


def print_export(done: Exported, *, new: bool = False) -> None:
    """Print what changed, unless the file is a new one, what is left, and what was written."""
    # A change below the digits that are shown is none to a reader.
    changes = [one for one in done.changes if before_text(one) != after_text(one)]
    if changes:
        table = new_table("element", "number", "before", "after", "unit", whole=("element", "unit"))
        for change in changes:
            cells = (
                change.element,
                change.number,
                before_text(change),
                after_text(change),
                change.unit,
            )
            table.add_row(*(escape(cell) for cell in cells))
        out.print(table)
    elif not new:
        out.print("no parameter of the description changes")
    for words in done.stand_ins:
        out.print(f"[bold yellow]approximation:[/] {escape(words)}", soft_wrap=True)
    for one in done.left:
        out.print(
            f"[yellow]not in the file:[/] {escape(left_text(one, done.units))}", soft_wrap=True
        )
    for note in done.notes:
        out.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)
    out.print(f"written: {escape(', '.join(str(path) for path in done.files))}", soft_wrap=True)


def left_text(one: Left, units: JointUnits) -> str:
    """Return what is not in a file, its size, what it costs and why, as one line."""
    units_of = {name: "" if unit == "1" else unit for name, unit in one.units.items()}
    sizes = ", ".join(
        f"{name} {_size(value)} {units_of.get(name, '')}".strip()
        for name, value in one.numbers.items()
    )
    costs = [f"{size:.3g} {units.at(joint, 'Nm')} at {joint}" for joint, size in one.cost.items()]
    missing = f"; missing torque {', '.join(costs)}" if costs else ""
    return (
        f"{one.what} on {one.joint or 'the whole arm'}{f' ({sizes})' if sizes else ''}{missing}:"
        f" {one.reason}"
    )


def _size(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(_size(part) for part in value)
    return value if isinstance(value, str) else f"{value:.4g}"


def before_text(change: Change) -> str:
    """Return the old values of a change as text."""
    return " ".join(f"{value:.4g}" for value in change.before)


def after_text(change: Change) -> str:
    """Return the new values of a change as text, with the deviation where there is one."""
    if change.std is not None:
        value, deviation = rounded(change.after[0], change.std)
        return f"{value} ± {deviation}"
    return " ".join(f"{value:.4g}" for value in change.after)
