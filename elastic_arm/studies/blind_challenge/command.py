"""`elastic-arm challenge`: create hidden arms, diagnose them blindly, and score the answers."""

import json as json_module
import os
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from elastic_arm.cli.console import err, out, print_json, progress_bar, reports_errors
from elastic_arm.cli.options import EffectsFiles
from elastic_arm.cli.outputs import claim_folder
from elastic_arm.effects import Catalogue
from elastic_arm.output_files import write_result
from elastic_arm.studies.blind_challenge import campaign
from elastic_arm.studies.blind_challenge.levels import LEVELS
from elastic_arm.studies.blind_challenge.score import (
    EFFECT_HEADINGS,
    HEADINGS,
    SIMULATED,
    effect_rows,
    markdown,
    table_rows,
)
from elastic_arm.studies.blind_challenge.score import score as score_answers

challenge_app = typer.Typer(
    name="challenge",
    help="Test the diagnosis on simulated arms with effects unknown to it.",
    no_args_is_help=True,
)

Folder = Annotated[Path, typer.Argument(help="Folder of the challenge.", show_default=False)]
Workers = Annotated[int, typer.Option(min=1, help="Number of processes on this machine.")]
CORES = os.cpu_count() or 1
LevelName = StrEnum("LevelName", {name: name for name in LEVELS})  # type: ignore[misc]
EXACT = LevelName("laboratory")


@challenge_app.command("create")
@reports_errors
def create(
    folder: Folder,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    per_effect: Annotated[int, typer.Option(min=0, help="Recordings of each single effect.")] = 1,
    clean: Annotated[int, typer.Option(min=0, help="Recordings of the arm without effects.")] = 4,
    pairs: Annotated[int, typer.Option(min=0, help="Recordings of two effects.")] = 4,
    triples: Annotated[int, typer.Option(min=0, help="Recordings of three effects.")] = 0,
    effects_files: EffectsFiles = None,
    effect: Annotated[
        list[str] | None, typer.Option(help="Use only this effect; may be repeated.")
    ] = None,
    ratio: Annotated[
        str, typer.Option(help="Range of sizes LOW:HIGH, relative to the detection limit.")
    ] = "10:300",
    seconds: Annotated[
        float | None,
        typer.Option(
            min=4.0, help="Duration of the fitted recording, s; 12 s, above the laboratory 20 s."
        ),
    ] = None,
    validate_seconds: Annotated[
        float | None,
        typer.Option(
            min=4.0, help="Duration of the validation recording, s; 8 s, above the laboratory 10 s."
        ),
    ] = None,
    level: Annotated[
        LevelName,
        typer.Option(
            help="laboratory: arms ideal except for their effects; workshop, field: realistic arms."
        ),
    ] = EXACT,
    foreign: Annotated[
        int, typer.Option(min=0, help="Recordings of each effect that is in no catalogue.")
    ] = 0,
    workers: Workers = CORES,
) -> None:
    """Draw hidden arms from a seed and record them; the truth is sealed. Resumes if
    interrupted.

    Example: elastic-arm challenge create blind --seed 7 --per-effect 2
    """
    claim_folder(folder, (), force=True, option="FOLDER")
    catalogue = Catalogue.default().with_files(effects_files or ())
    own = LEVELS[level.value].seconds
    settings = campaign.ChallengeSettings(
        seed=seed,
        per_effect=per_effect,
        clean=clean,
        pairs=pairs,
        triples=triples,
        seconds=(seconds or own[0], *(validate_seconds or one for one in own[1:])),
        ratio=_range(ratio),
        effects=tuple(catalogue.find(e).id for e in effect or ()),
        effects_files=tuple(str(path) for path in effects_files or ()),
        level=level.value,
        foreign=foreign,
    )
    with _bar("recording") as bar:
        digest = campaign.create(folder, settings, workers=workers, report=_reporter(bar))
    out.print(f"sealed truth, SHA-256: {digest}")
    if simulated := campaign.load_manifest(folder).get("simulated"):
        out.print(SIMULATED.format(", ".join(simulated)))


@challenge_app.command("diagnose")
@reports_errors
def diagnose(
    folder: Folder,
    withheld: Annotated[
        bool,
        typer.Option(
            "--withheld",
            help="Diagnose arms with one effect again, with that effect removed from the"
            " catalogue.",
        ),
    ] = False,
    stale: Annotated[
        bool, typer.Option("--stale", help="Repeat answers of other versions of the code.")
    ] = False,
    workers: Workers = CORES,
) -> None:
    """Diagnose every recording that has no answer yet, without looking at the truth.

    With --withheld, the truth is opened to remove the effect of each arm from the catalogue.

    Example: elastic-arm challenge diagnose blind
    """
    kind = campaign.WITHHELD if withheld else campaign.ANSWERS
    with _bar("diagnosing") as bar:
        wrong = campaign.solve(
            folder, kind=kind, stale=stale, workers=workers, report=_reporter(bar)
        )
    for name, problem in wrong.items():
        err.print(escape(f"{name}: {problem}"))
    if wrong:
        raise typer.Exit(1)


@challenge_app.command("score")
@reports_errors
def score(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of challenges, which are scored together.", show_default=False
        ),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    to: Annotated[
        Path | None, typer.Option("--markdown", help="Also write the tables to this file.")
    ] = None,
) -> None:
    """Open the sealed truth and compare the answers with it.

    Writes score.json and report.html into the first folder.

    Example: elastic-arm challenge score blind --markdown docs/challenge_results.md
    """
    from elastic_arm.studies.blind_challenge.report import write_challenge_report

    found = score_answers(folders)
    write_result(
        folders[0] / "score.json", json_module.dumps(found, indent=1, allow_nan=False) + "\n"
    )
    page = write_challenge_report(folders[0] / "report.html", found)
    if to is not None:
        write_result(to, markdown(found))
    if json:
        print_json(found)
        return
    for level, table in found["levels"].items():
        _print(f"level {level}", HEADINGS, table_rows(level, table))
    _print("single effects", EFFECT_HEADINGS, effect_rows(found))
    if found["simulated"]:
        out.print(SIMULATED.format(", ".join(found["simulated"])))
    if found["open"]:
        out.print(
            f"{found['open']} recordings have no answer yet: elastic-arm challenge diagnose"
            f" {escape(str(folders[0]))}"
        )
    if len(found["code"]) > 1:
        out.print(
            f"answers of {len(found['code'])} versions of the code: --stale repeats those"
            " of other versions"
        )
    out.print(escape(f"{folders[0] / 'score.json'}, {page}"))


def _print(title: str, headings: Any, rows: Any) -> None:
    table = Table(box=None, header_style="bold", title=title or None, title_justify="left")
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    out.print(table)


def _range(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError as error:
        raise typer.BadParameter(
            f"{text!r} is not a range; write LOW:HIGH, such as 2:30", param_hint="--ratio"
        ) from error
    if not 0.0 < low <= high:
        raise typer.BadParameter(
            f"{text!r} is not a range: both ends have to be above 0, the lower one first",
            param_hint="--ratio",
        )
    return low, high


def _bar(what: str) -> Progress:
    columns = (
        TextColumn(what),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return progress_bar(*columns)


def _reporter(bar: Progress) -> Callable[[int, int], None]:
    task = bar.add_task("", total=None)
    return lambda done, total: bar.update(task, completed=done, total=total)
