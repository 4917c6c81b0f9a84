"""`elastic-arm history`: the numbers of one arm over recordings, and what changed."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from json import dumps as json_text
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors, shares_of
from elastic_arm.cli.gate import FailOn, check_gate, pass_gate
from elastic_arm.cli.outputs import Force, claim_folder
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.history import Course, courses
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.words import size_text, step_text
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import RecordingError
from elastic_arm.estimation.segments import DIAGNOSED, SEGMENT
from elastic_arm.memory import keep_memory
from elastic_arm.output_files import csv_text, write_result
from elastic_arm.recording import Recording
from elastic_arm.recording.storage.bag import METADATA

RESULTS = ("history.json", "history.csv", "report.html")
FILES = (".mcap", ".db3")
COLUMNS = ("effect", "joint", "parameter", "unit", "recording", "date", "value", "std", "changed")


@reports_errors
def history_command(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG…", help="Recordings, or one folder that holds them.")],
    robot_file: options.RobotFile = None,
    chain: options.Chain = None,
    at: options.At = None,
    model: options.Model = "mod3",
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    with_: options.KnownEffects = None,
    clock: options.Clock = options.ClockChoice.auto,
    refit: options.Refit = False,
    out_dir: options.OutFolder = Path("history"),
    force: Force = False,
    json: options.Json = False,
    fail_on: FailOn = None,
) -> None:
    """Follow the numbers of one arm over recordings: what changed, when, by how much, how certain.

    One diagnosis of all recordings, in the order of their times. Every effect that
    it finds, or that is known to be there (--with), has its size in each recording.
    Writes history.json, history.csv and report.html, with a plot of each size.

    Examples:

        elastic-arm history march.bag april.bag may.bag --with coulomb_friction --out history

        elastic-arm history bags/ --robot arm.urdf --fail-on change:5%
    """
    keep_memory()
    check_gate(fail_on or ())
    paths = _bags(bags)
    options.require_bags(paths)
    claim_folder(out_dir, RESULTS, force=force)
    catalogue = Catalogue.default()
    robot = options.load_arm(robot_file, chain, at, catalogue)
    mapping = options.channel_map(channels)
    seconds = max(DIAGNOSED / len(paths), SEGMENT - 1.0)
    with err.status("reading") as status:
        says = shares_of(status)
        read = [options.read_motion(path, mapping, robot, clock, namespace, says, seconds) for path in paths]
        recordings = sorted(read, key=lambda one: one.start_ns)
    given = known_effects(with_ or (), robot, catalogue)
    with err.status(f"diagnosing {len(recordings)} recordings"):
        found = diagnose(recordings, Question(robot, model, refit=refit, given=given, catalogue=catalogue))
        all_of = courses(found)
    dates = [_date(one) for one in recordings]
    result = to_dict(found, all_of, dates)
    write_result(out_dir / RESULTS[0], json_text(result, indent=2, allow_nan=False) + "\n")
    write_result(out_dir / RESULTS[1], to_csv(result))
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.history import write_history_report

    write_history_report(out_dir / RESULTS[2], found, all_of, dates)
    if json:
        print_json(result)
    else:
        print_history(found, all_of, dates)
        out.print(f"written: {escape(str(out_dir))}/{', '.join(RESULTS)}")
    pass_gate(found, fail_on or ())


def _bags(paths: Sequence[Path]) -> list[Path]:
    """Return bags: those in a folder that is none itself."""
    if len(paths) > 1 or not paths[0].is_dir() or (paths[0] / METADATA).exists():
        return list(paths)
    found = [path for path in sorted(paths[0].iterdir()) if path.suffix in FILES or (path / METADATA).exists()]
    if not found:
        raise RecordingError(f"{paths[0]} holds no bags", "Name the folder that the bags are in, or the bags.")
    return found


def _date(recording: Recording) -> str:
    """Return when a recording began, UTC."""
    return datetime.fromtimestamp(recording.start_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def to_dict(found: Diagnosis, all_of: Sequence[Course], dates: Sequence[str]) -> dict[str, Any]:
    """Return what `history.json` holds."""
    return {
        "robot": found.robot,
        "model": found.model,
        "verdict": found.verdict,
        "recordings": [{"recording": r, "date": d} for r, d in zip(found.identify, dates, strict=True)],
        "numbers": [one.to_dict(found.identify) for one in all_of],
        "notes": list(found.notes),
    }


def to_csv(result: dict[str, Any]) -> str:
    """Return the sizes of `history.json` as a table, a line for each number and recording."""
    dates = {one["recording"]: one["date"] for one in result["recordings"]}
    rows = [
        {**{name: one[name] for name in COLUMNS if name in one}, **value, "date": dates[value["recording"]]}
        for one in result["numbers"]
        for value in one["values"]
    ]
    return csv_text(COLUMNS, rows)


def print_history(found: Diagnosis, all_of: Sequence[Course], dates: Sequence[str]) -> None:
    """Print a line for each recording, and what changed in words."""
    sizes = [f"{one.sized.effect} {one.sized.joint or ''}".strip() + f", {one.sized.unit}" for one in all_of]
    table = new_table("recording", "date", *sizes, right=sizes, whole=("recording", "date"))
    for k, (source, date) in enumerate(zip(found.identify, dates, strict=True)):
        row = (size_text(float(one.sized.values[k]), float(one.sized.stds[k]), "").strip() for one in all_of)
        table.add_row(escape(source), date, *row)
    out.print(table)
    for one in all_of:
        if one.step is not None:
            out.print(f"[yellow]changed:[/] {escape(step_text(one, found.identify))}")
    rest = "nothing else changed" if any(one.step for one in all_of) else "nothing changed"
    out.print(f"{rest} beyond what the recordings tell")
    for place in found.unexplained:
        out.print(f"unexplained: {escape(place.joint)}, {place.side} side, follows {place.regime}")
    out.print(f"notes on the recordings: {len(found.notes)}, in {RESULTS[0]}")
