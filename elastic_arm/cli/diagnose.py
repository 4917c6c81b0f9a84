"""`elastic-arm diagnose`: where model and recording part, which effect causes it, how far the gap shrinks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from elastic_arm.cli.console import err, out, print_json, refuse_repeated, reports_errors
from elastic_arm.gap.diagnosis import Question, diagnose
from elastic_arm.gap.known import known_effects
from elastic_arm.gap.repair import repaired_robot
from elastic_arm.gap.result import Diagnosis
from elastic_arm.gap.words import meaning
from elastic_arm.recording import Recording, load_channels, read_recording
from elastic_arm.robot import Robot, load_robot

COLOURS = {"none": "green", "explained": "cyan", "unknown": "yellow"}


@reports_errors
def diagnose_command(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG…", help="Recordings that causes are fitted on.")],
    validate: Annotated[
        list[Path] | None, typer.Option(help="Recording that judges; may be given again. The last third otherwise.")
    ] = None,
    model: Annotated[str, typer.Option(help="mod1, mod2 or mod3.")] = "mod3",
    robot_file: Annotated[
        Path | None, typer.Option("--robot", help="Nominal arm: arm file or URDF; that of the package by default.")
    ] = None,
    channels: Annotated[Path | None, typer.Option(help="Channel map of foreign bags.")] = None,
    with_: Annotated[
        list[str] | None,
        typer.Option("--with", help="Effect that is known and fitted first: EFFECT[:JOINT]; may be given again."),
    ] = None,
    refit: Annotated[bool, typer.Option("--refit", help="Fit the model's own parameters first.")] = False,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the results.")] = Path("diagnosis"),
    json: Annotated[bool, typer.Option("--json", help="Print diagnosis.json.")] = False,
) -> None:
    """Say where a recording and a model part, which effect the model lacks, and how far the gap shrinks with it.

    Writes diagnosis.json, report.html and, where causes were found, robot.yaml: the arm with the causes in it, which
    `elastic-arm simulate --robot` takes.

    Examples:

        elastic-arm diagnose bag

        elastic-arm diagnose run_1 run_2 --validate run_3 --out diagnosis

        elastic-arm diagnose bag --refit --with coulomb_friction --with viscous_friction
    """
    refuse_repeated([*bags, *(validate or [])])
    robot = load_robot(robot_file)
    mapping = None if channels is None else load_channels(channels)

    def read(paths: list[Path]) -> list[Recording]:
        return [read_recording(path, mapping, joints=list(robot.joint_names)) for path in paths]

    with err.status("reading"):
        recordings, judges = read(bags), read(validate or [])
    question = Question(robot, model, refit=refit, given=known_effects(with_ or (), robot))
    with err.status("diagnosing"):
        found = diagnose(recordings, question, judges)
        write_diagnosis(found, robot, out_dir)
    if json:
        print_json(found.to_dict())
    else:
        print_diagnosis(found, out_dir)


def write_diagnosis(found: Diagnosis, robot: Robot, folder: Path) -> None:
    """Write diagnosis.json, report.html and, where causes were found, the arm that has them."""
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.gap import write_gap_report

    found.save(folder / "diagnosis.json")
    write_gap_report(folder / "report.html", found)
    if found.causes:
        repaired_robot(robot, found).save(folder / "robot.yaml")


def print_diagnosis(found: Diagnosis, folder: Path) -> None:
    """Print verdict, causes and what is left."""
    out.print(f"[bold {COLOURS[found.verdict]}]{found.verdict}[/]: {escape(meaning(found))}")
    if found.causes:
        table = Table(box=None, header_style="bold")
        for heading in ("cause", "joint", "parameters", "shrinks the gap by", "confidence"):
            table.add_column(heading)
        for cause in found.causes:
            values = ", ".join(
                f"{n} = {_number(e.value)} ± {_number(e.std)} {e.unit}" for n, e in cause.parameters.items()
            )
            table.add_row(
                cause.effect,
                cause.joint or "whole arm",
                escape(values),
                f"{100 * cause.shrink:.1f} %",
                f"{cause.confidence:.2f}",
            )
            for other in cause.alternatives:
                table.add_row(
                    f"  or {other.effect}", other.joint or "whole arm", escape(other.separated_by), "",
                    f"{other.confidence:.2f}",
                )  # fmt: skip
        out.print(table)
    for place in found.unexplained:
        out.print(f"unexplained: {place.joint}, {place.side} side, {place.rmse:.3g} Nm, follows {place.regime}")
    for note in found.notes:
        out.print(f"note: {escape(note)}")
    out.print(f"written: {folder}/diagnosis.json, report.html" + (", robot.yaml" if found.causes else ""))


def _number(value: object) -> str:
    if value is None:
        return "?"
    if isinstance(value, list | tuple):
        return "(" + ", ".join(_number(v) for v in value) + ")"
    return f"{float(value):.4g}"  # type: ignore[arg-type]
