"""`elastic-arm paper`: the paper's study, from the virtual prototype to the claims."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from elastic_arm.cli.console import out, print_json, progress_bar, reports_errors
from elastic_arm.cli.options import RobotFile
from elastic_arm.cli.outputs import Force, claim_folder
from elastic_arm.errors import require_libraries
from elastic_arm.robot import load_robot

RESULTS = ("report.html", "paper.json", "claims.csv")
COLOURS = {"holds": "green", "holds in part": "yellow", "does not hold": "red", "undecided": "cyan"}


@reports_errors
def paper(
    robot_file: RobotFile = None,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder for report.html, CSV and JSON.")
    ] = Path("paper"),
    quick: Annotated[bool, typer.Option(help="Run a reduced study, in a minute.")] = False,
    workers: Annotated[
        int, typer.Option(min=1, help="Number of processes for the prototype.")
    ] = os.cpu_count() or 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and searches.")] = 1,
    json: Annotated[
        bool, typer.Option("--json", help="Print the claims as JSON, for scripts.")
    ] = False,
    force: Force = False,
) -> None:
    """Reproduce the paper: compare mod1, mod2 and mod3 with a virtual prototype over five gear
    ratios.

    Writes report.html with every figure and claim, and all numbers as CSV and JSON.

    Examples:

        elastic-arm paper --out paper/

        elastic-arm paper --quick --json
    """
    claim_folder(folder, RESULTS, force=force)
    require_libraries("the virtual prototype and its symbolic coupling S need", "mujoco", "sympy")
    from dataclasses import asdict

    from elastic_arm.studies.paper.claims import judge
    from elastic_arm.studies.paper.export import export
    from elastic_arm.studies.paper.report import write_paper_report
    from elastic_arm.studies.paper.study import FULL, QUICK, run_study

    robot = load_robot(robot_file)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with progress_bar(*columns, transient=False) as progress:

        def stage(name: str, count: int) -> Callable[[], None]:
            task = progress.add_task(name, total=count)
            return lambda: progress.advance(task)

        result = run_study(robot, QUICK if quick else FULL, workers=workers, seed=seed, stage=stage)
    claims = judge(result)
    files = export(result, claims, folder)
    report = write_paper_report(result, claims, folder / "report.html")
    if json:
        print_json(
            {
                "report": str(report),
                "files": [str(f) for f in files],
                "claims": [asdict(c) for c in claims],
            }
        )
        return
    table = Table("section", "claim", "verdict", title="Claims of the paper, with our numbers")
    for claim in claims:
        table.add_row(
            claim.section, escape(claim.claim), f"[{COLOURS[claim.verdict]}]{claim.verdict}[/]"
        )
    out.print(table)
    out.print(
        f"report: {escape(str(report))}; numbers in its folder:"
        f" {escape(', '.join(f.name for f in files))}"
    )
