"""`elastic-arm demo`: the whole suite at work in a live ROS 2 graph, from excitation to estimate and diagnosis."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, TextColumn
from rich.rule import Rule
from rich.table import Table
from scipy.stats import chi2

from elastic_arm.cli.console import err, out, progress_bar, reports_errors
from elastic_arm.cli.describe import base_of
from elastic_arm.cli.diagnose import print_diagnosis, write_diagnosis
from elastic_arm.cli.processes import Nodes
from elastic_arm.diagnosis import Question, diagnose, follow_up
from elastic_arm.diagnosis.words import instance_text
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.errors import GraphError, OutputError, require_ros
from elastic_arm.excitation import (
    ExcitationResult,
    FourierTrajectory,
    MotionLimits,
    Shape,
    Workspace,
    optimise,
    random_trajectories,
)
from elastic_arm.identification import Identification, chi_square, compare, identify, std_ratio
from elastic_arm.recording import read_recording, write_recording
from elastic_arm.robot import Robot, load_robot, save_robot, varied
from elastic_arm.simulation import SimulationSettings, simulate

EVALUATIONS = 600
SHAPE = Shape(harmonics=5, period=8.0, periods=2)
HEADING = 80  # columns
# How long nodes may take to find each other, and the first kernels to compile, seconds.
START = 120.0


@reports_errors
def demo(
    folder: Annotated[Path, typer.Option("--out", help="Folder of all that the demo writes.")] = Path("runs/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Of the arm, the search and the noise.")] = 1,
    speed: Annotated[
        float, typer.Option(min=0.1, max=20.0, help="Times real time; above 1 the graph runs on /clock.")
    ] = 1.0,
) -> None:
    """Move an arm in a live ROS 2 graph, record it, and identify it: live, and again from the bag.

    The simulated arm differs from its description by up to 15 % in every inertial and elastic number, so that there
    is something to find. Its true numbers are read only by the comparison at the end.
    """
    require_ros("the demo shows a live graph, which needs")
    _make_room(folder)
    nominal = load_robot(None)
    true_arm = varied(nominal, np.random.default_rng(seed))
    save_robot(true_arm, folder / "true_arm.yaml")
    _heading("1  a motion that excites the parameters")
    search = _excite(nominal, folder / "trajectory.yaml", seed)
    _heading("2  the live graph: simulator, trajectory generator, identifier, recorder")
    online = _live(folder, search.trajectory, seed, speed)
    _heading("3  the same arm, identified from the bag")
    offline = identify(read_recording(folder / "bag"), nominal)
    out.print(f"{offline.samples} samples, derivatives by {', '.join(offline.derivatives)}")
    _heading("4  estimates and the truth")
    truth = _truth(offline, true_arm)
    _compare(offline, online, truth)
    report = _report(folder / "report.html", search, offline)
    _heading("5  another arm has an effect that the diagnosis is not told")
    _diagnose_withheld(folder / "withheld", nominal, search.trajectory, np.random.default_rng(seed))
    out.print(f"\nbag:     {escape(str(folder / 'bag'))}   (ros2 bag info, Foxglove, PlotJuggler)")
    out.print(f"report:  {escape(str(report))}")


def _heading(title: str) -> None:
    out.print(Rule(escape(title)), width=HEADING)


def _make_room(folder: Path) -> None:
    """Clear what an earlier demo left in its folder, and nothing else."""
    left = [folder / name for name in ("bag", "nodes", "online", "withheld") if (folder / name).is_dir()]
    if left and not (folder / "true_arm.yaml").is_file():
        raise OutputError(f"{left[0]} exists and is no demo's", "Choose another folder with --out.")
    for path in left:
        shutil.rmtree(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} cannot be made: {error.strerror}", "Choose another folder with --out.") from error


def _excite(nominal: Robot, file: Path, seed: int) -> ExcitationResult:
    model = build_model(nominal, "mod3")
    limits = MotionLimits.of(nominal, workspace=Workspace.of(nominal))
    with progress_bar(TextColumn("{task.description}", markup=False), BarColumn()) as progress:
        task = progress.add_task("pattern search", total=EVALUATIONS)
        result = optimise(
            model,
            limits,
            base_of(model).columns,
            rng=np.random.default_rng(seed),
            shape=SHAPE,
            evaluations=EVALUATIONS,
            progress=lambda k, best: progress.update(task, completed=k, description=f"condition number {best:.2f}"),
        )
    result.trajectory.save(file)
    out.print(
        f"condition number of the base regressor: {result.condition_after:.2f}; random motions within the same limits: "
        f"{np.median(result.random):.2f} (median)"
    )
    return result


def _live(folder: Path, motion: FourierTrajectory, seed: int, speed: float) -> dict[str, Any]:
    """Run the graph until the trajectory has been streamed; return the last estimate of the identifier."""
    domain = int(os.environ.get("ROS_DOMAIN_ID", 1 + os.getpid() % 100))
    lines: list[dict[str, Any]] = []
    with Nodes(folder / "nodes", domain) as nodes, Live(console=out, refresh_per_second=4) as live:
        nodes.start("recorder", {"bag": str(folder / "bag")})
        nodes.start("identifier", {"print": True, "save_at_exit": True, "save_to": str(folder / "online")})
        arm = {"robot": str(folder / "true_arm.yaml"), "initial_position": motion.q0.tolist()}
        nodes.start("simulator", {**arm, "seed": seed, "real_time_factor": speed})
        trajectory = {"trajectory": str(folder / "trajectory.yaml"), "use_sim_time": speed != 1.0}
        nodes.start("trajectory_generator", trajectory)
        waited = 0.0
        while nodes.running("trajectory_generator"):
            heard = [json.loads(line) for line in nodes.told(0.5)]
            lines += heard
            waited += 0.0 if lines else 0.5
            if waited > motion.duration / speed + START:
                raise GraphError("no estimate arrived", f"The nodes' messages are in {folder / 'nodes'}.")
            live.update(_progress(lines, motion.duration))
        for name in ("simulator", "identifier", "recorder"):
            nodes.stop(name)
        lines += [json.loads(line) for line in nodes.told(0.5)]
        live.update(_progress(lines, motion.duration))
    if not out.is_terminal:
        out.print()  # the last line of a live display has no end in a pipe
    if not lines:
        raise GraphError("the identifier made no estimate", f"Its output is in {nodes.log('identifier')}.")
    return lines[-1]


def _progress(lines: list[dict[str, Any]], duration: float) -> Table:
    table = Table(box=None, header_style="bold", title=f"{duration:.0f} s of motion at 1 kHz", title_justify="left")
    for heading in ("samples", "residual RMS [Nm]", "condition number", "std of the worst parameter"):
        table.add_column(heading, justify="right")
    for line in lines[-8:]:
        value, std = (np.abs(np.array(line[key], dtype=float)) for key in ("value", "std"))
        worst = float(np.nanmax(std / np.maximum(value, 1e-12))) if len(value) else float("nan")
        table.add_row(
            str(line["samples"]),
            f"{line['residual_rms']:.4f}",
            f"{line['condition_number'] or np.inf:.4g}",
            f"{100 * worst:.3g} %",
        )
    if not lines:
        table.add_row("waiting for the first estimate…", "", "", "")
    return table


def _truth(identified: Identification, true_arm: Robot) -> np.ndarray:
    """Return the true base parameters (B,): scoring, the only function of the demo that reads the true arm."""
    return np.array([parameter.true for parameter in compare(identified, true_arm)])


def _compare(offline: Identification, live: dict[str, Any], truth: np.ndarray) -> None:
    online = dict(zip(live["name"], zip(live["value"], live["std"], strict=True), strict=True))
    values, stds = (np.array([online[e.name][k] for e in offline.estimates], dtype=float) for k in (0, 1))
    on, off = (values - truth) / stds, (offline.Psi_base - truth) / offline.std
    headings = ("nominal", "true", "online", "error", "offline", "error")
    rows = [
        (*(f"{v:.4g}" for v in (e.nominal, truth[k], values[k])), f"{on[k]:+.1f}", f"{e.value:.4g}", f"{off[k]:+.1f}")
        for k, e in enumerate(offline.estimates)
    ]
    table = Table(
        box=None, header_style="bold", pad_edge=False, title="errors in standard deviations", title_justify="left"
    )
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("base parameter")
    for e, row in zip(offline.estimates, rows, strict=True):
        table.add_row(*row, escape(e.short))
    out.print(table)
    out.print(
        f"true value within two standard deviations: online {int((np.abs(on) < 2).sum())}, "
        f"offline {int((np.abs(off) < 2).sum())} of {len(truth)} base parameters"
    )
    out.print(
        f"one torque scale is common to all, so that their errors go together: chi² with correlations "
        f"{chi_square(offline, truth):.0f}, 95 % of fits stay below {chi2.ppf(0.95, len(truth)):.0f}"
    )
    apart = np.abs(values - offline.Psi_base) / np.hypot(stds, offline.std)
    out.print(f"online and offline apart: at most {apart.max():.2f} standard deviations")
    out.print(escape(std_ratio(stds, offline).summary()))


def _report(path: Path, search: ExcitationResult, offline: Identification) -> Path:
    """Write the report of the identification, with the search for the motion."""
    # Matplotlib is slow to import, and only this needs it.
    from elastic_arm.report.excitation import condition_against_random, search_course
    from elastic_arm.report.html import Figure, Section, write_report
    from elastic_arm.report.identification import sections

    drawn = [
        Figure(search_course(search), "Course of the pattern search."),
        Figure(condition_against_random(search), "Random motions and the optimised one."),
    ]
    parts = [*sections(offline), Section("Excitation", drawn)]
    return write_report(path, "The live arm", parts, subtitle=f"{offline.robot}, {offline.model}")


def _diagnose_withheld(folder: Path, nominal: Robot, motion: FourierTrajectory, rng: np.random.Generator) -> None:
    """Record an arm with a drawn effect on two motions, diagnose the bags, and print what was drawn afterwards."""
    drawn = _draw(nominal, rng)
    other = random_trajectories(build_model(nominal), MotionLimits.of(nominal), 1, rng=rng)[0]
    with err.status("recording the arm on two motions"):
        for name, trajectory in (("identify", motion), ("validate", other)):
            write_recording(folder / name, simulate(nominal, trajectory, SimulationSettings(effects=[drawn]), rng=rng))
    with err.status("diagnosing"):
        fitted, judged = (read_recording(folder / name) for name in ("identify", "validate"))
        found = follow_up(diagnose([fitted], Question(nominal), [judged]), rng=rng)
        write_diagnosis(found, nominal, folder)
    print_diagnosis(found, folder)
    words = f"{drawn.effect.id} on {drawn.joint}, {instance_text(drawn, nominal.units)}"
    out.print(f"what had been drawn: {escape(words)}")


def _draw(robot: Robot, rng: np.random.Generator) -> EffectInstance:
    """Draw one of the effects whose file names clear examples, its joint, and its numbers from these."""
    drawn = {e.id: e for e in EFFECTS.values() if e.parameters and e.parameter(e.magnitude[0]).example}
    effect = drawn[str(rng.choice(sorted(drawn)))]
    sizes = {p.name: float(rng.uniform(*p.example)) for p in effect.parameters if p.example}
    return EffectInstance(effect, str(rng.choice(robot.joint_names)), sizes)
