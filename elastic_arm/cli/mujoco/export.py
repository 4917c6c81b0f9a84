"""`elastic-arm export`: an arm as the file of another simulator, or in a user's own file."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from elastic_arm.cli.console import out, print_json, reports_errors
from elastic_arm.cli.options import AtOption, ChainOption, EffectsFiles, load_arm
from elastic_arm.cli.outputs import Force, claim_file
from elastic_arm.diagnosis.words import instance_text
from elastic_arm.effects import Catalogue
from elastic_arm.formatting import rounded
from elastic_arm.mujoco import Exported, export_mjcf, export_new_mjcf, export_urdf
from elastic_arm.mujoco.changes import Change
from elastic_arm.robot.loading import parse_chain


class Format(StrEnum):
    """What is written."""

    mjcf = "mjcf"
    urdf = "urdf"


@reports_errors
def export(
    robot_file: Annotated[Path, typer.Argument(metavar="ROBOT", help="Arm file, URDF or MJCF: what is written.")],
    file: Annotated[Path, typer.Option("--out", help="File to write.", show_default=False)],
    to: Annotated[Format, typer.Option("--to", help="Kind of file.")] = Format.mjcf,
    base: Annotated[
        Path | None,
        typer.Option(help="Your own file, whose numbers change and whose shape stays; else a new file is made."),
    ] = None,
    chain: ChainOption = None,
    at: AtOption = None,
    effects_files: EffectsFiles = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
    force: Force = False,
) -> None:
    """Write an arm, such as the robot.yaml of a diagnosis, as MJCF or URDF, and list what changes and what is left.

    With --base your own file is copied and only its numbers change: inertials,
    armature, damping, friction, gravity, sensor delays. Effects that no number
    states (Stribeck friction, hysteresis, ripple, …) are listed:
    elastic_arm.mujoco.attach adds them to a model from the same robot.yaml.

    Examples:

        elastic-arm export diagnosis/robot.yaml --base arm.xml --out arm_corrected.xml

        elastic-arm export identified/robot.yaml --to urdf --base arm.urdf --out arm_identified.urdf

        elastic-arm export my_elastic_arm.yaml --to mjcf --out my_elastic_arm.xml
    """
    claim_file(file, force=force)
    catalogue = Catalogue.default().with_files(effects_files or ())
    of_base = base is not None
    robot = load_arm(robot_file, None if of_base else chain, None if of_base else at, catalogue)
    ends = None if chain is None else parse_chain(chain)
    if base is None:
        done = (export_new_mjcf if to is Format.mjcf else export_urdf)(robot, None, file, catalogue=catalogue)
    elif to is Format.mjcf:
        done = export_mjcf(robot, base, file, chain=ends, at=at, catalogue=catalogue)
    else:
        done = export_urdf(robot, base, file, chain=ends, catalogue=catalogue)
    if json:
        print_json(
            {
                "files": [str(path) for path in done.files],
                "changes": [change.to_dict() for change in done.changes],
                "left": [{**instance.to_dict(), "reason": reason} for instance, reason in done.left],
                "notes": list(done.notes),
            }
        )
    else:
        print_export(done, new=base is None)


def print_export(done: Exported, *, new: bool = False) -> None:
    """Print what changed, unless the file is a new one, what is left, and what was written."""
    if done.changes:
        table = Table(box=None, header_style="bold", pad_edge=False)
        for heading in ("element", "number", "before", "after", "unit"):
            table.add_column(heading, no_wrap=heading in ("element", "unit"))
        for change in done.changes:
            cells = (change.element, change.number, before_text(change), after_text(change), change.unit)
            table.add_row(*(escape(cell) for cell in cells))
        out.print(table)
    elif not new:
        out.print("no number of the description changes")
    for instance, reason in done.left:
        place = instance.joint or "the whole arm"
        words = f"{instance.effect.id} on {place} ({instance_text(instance, done.units) or 'no parameters'}): {reason}"
        out.print(f"[yellow]not in the file:[/] {escape(words)}", soft_wrap=True)
    for note in done.notes:
        out.print(f"[yellow]note:[/] {escape(note)}", soft_wrap=True)
    out.print(f"written: {escape(', '.join(str(path) for path in done.files))}", soft_wrap=True)


def before_text(change: Change) -> str:
    """Return the old values of a change as text."""
    return " ".join(f"{value:.4g}" for value in change.before)


def after_text(change: Change) -> str:
    """Return the new values of a change as text, with the deviation where there is one."""
    if change.std is not None:
        value, deviation = rounded(change.after[0], change.std)
        return f"{value} ± {deviation}"
    return " ".join(f"{value:.4g}" for value in change.after)
