"""`elastic-arm simulate`: record a simulated arm with any effects."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

from elastic_arm.cli import options
from elastic_arm.cli.console import new_table, out, print_json, progress_bar, reports_errors
from elastic_arm.cli.outputs import claim_bag
from elastic_arm.diagnosis.words import instance_text
from elastic_arm.dynamics import build_model
from elastic_arm.effects import Catalogue, EffectInstance, parse
from elastic_arm.errors import SensorError, SimulationError
from elastic_arm.excitation import (
    FourierTrajectory,
    MotionLimits,
    load_trajectory,
    random_trajectories,
)
from elastic_arm.formatting import JointUnits
from elastic_arm.recording import Recording, write_recording
from elastic_arm.robot import Robot
from elastic_arm.sensors import Encoder, Sensors, TorqueSensor
from elastic_arm.simulation import SimulationSettings, check_same_joints
from elastic_arm.simulation import simulate as run_simulation

DEFAULT_TRAJECTORY = "default"
SENSORS = {"nominal": Sensors, "exact": Sensors.exact, "real": Sensors.real}


def _list_effects(context: typer.Context, value: bool) -> None:
    """Print the catalogue and leave."""
    if not value:
        return
    table = new_table("effect", "law", "parameters", "sits on", whole=("effect",))
    for effect in (
        Catalogue.default().with_files(context.params.get("effects_files") or ()).values()
    ):
        numbers = [f"{p.name} [{p.unit}]" for p in effect.parameters]
        choices = [
            f"{c.name} ({('+' if c.several else '|').join(c.values)})" for c in effect.choices
        ]
        cells = (effect.id, effect.formula, ", ".join([*numbers, *choices]), effect.scope.value)
        table.add_row(*(escape(cell) for cell in cells))
    out.print(table)
    raise typer.Exit


@reports_errors
def simulate(
    out_bag: Annotated[Path, typer.Option("--out", help="Bag to write; it must not exist.")],
    robot_file: Annotated[
        Path | None,
        typer.Option(
            "--robot", help="True arm: arm file, URDF or MJCF; by default the nominal arm."
        ),
    ] = None,
    chain: options.Chain = None,
    at: options.At = None,
    nominal_file: Annotated[
        Path | None,
        typer.Option(
            "--nominal", help="Nominal arm of controller and recording; by default the true arm."
        ),
    ] = None,
    trajectory: Annotated[
        str,
        typer.Option(
            help="Trajectory file, or 'default' for a random Fourier motion within the limits."
        ),
    ] = DEFAULT_TRAJECTORY,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            help="Effect of the true arm: EFFECT[:JOINT][:NAME=VALUE,…]; may be repeated.",
            autocompletion=options.completions,
        ),
    ] = None,
    effects_files: options.EffectsFiles = None,
    list_effects: Annotated[
        bool,
        typer.Option(
            "--list-effects", callback=_list_effects, is_eager=True, help="List all effects."
        ),
    ] = False,
    model: options.Model = "mod3",
    bearings: Annotated[
        bool, typer.Option("--bearings", help="Simulate the tilt of the bearings.")
    ] = False,
    duration: Annotated[
        float | None, typer.Option(help="Duration, s; by default that of the trajectory.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Samples per second; by default that of the arm file.")
    ] = None,
    substeps: Annotated[
        int, typer.Option(help="Minimum number of integration steps per sample; even.")
    ] = 10,
    sensors: Annotated[
        str, typer.Option(help="Sensors: nominal, exact, or real (encoder noise, jitter).")
    ] = "nominal",
    noise: Annotated[
        float | None, typer.Option(help="Standard deviation of the torque noise, Nm.")
    ] = None,
    encoder_noise: Annotated[
        float | None, typer.Option(help="Standard deviation of the encoder noise, rad.")
    ] = None,
    seed: options.Seed = 0,
    json: options.Json = False,
) -> None:
    """Simulate an arm that follows a trajectory, and record it as a bag.

    Examples:

        elastic-arm simulate --out clean

        elastic-arm simulate --trajectory traj.yaml --effect coulomb_friction:joint_2:torque=13.9
        --seed 1 --out bag

        elastic-arm simulate --effect payload:mass=5,position=0/0/0.1 --sensors real --out loaded

        elastic-arm simulate --effects buffer.py --effect
        rubber_buffer:joint_2:stiffness=40,contact=0.4 --out own

        elastic-arm simulate --list-effects
    """
    claim_bag(out_bag)
    catalogue = Catalogue.default().with_files(effects_files or ())
    robot = options.load_arm(robot_file, chain, at, catalogue)
    nominal = (
        robot.with_(effects=())
        if nominal_file is None
        else options.load_arm(nominal_file, catalogue=catalogue)
    )
    check_same_joints(robot, nominal)
    effects = [parse(text, robot, catalogue) for text in effect or ()]
    motion = _motion(trajectory, nominal, model, seed)
    read = _sensors(sensors, robot, noise, encoder_noise)
    sampled = robot.sample_rate if rate is None else rate
    settings = SimulationSettings(
        model,
        bearings,
        effects,
        read,
        nominal=nominal,
        rate=sampled,
        substeps=substeps,
        catalogue=catalogue,
    )
    begin = time.perf_counter()
    recording = _simulated(
        robot, motion, settings, duration=duration, rng=np.random.default_rng(seed)
    )
    seconds = time.perf_counter() - begin
    write_recording(out_bag, recording)
    summary = _summary(recording, effects, seconds, robot.units)
    if json:
        print_json(
            {"bag": str(out_bag), "robot": robot.name, "model": model, "seed": seed, **summary}
        )
    else:
        _print_summary(effects, summary, out_bag, robot.units)


def _simulated(
    robot: Robot,
    motion: FourierTrajectory,
    settings: SimulationSettings,
    *,
    duration: float | None,
    rng: np.random.Generator,
) -> Recording:
    """Simulate, with a bar of what is done."""
    with progress_bar(TextColumn("simulating"), BarColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("", total=None)

        def report(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        return run_simulation(robot, motion, settings, duration=duration, rng=rng, progress=report)


def _motion(trajectory: str, robot: Robot, model: str, seed: int) -> FourierTrajectory:
    if trajectory != DEFAULT_TRAJECTORY:
        motion = load_trajectory(trajectory)
        if motion.n != robot.n:
            raise SimulationError(
                f"{trajectory} has {motion.n} joints, but {robot.name} has {robot.n}",
                "Create a trajectory with elastic-arm excite.",
            )
        return motion
    rng = np.random.default_rng(seed)
    return random_trajectories(build_model(robot, model), MotionLimits.of(robot), 1, rng=rng)[0]


def _sensors(name: str, robot: Robot, noise: float | None, encoder_noise: float | None) -> Sensors:
    if name not in SENSORS:
        raise SensorError(f"unknown sensors {name!r}", f"Choose one of {', '.join(SENSORS)}.")
    sensors = SENSORS[name]()
    torque = robot.torque_noise_std if noise is None and name != "exact" else noise
    if torque is not None:
        sensors = replace(
            sensors, joint_torque=TorqueSensor(torque), motor_torque=TorqueSensor(torque)
        )
    if encoder_noise is not None:
        encoder: Encoder = replace(sensors.link_encoder, noise=encoder_noise)
        sensors = replace(sensors, link_encoder=encoder, motor_encoder=encoder)
    return sensors


def _summary(
    recording: Recording, effects: list[EffectInstance], seconds: float, units: JointUnits
) -> dict[str, Any]:
    samples = recording.samples()
    reference = recording.reference
    torque = np.abs(samples.tau_m).max(axis=0) if samples.tau_m is not None else []
    lag = (
        np.abs(samples.theta - reference.position).max(axis=0)
        if samples.theta is not None and reference is not None and reference.position is not None
        else []
    )
    return {
        "samples": len(samples),
        "duration_s": float(recording.duration),
        "wall_s": round(seconds, 3),
        "effects": [instance.to_dict() for instance in effects],
        "joints": list(recording.joints),
        "peak_motor_torque_nm": [float(value) for value in torque],
        "largest_tracking_error_rad": [float(value) for value in lag],
        # Of these two, where a joint slides.
        "units": {
            joint: [units.at(joint, unit) for unit in ("Nm", "rad")] for joint in recording.joints
        },
    }


def _print_summary(
    effects: list[EffectInstance], summary: dict[str, Any], bag: Path, units: JointUnits
) -> None:
    out.print(
        f"{summary['duration_s']:g} s of motion, {summary['samples']} samples, simulated in"
        f" {summary['wall_s']:.2f} s"
    )
    for instance in effects:
        place = instance.joint or "the whole arm"
        words = instance_text(instance, units)
        out.print(
            f"  [bold]{instance.effect.id}[/] on {escape(place)}:"
            f" {escape(words) or 'no parameters'}"
        )
    numbers = (f"peak tau_m, {units.over('Nm')}", f"tracking error, {units.over('mrad')}")
    table = new_table("joint", *numbers, right=numbers)
    rows = zip(
        summary["joints"],
        summary["peak_motor_torque_nm"],
        summary["largest_tracking_error_rad"],
        strict=True,
    )
    for joint, torque, lag in rows:
        table.add_row(escape(joint), f"{torque:.1f}", f"{1e3 * lag:.2f}")
    out.print(table)
    out.print(f"bag written to {escape(str(bag))}")
