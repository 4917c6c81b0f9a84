"""`elastic-arm challenge`: hidden arms made, diagnosed blindly, and scored."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from elastic_arm.cli.console import err, out, print_json, reports_errors
from elastic_arm.effects.catalogue import find
from elastic_arm.gap.challenge import campaign
from elastic_arm.gap.challenge.score import score as score_answers

challenge_app = typer.Typer(
    name="challenge", help="Check the diagnosis on arms whose effect is withheld from it.", no_args_is_help=True
)

Folder = Annotated[Path, typer.Argument(help="Folder of the challenge.", show_default=False)]
Workers = Annotated[int, typer.Option(min=0, help="Processes on this machine; 0 works here, one after another.")]
Scheduler = Annotated[str | None, typer.Option(help="Address of a Dask cluster, instead of --workers.")]
CORES = os.cpu_count() or 1


@challenge_app.command("create")
@reports_errors
def create(
    folder: Folder,
    seed: Annotated[int, typer.Option(min=0, help="The same seed draws the same arms.")] = 0,
    per_effect: Annotated[int, typer.Option(min=0, help="Recordings of each effect alone.")] = 1,
    clean: Annotated[int, typer.Option(min=0, help="Recordings of the plain arm.")] = 4,
    pairs: Annotated[int, typer.Option(min=0, help="Recordings of two effects.")] = 4,
    withheld: Annotated[int, typer.Option(min=0, help="Recordings of each effect, diagnosed without it.")] = 0,
    effect: Annotated[list[str] | None, typer.Option(help="Only this effect; may be given again.")] = None,
    seconds: Annotated[float, typer.Option(min=4.0, help="Duration of what is fitted.")] = 12.0,
    validate_seconds: Annotated[float, typer.Option(min=4.0, help="Duration of what judges.")] = 8.0,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
) -> None:
    """Draw hidden arms from a seed and record them; the truth is sealed. Goes on where it stopped.

    Example: elastic-arm challenge create blind --seed 7 --per-effect 2
    """
    effects = [find(e).id for e in effect] if effect else None
    with _bar("recording") as bar:
        digest = campaign.create(
            folder,
            seed=seed,
            per_effect=per_effect,
            clean=clean,
            pairs=pairs,
            withheld=withheld,
            seconds=seconds,
            validate_seconds=validate_seconds,
            effects=effects,
            workers=workers,
            scheduler=scheduler,
            report=_reporter(bar),
        )
    out.print(f"sealed truth, SHA-256: {digest}")


@challenge_app.command("diagnose")
@reports_errors
def diagnose(folder: Folder, workers: Workers = CORES, scheduler: Scheduler = None) -> None:
    """Diagnose every recording that has no answer yet, without looking at the truth.

    Example: elastic-arm challenge diagnose blind
    """
    with _bar("diagnosing") as bar:
        wrong = campaign.solve(folder, workers=workers, scheduler=scheduler, report=_reporter(bar))
    for name, problem in wrong.items():
        err.print(f"{name}: {escape(problem)}")
    if wrong:
        raise typer.Exit(1)


@challenge_app.command("score")
@reports_errors
def score(folder: Folder, json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """Open the sealed truth and compare the answers with it.

    Example: elastic-arm challenge score blind
    """
    found = score_answers(folder)
    if json:
        print_json(found)
        return
    table = Table(box=None, header_style="bold")
    for heading in ("question", "right", "of", "share", "95 % interval"):
        table.add_column(heading)
    for name, share in found["shares"].items():
        table.add_row(name, str(share["hits"]), str(share["trials"]), _percent(share["share"]), _interval(share))
    out.print(table)
    if found["median_shrink"] is not None:
        out.print(f"median shrink of single effects: {found['median_shrink']:.4f}")
    _print_effects(found["by_effect"])
    if found["open"]:
        out.print(f"{found['open']} recordings have no answer yet: elastic-arm challenge diagnose {folder}")


def _print_effects(by_effect: dict[str, Any]) -> None:
    table = Table(box=None, header_style="bold", title="single effects", title_justify="left")
    for heading in ("effect", "right", "joint right", "median shrink", "largest multiple of the bound missed"):
        table.add_column(heading)
    for effect, row in by_effect.items():
        right, joint, missed = row["effect right"], row["joint right"], row["largest multiple missed"]
        table.add_row(
            effect,
            f"{right['hits']}/{right['trials']}",
            f"{joint['hits']}/{joint['trials']}",
            f"{row['median shrink']:.3f}",
            "–" if missed is None else f"{missed:.0f}",
        )
    out.print(table)


def _bar(what: str) -> Progress:
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=err, transient=True)


def _reporter(bar: Progress) -> Callable[[int, int], None]:
    task = bar.add_task("", total=None)
    return lambda done, total: bar.update(task, completed=done, total=total)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _interval(share: dict[str, Any]) -> str:
    return "–" if share["interval"] is None else " to ".join(_percent(v) for v in share["interval"])
