"""`elastic-arm excite`: find a motion that determines an arm's parameters, within its limits."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from elastic_arm.cli import options
from elastic_arm.cli.console import new_table, out, print_json, progress_bar, reports_errors
from elastic_arm.cli.describe import base_of
from elastic_arm.cli.outputs import Force, claim_file
from elastic_arm.dynamics import Model, build_model
from elastic_arm.excitation import (
    MARGIN,
    ExcitationResult,
    MotionLimits,
    Shape,
    Workspace,
    find_criterion,
    optimise,
)
from elastic_arm.excitation.setpoints import write_csv, write_goal
from elastic_arm.formatting import JointUnits
from elastic_arm.identification.base_parameters import BaseParameters
from elastic_arm.identification.planned import judged
from elastic_arm.identification.verdict import Excitation

Limit = Annotated[
    float | None,
    typer.Option(
        help="Limit of all joints; higher ones in the arm file are reduced to it.",
        show_default=False,
    ),
]


@reports_errors
def excite(
    robot_file: options.RobotFile = None,
    chain: options.Chain = None,
    at: options.At = None,
    file: Annotated[Path, typer.Option("--out", help="Trajectory file (YAML) to write.")] = Path(
        "trajectory.yaml"
    ),
    model: options.Model = "mod3",
    harmonics: Annotated[
        int, typer.Option(help="Number of harmonics of the Fourier series of every joint.")
    ] = 5,
    period: Annotated[float, typer.Option(help="Period of the Fourier series, s.")] = 10.0,
    periods: Annotated[
        int | None,
        typer.Option(
            help="Number of whole periods; by default as many as `identify` needs.",
            show_default=False,
        ),
    ] = None,
    ramp: Annotated[
        float | None,
        typer.Option(
            help="Duration of the smooth start and stop, s each; by default a quarter period."
        ),
    ] = None,
    criterion: Annotated[
        str, typer.Option(help="Criterion of the search: condition, d_optimal or a_optimal.")
    ] = "a_optimal",
    evaluations: Annotated[
        int, typer.Option(help="Maximum number of evaluations in the search.")
    ] = 3000,
    seed: options.Seed = 0,
    velocity: Limit = None,
    acceleration: Limit = None,
    torque: Limit = None,
    floor: Annotated[
        float, typer.Option(help="Height of the floor above the ground frame, m.")
    ] = 0.0,
    margin: Annotated[
        float, typer.Option(help="Minimum distance of the links to the floor and to each other, m.")
    ] = MARGIN,
    json: options.Json = False,
    csv: Annotated[
        Path | None, typer.Option(help="Also write set-points as CSV, or as LeRobot's .parquet.")
    ] = None,
    goal: Annotated[
        Path | None,
        typer.Option(
            help="Also write a goal for joint_trajectory_controller (YAML), for `ros2 action`."
        ),
    ] = None,
    rate: Annotated[float, typer.Option(help="Set-points per second in these files.")] = 20.0,
    force: Force = False,
) -> None:
    """Find a Fourier trajectory within all limits that determines the arm's parameters best.

    Examples:

        elastic-arm excite --out traj.yaml --csv traj.csv

        elastic-arm excite --robot my_arm.urdf --criterion d_optimal --velocity 1.0
    """
    claim_file(file, force=force)
    for further, option in ((csv, "--csv"), (goal, "--goal")):
        if further is not None:
            claim_file(further, force=force, option=option)
    find_criterion(criterion)
    shape = Shape(harmonics, period, ramp, periods or 1)
    robot = options.load_arm(robot_file, chain, at)
    options.refuse_doubtful(robot)
    told = build_model(robot, model)
    base = base_of(told)
    limits = MotionLimits.of(
        robot,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque,
        workspace=Workspace.of(robot, floor=floor),
        margin=margin,
    )
    result = _search(told, limits, base, shape, criterion, evaluations, seed)
    done, judgement = judged(told, result.trajectory, periods)
    result = replace(result, trajectory=result.trajectory.repeated(done))
    result.trajectory.save(file)
    for further, write in ((csv, write_csv), (goal, write_goal)):
        if further is not None:
            write(further, result.trajectory, robot.joint_names, rate)
    if json:
        said = {"periods": done, "poor": judgement.poor, "reasons": list(judgement.reasons)}
        arm = {"robot": robot.name, "model": model, "trajectory": str(file)}
        print_json({**arm, **result.to_dict(), "excitation": said})
    else:
        _print_result(result, limits, base, told, file)
        _print_judgement(judgement, done, told)


def _print_judgement(judgement: Excitation, periods: int, model: Model) -> None:
    times = f"{periods} period{'s' * (periods > 1)}"
    if not judgement.poor:
        out.print(f"`identify` will rate this motion [green]good[/] ({times})")
        return
    reasons = escape("; ".join(judgement.reasons))
    out.print(f"`identify` will rate this motion [yellow]poor[/] ({times}): {reasons}")
    if judgement.undetermined:
        bodies = Counter(name.partition(".")[0] for name in judgement.undetermined)
        counted = ", ".join(f"{count} of {body}" for body, count in bodies.items())
        out.print(f"  not determined: {escape(counted)}", soft_wrap=True)
    out.print(
        "  Higher limits (--acceleration, --velocity) allow a faster motion. A known mass at the"
        " flange raises torques of links that stay below the noise.",
        soft_wrap=True,
    )


def _search(
    model: Model,
    limits: MotionLimits,
    base: BaseParameters,
    shape: Shape,
    criterion: str,
    evaluations: int,
    seed: int,
) -> ExcitationResult:
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with progress_bar(*columns) as progress:
        task = progress.add_task("random motions", total=evaluations)

        def show(evaluation: int, best: float) -> None:
            progress.update(task, completed=evaluation, description=f"best {criterion} {best:.4g}")

        return optimise(
            model,
            limits,
            base.columns,
            rng=np.random.default_rng(seed),
            shape=shape,
            criterion=criterion,
            evaluations=evaluations,
            progress=show,
        )


def _print_result(
    result: ExcitationResult, limits: MotionLimits, base: BaseParameters, model: Model, file: Path
) -> None:
    low, median, high = (
        np.percentile(result.random, [0, 50, 100]) if len(result.random) else [np.nan] * 3
    )
    if result.criterion == "a_optimal":
        times = 10.0 ** (result.value_before - result.value_after)
        out.print(
            f"standard deviations of the {len(result.columns)} base parameters:"
            f" [bold green]{times:.3g}[/] times smaller than with the best random motion, after"
            f" {result.evaluations} evaluations"
        )
    elif result.criterion == "d_optimal":
        out.print(
            f"d_optimal: {result.value_before:.4g} with the best random motion,"
            f" [bold green]{result.value_after:.4g}[/] after {result.evaluations} evaluations"
        )
    out.print(
        f"condition number of the base regressor: [bold]{result.condition_after:.4g}[/]; at the"
        f" start of the search: {result.condition_before:.4g}; {len(result.random)} random motions:"
        f" {low:.4g} … {median:.4g} (median) … {high:.4g}",
        soft_wrap=True,
    )
    for sentence in indistinct_words(result, base, model):
        out.print(
            "[yellow]excluded from the search because only nearly exact encoders determine it:[/]"
            f" {escape(sentence)}",
            soft_wrap=True,
        )
    out.print(_limit_table(result, model.robot.units))
    for name, gap in result.use.gaps():
        out.print(
            f"smallest distance to {escape(name)}: {1e3 * gap:.0f} mm (margin"
            f" {1e3 * limits.margin:g} mm)"
        )
    for sentence in limits.assumed:
        out.print(f"[cyan]note:[/] {escape(sentence)}", soft_wrap=True)
    trajectory = result.trajectory
    out.print(f"{trajectory.duration:g} s of motion written to {escape(str(file))}")


def indistinct_words(result: ExcitationResult, base: BaseParameters, model: Model) -> list[str]:
    """Return the names of the base parameters that were left out of the search."""
    names = dict(zip((int(c) for c in base.columns), base.names, strict=True))
    return [names.get(c, model.parameters[c].name) for c in result.indistinct]


def _limit_table(result: ExcitationResult, units: JointUnits) -> Table:
    use = result.use
    numbers = (*use.kinds, "peak torque")
    table = new_table(
        "joint", *numbers, right=numbers, title="used share of the limits", title_justify="left"
    )
    for i, joint in enumerate(use.joints):
        shares = [use.share(kind, i) for kind in use.kinds]
        cells = ["–" if share is None else f"{100 * share:.0f} %" for share in shares]
        table.add_row(escape(joint), *cells, f"{use.peak_torque[i]:.4g} {units.at(joint, 'Nm')}")
    return table
