"""`elastic-arm history`: the numbers of one arm over several recordings, and their changes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import count
from json import dumps as json_text
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors, shares_of
from elastic_arm.cli.gate import FailOn, check_gate, pass_gate
from elastic_arm.cli.outputs import Force, claim_folder
from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.history import Course, courses, together, with_steps
from elastic_arm.diagnosis.result import Diagnosis, from_dict
from elastic_arm.diagnosis.words import regime_text, size_text, step_text
from elastic_arm.effects import Catalogue
from elastic_arm.effects.text import known_effects
from elastic_arm.errors import ElasticArmError
from elastic_arm.estimation.segments import DIAGNOSED, SEGMENT, in_parts, of_one_rate
from elastic_arm.memory import keep_memory
from elastic_arm.output_files import csv_text, write_result
from elastic_arm.processes import ProcessPool
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot

RESULTS = ("history.json", "history.csv", "report.html")
Read = Callable[..., Recording]
Ask = Callable[[Sequence[Recording]], Diagnosis]
# with the numbers, and when each recording begins
Followed = tuple[Diagnosis, tuple[Course, ...], list[str]]
COLUMNS = ("effect", "joint", "parameter", "unit", "recording", "date", "value", "std", "changed")


@reports_errors
def history_command(
    bags: Annotated[
        list[Path],
        typer.Argument(metavar="BAG…", help="Recordings, or one folder of recordings."),
    ],
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
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Diagnose the recordings one by one in this many processes."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Diagnose the recordings one by one on the Dask cluster at this address, which"
            " needs access to the same files."
        ),
    ] = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
    fail_on: FailOn = None,
) -> None:
    """Track the parameters of one arm over several recordings, with time, size and probability of
    changes.

    All recordings are diagnosed together, in chronological order. Every effect
    that is found or declared by --with has a size in each recording. A single
    recording is divided into parts of ten seconds of motion, to detect for
    example a payload that is picked up and kept. Writes history.json,
    history.csv and report.html, with a plot of each size.

    One diagnosis covers up to six recordings of three joints, and fewer for more
    joints. Larger numbers of recordings, incompatible recordings, and all
    recordings with --workers or --scheduler are diagnosed one by one. The exit
    status is that of diagnose.

    Examples:

        elastic-arm history march.bag april.bag may.bag --with coulomb_friction --out history

        elastic-arm history bags/ --robot arm.urdf --fail-on change:5%

        elastic-arm history archive/ --with coulomb_friction --scheduler tcp://10.0.0.2:8786
    """
    check_gate(fail_on or ())
    paths = options.bags_in(bags)
    options.require_bags(paths)
    claim_folder(out_dir, RESULTS, force=force)
    robot = options.load_arm(robot_file, chain, at, Catalogue.default())
    # what is none is refused before the work
    known_effects(with_ or (), robot, Catalogue.default())
    mapping = options.channel_map(channels)
    read = partial(
        options.read_motion, channels=mapping, robot=robot, clock=clock, namespace=namespace
    )
    ask = partial(_asked, robot, model, refit, with_ or ())
    alone = workers is not None or scheduler is not None
    # the motion that one diagnosis holds
    alone |= len(paths) * SEGMENT > DIAGNOSED * min(1.0, 3.0 / robot.n)
    console = Console(quiet=True) if quiet else err
    of_each = partial(_of_each, paths, read, ask, console, workers or 1, scheduler)
    try:
        found, all_of, dates = of_each() if alone else _of_all(paths, read, ask, console)
    except ElasticArmError as error:
        if alone or len(paths) < 3:
            raise
        # one that is not like the others is left out, or compared as far as it goes
        found, all_of, dates = of_each()
        found = replace(
            found, notes=(f"The recordings are diagnosed one by one: {error}", *found.notes)
        )
    result = to_dict(found, all_of, dates)
    write_result(out_dir / RESULTS[0], json_text(result, indent=2, allow_nan=False) + "\n")
    write_result(out_dir / RESULTS[1], to_csv(result))
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.history import write_history_report

    write_history_report(out_dir / RESULTS[2], found, all_of, dates)
    if json:
        print_json(result)
    elif not quiet:
        print_history(found, all_of, dates)
        out.print(f"written: {escape(str(out_dir))}/{', '.join(RESULTS)}")
    pass_gate(found, fail_on or ())


def _asked(
    robot: Robot, model: str, refit: bool, known: Sequence[str], recordings: Sequence[Recording]
) -> Diagnosis:
    keep_memory()  # what was read and left out would leave holes
    given = known_effects(known, robot, Catalogue.default())
    return diagnose(recordings, Question(robot, model, refit=refit, given=given))


def _of_all(paths: Sequence[Path], read: Read, ask: Ask, console: Console) -> Followed:
    """Diagnose all recordings together."""
    seconds = max(DIAGNOSED / len(paths), SEGMENT - 1.0)
    with console.status("reading") as status:
        recordings = [read(path, report=shares_of(status), usual=seconds) for path in paths]
    recordings = [part for one in recordings for part in of_one_rate(one, SEGMENT / 2.0)]
    recordings = sorted(recordings, key=lambda one: one.start_ns)
    if len(paths) == 1:
        least = 2 if len(recordings) == 1 else 1
        recordings = [part for one in recordings for part in in_parts(one, least)]
    with console.status(f"diagnosing {len(recordings)} recordings"):
        found = ask(recordings)
        followed = courses(found)
        return with_steps(found, followed), followed, [_date(one.start_ns) for one in recordings]


def _of_each(
    paths: Sequence[Path],
    read: Read,
    ask: Ask,
    console: Console,
    workers: int,
    scheduler: str | None,
) -> Followed:
    """Diagnose each recording alone, by processes; one that allows no diagnosis is a note."""
    done = count(1)
    with console.status(f"diagnosing {len(paths)} recordings") as status:
        advance = lambda: status.update(f"diagnosed {next(done)} of {len(paths)} recordings")  # noqa: E731
        with ProcessPool(min(workers, len(paths)), scheduler) as pool:
            answers = pool.run(
                [partial(_alone, path.resolve(), read, ask) for path in paths], advance
            )
    catalogue = Catalogue.default()
    told = sorted((one for one in answers if not isinstance(one, str)), key=lambda one: one[0])
    refused = [one for one in answers if isinstance(one, str)]
    for words in refused:
        console.print(escape(words), soft_wrap=True)
    found, followed = together([from_dict(one, Path(), catalogue) for _, one in told], refused)
    return found, followed, [_date(begin) for begin, _ in told]


def _alone(path: Path, read: Read, ask: Ask) -> tuple[int, dict[str, Any]] | str:
    """Return when a recording begins and its `diagnosis.json`, as laws do not pass between
    processes; or why not."""
    try:
        recording = read(path, report=lambda what, share: None, usual=DIAGNOSED)
        return recording.start_ns, replace(ask([recording]), identify=(recording.source,)).to_dict()
    except (ElasticArmError, MemoryError) as error:
        return f"skipped: {str(error) or f'{path}: out of memory'}"


def _date(begin_ns: int) -> str:
    """Return a time in words, UTC."""
    return datetime.fromtimestamp(begin_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def to_dict(found: Diagnosis, all_of: Sequence[Course], dates: Sequence[str]) -> dict[str, Any]:
    """Return what `history.json` holds."""
    return {
        "robot": found.robot,
        "model": found.model,
        "verdict": found.verdict,
        "recordings": [
            {"recording": r, "date": d} for r, d in zip(found.identify, dates, strict=True)
        ],
        "numbers": [one.to_dict(found.identify) for one in all_of],
        "notes": list(found.notes),
    }


def to_csv(result: dict[str, Any]) -> str:
    """Return the sizes of `history.json` as a table, a line for each number and recording."""
    dates = {one["recording"]: one["date"] for one in result["recordings"]}
    rows = []
    for one in result["numbers"]:
        common = {name: one[name] for name in COLUMNS if name in one}
        for value in one["values"]:
            rows.append({**common, **value, "date": dates[value["recording"]]})
    return csv_text(COLUMNS, rows)


def print_history(found: Diagnosis, all_of: Sequence[Course], dates: Sequence[str]) -> None:
    """Print a line for each recording, and what changed in words."""
    names = []
    sizes = []
    for one in all_of:
        place = f"{one.sized.effect} {one.sized.joint or ''}".strip()
        names.append(f"{place}, {one.sized.unit}")
        known = one.sizes(found.identify)
        sizes.append({source: size_text(value, std, "").strip() for source, value, std in known})
    table = new_table("recording", "date", *names, right=names, whole=("recording", "date"))
    for source, date in zip(found.identify, dates, strict=True):
        table.add_row(escape(source), date, *(own.get(source, "–") for own in sizes))
    out.print(table)
    for one in all_of:
        if one.step is not None:
            out.print(f"[yellow]changed:[/] {escape(step_text(one, found.identify))}")
    rest = "no other changes" if any(one.step for one in all_of) else "no changes"
    out.print(f"{rest} detected")
    for joint, side, regime in dict.fromkeys(
        (p.joint, p.side, p.regime) for p in found.unexplained
    ):
        out.print(f"unexplained: {escape(joint)}, {side} side: {regime_text(regime)}")
    out.print(f"notes on the recordings: {len(found.notes)}, in {RESULTS[0]}")
