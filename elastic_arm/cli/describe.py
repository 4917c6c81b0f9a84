"""`elastic-arm describe`: an arm as described, and the parameters of its models."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors
from elastic_arm.cli.outputs import Force, claim_file
from elastic_arm.dynamics import build_model
from elastic_arm.formatting import linear_unit
from elastic_arm.identification.base_parameters import BaseParameters
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.robot import Joint, Robot, robot_to_dict
from elastic_arm.robot.plausible import doubtful

GAINS = {"kp": "Nm/rad", "kd": "Nm s/rad", "ki": "Nm/(rad s)"}
_QUICK = 12  # joints whose base parameters are found before anybody wonders


@reports_errors
def describe(
    robot_file: options.RobotFile = None,
    model: options.Model = "mod3",
    base: Annotated[bool, typer.Option("--base", help="List the base parameters.")] = False,
    urdf: Annotated[Path | None, typer.Option(help="Write the arm as URDF to this file.")] = None,
    chain: options.Chain = None,
    at: options.At = None,
    json: options.Json = False,
    force: Force = False,
) -> None:
    """Show an arm: joints, limits, masses, transmissions and identifiable parameters.

    Examples:

        elastic-arm describe --base

        elastic-arm describe --robot my_arm.urdf --json

        elastic-arm describe --robot arm_with_gripper.urdf --chain base_link:tool_link --urdf
        arm_alone.urdf
    """
    if urdf is not None:
        claim_file(urdf, force=force, option="--urdf")
    robot = options.load_arm(robot_file, chain, at)
    if robot.n > _QUICK:
        err.print(
            f"compiling the equations of {robot.n} joints and computing their base parameters,"
            " about a minute"
        )
    told = build_model(robot, model)
    parameters = base_of(told)
    if urdf is not None:
        # MuJoCo and lxml take a second to load.
        from elastic_arm.cli.mujoco.export import print_export
        from elastic_arm.mujoco import export_urdf

        written = export_urdf(robot, None, urdf)
    if json:
        print_json(_content(robot, model, len(told.parameters), parameters))
        return
    _print_robot(robot)
    # Without transmissions all models are the rigid links.
    of_model = f" of {model}" if robot.elastic else ""
    known = (
        f"motion determines {len(parameters)} combinations of the {len(told.parameters)}"
        f" parameters{of_model}"
    )
    out.print(f"\n{known}, the base parameters{':' if base else ' (--base lists them)'}")
    if base:
        for name, unit in zip(parameters.names, parameters.units, strict=True):
            out.print(f"  {escape(name)} [dim]{escape(f'[{unit}]')}[/]")
    if urdf is not None:
        print_export(written, new=True)


def base_of(model: Any) -> BaseParameters:
    """Return the base parameters of (10): both encoders and the motor torque."""
    channels = ("q", "theta", "tau_m") if model.robot.elastic else ("q", "tau_m")
    return BaseRegression(model, channels, joints=model.robot.joint_names).base


def _print_robot(robot: Robot) -> None:
    kind = "elastic" if robot.elastic else "rigid (no transmissions)"
    gravity = " ".join(f"{g:g}" for g in robot.gravity)
    joints = "1 joint" if robot.n == 1 else f"{robot.n} joints"
    out.print(
        f"[bold]{escape(robot.name)}[/]: {joints}, {kind}, {robot.mass:.4g} kg, gravity {gravity}"
        " m/s²"
    )
    slide = bool(robot.units.prismatic)
    mixed = slide and len(robot.units.prismatic) < robot.n
    units = [
        linear_unit(u) if slide and not mixed else u
        for u in ("rad", "rad/s", "Nm", "Nm/rad", "Nm s/rad")
    ]
    numbers = ["mass kg", f"range {units[0]}", units[1], units[2]]
    if robot.elastic:
        numbers += ["ratio", f"K {units[3]}", f"D {units[4].replace(' ', '')}", "bearing"]
    if spinning := any(joint.armature is not None for joint in robot.joints):
        numbers.append("armature kg" if slide and not mixed else "armature kg m²")
    table = new_table("joint", "link", *numbers, right=numbers)
    for joint in robot.joints:
        limits = joint.limits
        span = f"{_short(limits.position_min)} … {_short(limits.position_max)}"
        row = [joint.name, joint.link_name, f"{joint.link.mass:.4g}", span, _short(limits.velocity)]
        row.append(_short(limits.torque))
        if joint.transmission is not None:
            t = joint.transmission
            row += [
                f"{t.r_tot:g}",
                f"{t.stiffness:g}",
                f"{t.damping:g}",
                "yes" if t.bearing else "rigid",
            ]
        row += [_short(joint.armature)] if spinning else []
        table.add_row(*(escape(cell) for cell in row))
    out.print(table)
    if slide:
        those = f" ({', '.join(robot.units.prismatic)})" if mixed else ""
        out.print(
            f"prismatic joints{escape(those)} use m and N instead of rad and Nm", soft_wrap=True
        )
    for line in (*_stated(robot), *_controllers(robot)):
        out.print(escape(line), soft_wrap=True)
    for note in robot.notes:
        out.print(f"[cyan]note:[/] {escape(note)}", soft_wrap=True)
    for doubt in doubtful(robot):
        out.print(f"[yellow]warning:[/] {escape(doubt)}", soft_wrap=True)


def _stated(robot: Robot) -> list[str]:
    """Return the effects that the description states, a line for each kind."""
    found: dict[str, list[str]] = {}
    for entry in robot.effects:
        values = ", ".join(
            f"{value:.4g}"
            for value in entry["parameters"].values()
            if isinstance(value, float | int)
        )
        found.setdefault(entry["effect"], []).append(
            f"{entry.get('joint') or 'whole arm'} {values}".strip()
        )
    return [f"{effect}: {'; '.join(places)}" for effect, places in found.items()]


def _controllers(robot: Robot) -> list[str]:
    """Return the drives' controllers, a line for each."""
    found = []
    for joint in robot.joints:
        if (drive := joint.controller) is not None:
            gains = [
                f"{k} {getattr(drive, k):.4g} {joint.unit(u)}"
                for k, u in GAINS.items()
                if getattr(drive, k)
            ]
            limit = (
                [] if drive.torque is None else [f"at most {drive.torque:.4g} {joint.unit('Nm')}"]
            )
            late = [f"delay {1e3 * drive.delay:.4g} ms"] if drive.delay else []
            fed = [] if drive.feedforward == "none" else [f"feed-forward: {drive.feedforward}"]
            numbers = [*gains, *limit, *late, *fed, *_electrics(joint)]
            found.append(f"controller of {joint.name}: {drive.mode}, {', '.join(numbers)}")
    return found


def _electrics(joint: Joint) -> list[str]:
    """Return what a servo's motor and firmware have beside the gains."""
    drive = joint.controller
    if drive is None:
        return []
    found = []
    if drive.dead_band:
        found.append(f"dead band {drive.dead_band:.4g} {joint.unit('rad')}")
    if drive.stall is not None:
        found.append(f"stall torque {drive.stall:.4g} {joint.unit('Nm')} at full duty")
    if drive.supply is not None:
        found.append(f"supply {drive.supply:.4g} V")
    if drive.sag:
        found.append(f"sag of the supply {drive.sag:.4g} at full torque")
    if drive.firmware_gain is not None:
        found.append(f"gain register {drive.firmware_gain:g}")
    return found


def _content(robot: Robot, model: str, parameters: int, base: BaseParameters) -> dict[str, Any]:
    return {
        "robot": robot_to_dict(robot),
        "elastic": robot.elastic,
        "mass_kg": float(robot.mass),
        "notes": list(robot.notes),
        "doubts": doubtful(robot),
        "model": model,
        "parameters": parameters,
        "base_parameters": [
            {"name": name, "unit": unit} for name, unit in zip(base.names, base.units, strict=True)
        ],
    }


def _short(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.4g}"
