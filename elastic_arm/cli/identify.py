"""`elastic-arm identify`: parameters with standard deviations from recordings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, TextColumn

from elastic_arm.cli import options
from elastic_arm.cli.console import new_table, out, print_json, progress_bar, reports_errors
from elastic_arm.cli.mujoco.corrected import Correction, Written, print_correction
from elastic_arm.cli.mujoco.export import print_closed_loop
from elastic_arm.cli.outputs import Csv, Force, claim_folder
from elastic_arm.diagnosis.words import listed
from elastic_arm.effects import Catalogue, robot_effects
from elastic_arm.effects.library.gravity_compensation import EFFECT as COMPENSATION
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.segments import IDENTIFIED
from elastic_arm.formatting import rounded
from elastic_arm.identification import (
    Estimate,
    Identification,
    IdentificationSettings,
    identify_with,
    parse_laws,
)
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.batch.ignored_commands import without
from elastic_arm.identification.result import COMPARED
from elastic_arm.memory import keep_memory
from elastic_arm.mujoco import Exported
from elastic_arm.mujoco.judgement import Judging
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.check import misread
from elastic_arm.recording.made_torque import is_commanded
from elastic_arm.robot import Robot, with_joints_of

TABLES = ("parameters.csv", "residuals.csv")
RESULTS = ("identification.json", "report.html", "robot.yaml")
# Arms of the validation, where a file has them.
ROWS = {"consistent": "robot.yaml"}
COLOURS = {"well": "green", "poorly": "yellow", "not": "red"}


Laws = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        help="Effect to identify as well: EFFECT[:JOINT][:side=link]; may be repeated.",
        autocompletion=options.completions,
    ),
]
HeldOut = Annotated[
    list[Path] | None, typer.Option(help="Held-out recording for validation; may be repeated.")
]


@reports_errors
def identify(
    bags: Annotated[list[Path], typer.Argument(metavar="BAG…", help="Recordings to fit.")],
    validate: HeldOut = None,
    robot_file: options.RobotFile = None,
    chain: options.Chain = None,
    at: options.At = None,
    model: options.Model = "mod3",
    with_: Laws = None,
    effects_files: options.EffectsFiles = None,
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    clock: options.Clock = options.ClockChoice.auto,
    most: options.Motion = None,
    consistent: Annotated[
        bool,
        typer.Option(help="Also estimate all parameters such that they are physically consistent."),
    ] = True,
    out_dir: options.OutFolder = Path("identified"),
    json: options.Json = False,
    csv: Csv = False,
    force: Force = False,
) -> None:
    """Identify an arm's parameters from recordings.

    Writes identification.json and report.html. If the parameters are physically consistent, it also
    writes robot.yaml, an arm file for `elastic-arm simulate --robot`, and a copy of your MJCF or
    URDF with identified numbers.

    Examples:

        elastic-arm identify bag

        elastic-arm identify slow fast --validate other --with coulomb_friction --with
        viscous_friction

        elastic-arm identify lwr_1 lwr_3 --robot lwr.urdf --with coulomb_friction:side=link
        --validate lwr_2
    """
    options.require_bags([*bags, *(validate or [])])
    claim_folder(out_dir, [*RESULTS, *(TABLES if csv else ())], force=force)
    catalogue = Catalogue.default().with_files(effects_files or ())
    robot = options.load_arm(robot_file, chain, at, catalogue)
    laws = parse_laws(with_ or (), robot, catalogue)
    settings = IdentificationSettings(model, laws, consistent, catalogue)
    mapping = options.channel_map(channels)
    with progress_bar(TextColumn("{task.description}", markup=False), BarColumn()) as bar:
        task = bar.add_task("reading", total=1.0)

        def says(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        def read(path: Path) -> Recording:
            return options.read_motion(
                path, mapping, robot, clock, namespace, says, IDENTIFIED, most
            )

        recordings = [read(path) for path in bags]
        held_out = [read(path) for path in validate or []]
        keep_memory()  # what was read and left out would leave holes
        result, identifier, motion, ignored = identify_with(
            recordings, robot, settings, validate=held_out, progress=says
        )
        says("report", 1.0)
        stated = any(
            law.effect.id == COMPENSATION.id for law in (*laws, *robot_effects(robot, catalogue))
        )
        wrong = misread(recordings, robot, explained=stated)
        result = result if wrong is None else result.with_(identified=None)
        correction = Correction(robot_file, chain, at, catalogue)
        written = _corrected(result, robot, correction, held_out or recordings, ignored, out_dir)
        result = _judged(result, written)
        _write(result, sections_of=(identifier.equations, motion), out_dir=out_dir)
        if csv:
            result.to_csv(out_dir)
        corrected = written.file or wrong
    if json:
        print_json(result.to_dict())
    else:
        _print(result, out_dir, corrected)
        print_closed_loop({} if written.choice is None else written.choice.errors)


def _corrected(
    result: Identification,
    robot: Robot,
    correction: Correction,
    judges: Sequence[Recording],
    ignored: Mapping[str, Sequence[tuple[float, float]]],
    folder: Path,
) -> Written:
    """Write the file that the arm came from; of a commanded one, what of it does not move the arm
    worse."""
    identified = result.identified
    selected = [one.select(robot.joint_names) for one in judges]
    if identified is None or not all(is_commanded(one) for one in selected):
        return Written(correction.write(identified, folder), identified)
    followed = [
        without(one, spans) if (spans := ignored.get(one.source)) else one for one in selected
    ]
    return correction.judged(
        robot,
        lambda back: with_joints_of(identified, robot, back),
        robot.joint_names,
        [Judging(one) for one in followed],
        folder,
        caused=True,
    )


def _judged(result: Identification, written: Written) -> Identification:
    """Return a result with how a commanded arm moves, and which joints are not written."""
    choice = written.choice
    if choice is None:
        return result
    errors = {name: one.to_dict() for name, one in choice.errors.items()}
    result = result.with_(
        closed_loop=errors,
        identified=written.robot or result.identified,
        notes=(*written.notes(), *result.notes),
    )
    if not choice.worse:
        return result
    what = "the corrected file" if written.robot is not None else "no file"
    words = (
        f"With all identified parameters, the errors of {listed(choice.worse)} under the recorded"
        f" commands increase: the parameters of {listed(choice.taken_back)} stay as described, and"
        f" {what} is written."
    )
    return result.with_(notes=(words, *result.notes))


def _write(
    result: Identification, sections_of: tuple[BaseRegression, Motion], out_dir: Path
) -> None:
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.html import write_report
    from elastic_arm.report.identification import sections

    result.to_json(out_dir / "identification.json")
    # Without it, the arm of an earlier run would stand beside results that it does not belong to.
    (out_dir / "robot.yaml").unlink(missing_ok=True)
    if result.identified is not None:
        result.save_robot(out_dir / "robot.yaml")
    subtitle = f"{result.model}, {', '.join(result.recordings)}"
    parts = sections(result, *sections_of)
    write_report(
        out_dir / "report.html", f"Identification of {result.robot}", parts, subtitle=subtitle
    )


def _print(result: Identification, out_dir: Path, corrected: Exported | str | None) -> None:
    if result.excitation["poor"]:
        reasons = "; ".join(result.excitation["reasons"])
        remedy = (
            "`elastic-arm excite` finds a better motion. Parameters that this motion determines"
            " nevertheless are marked `well` below."
        )
        out.print(
            "[bold yellow]the excitation is poor[/], judged by the motion alone:"
            f" {escape(reasons)}; {remedy}"
        )
    for sentence in result.summary():
        out.print(escape(sentence))
    _print_estimates(sorted(result.estimates, key=lambda e: not e.is_friction))
    methods = ", ".join(dict.fromkeys(result.derivatives))
    out.print(f"{result.samples} samples, {methods}, condition number {result.condition:.3g}")
    for note in result.notes:
        out.print(f"note: {escape(note)}")
    for direction in result.undetermined:
        out.print(f"[red]not determined by the data:[/] {escape(direction)}")
    for title, rows in _residual_rows(result):
        out.print(f"[bold]{escape(title)}[/]")
        shown = new_table("", *result.joints, right=result.joints)
        for name, values in rows:
            shown.add_row(
                escape(name), *("–" if value is None else f"{value:.3g}" for value in values)
            )
        out.print(shown)
    written = [
        "identification.json",
        "report.html",
        *(["robot.yaml"] if result.identified is not None else []),
    ]
    out.print(
        f"results in {escape(str(out_dir))}: {', '.join(written)}, with all parameter"
        " combinations in full"
    )
    print_correction(corrected)


def _print_estimates(estimates: Sequence[Estimate]) -> None:
    headings = ("parameter", "identified", "± std", "nominal", "unit", "determined")
    table = new_table(*headings, right=headings[1:4])
    for e in estimates:
        # Sums of products leave rounding errors where nothing is described.
        nominal = e.nominal if abs(e.nominal) > 1e-9 * e.std else 0.0
        numbers = (*rounded(e.value, e.std), f"{nominal:.6g}", e.unit)
        table.add_row(escape(e.short), *numbers, f"[{COLOURS[e.verdict]}]{e.verdict}[/]")
    out.print(table)


def _residual_rows(
    result: Identification,
) -> list[tuple[str, list[tuple[str, list[float | None]]]]]:
    fitted = [
        (COMPARED[side], [values.get(joint) for joint in result.joints])
        for side, values in result.noise.items()
    ]
    unit = result.units.over("Nm")
    tables = [(f"residual of the fit, {unit}", fitted)]
    for recording, arms in (result.validation or {}).items():
        sides = [
            (arm, side, values) for arm, by_side in arms.items() for side, values in by_side.items()
        ]
        rows = [
            (f"{ROWS.get(arm, arm)}, {COMPARED[side]}", [*map(values.get, result.joints)])
            for arm, side, values in sides
        ]
        tables.append((f"validation on {recording}, {unit}", rows))
    return tables
