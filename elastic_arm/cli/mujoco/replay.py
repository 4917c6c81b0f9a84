"""`elastic-arm replay`: a recording replayed in MuJoCo, with the errors of each model."""

import os
from json import dumps as json_text
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors
from elastic_arm.cli.mujoco.corrected import Correction
from elastic_arm.cli.outputs import Force, claim_folder
from elastic_arm.errors import RobotError
from elastic_arm.mujoco import Replay, replay
from elastic_arm.mujoco.replaying import WINDOW, labels
from elastic_arm.output_files import write_result
from elastic_arm.recording import Recording
from elastic_arm.robot.loading import is_mjcf, parse_chain
from elastic_arm.robot.mjcf import MjcfArm, open_mjcf

RESULTS = ("replay.json", "report.html")


@reports_errors
def replay_command(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="Recording with positions and motor torques.")
    ],
    robots: Annotated[
        list[Path], typer.Option("--robot", help="MJCF; may be repeated.", show_default=False)
    ],
    window: Annotated[
        float, typer.Option(help="Length of a window, s; each starts from the recorded state.")
    ] = WINDOW,
    chain: options.Chain = None,
    at: options.At = None,
    channels: options.Channels = None,
    clock: options.Clock = options.ClockChoice.auto,
    out_dir: options.OutFolder = Path("replay"),
    json: options.Json = False,
    force: Force = False,
) -> None:
    """Replay a recording in MuJoCo, and measure the error of each model.

    Open loop: the recorded motor torque drives the arm, which is reset to the
    recorded state after every window. Torque: compared with the inverse dynamics
    of the recorded motion in MuJoCo. Closed loop, if the model has servos and the
    recording has a reference: the servos follow the reference.

    Examples:

        elastic-arm replay run_3 --robot arm.xml --robot diagnosis/arm_corrected.xml

        elastic-arm replay run_3 --robot arm.xml --window 2
    """
    claim_folder(out_dir, RESULTS, force=force)
    arms = {path: open_arm(path, chain, at) for path in robots}
    mapping = options.channel_map(channels)
    found = []
    for path, arm in arms.items():
        recording = options.read_by_clock(bag, mapping, arm.robot, clock)
        with err.status(f"replaying in {escape(path.name)}"):
            found.append(replay(recording, arm, window=window, name=str(path)))
    write_replays(found, str(bag), out_dir)
    if json:
        print_json({"bag": str(bag), "replays": [one.to_dict() for one in found]})
    else:
        print_replays(found)
        out.print(f"written: {escape(str(out_dir))}/{', '.join(RESULTS)}")


def open_arm(path: Path, chain: str | None, at: str | None) -> MjcfArm:
    """Open the arm of an MJCF."""
    if not os.path.exists(path):
        remedy = "Give the path of an MJCF file; `diagnose` prints the name of the one it writes."
        raise RobotError(f"{path}: no such file", remedy)
    if os.path.isfile(path) and not is_mjcf(path):
        raise RobotError(
            f"{path} is not an MJCF", "Write one with elastic-arm export ROBOT --to mjcf --out FILE"
        )
    return open_mjcf(path, None if chain is None else parse_chain(chain), at)


def replay_both(correction: Correction, folder: Path, recording: Recording) -> list[Replay]:
    """Replay a recording in the original and the corrected model; write replay.json."""
    assert correction.base is not None  # Correction.require_mjcf has seen to it
    after = correction.path(folder)
    files = [correction.base, *([after] if after is not None and after.exists() else [])]
    found = [replay(recording, correction.open(path), name=str(path)) for path in files]
    save_replays(found, recording.source, folder)
    return found


def write_replays(found: list[Replay], source: str, folder: Path) -> None:
    """Write replay.json and report.html."""
    # Matplotlib is slow to import, and only reports need it.
    from elastic_arm.report.html import write_report
    from elastic_arm.report.replay import sections

    save_replays(found, source, folder)
    write_report(folder / RESULTS[1], "Replay in MuJoCo", sections(found), subtitle=source)


def save_replays(found: list[Replay], source: str, folder: Path) -> None:
    """Write replay.json."""
    text = json_text(
        {"bag": source, "replays": [one.to_dict() for one in found]}, indent=2, allow_nan=False
    )
    write_result(folder / RESULTS[0], f"{text}\n")


def print_replays(found: list[Replay]) -> None:
    """Print the errors of all models side by side, joint by joint."""
    if not found:
        return
    units = found[0].units
    for title, rows in (
        (f"position, {units.over('mrad')}", [1e3 * one.open_loop.position for one in found]),
        (f"velocity, {units.over('mrad/s')}", [1e3 * one.open_loop.velocity for one in found]),
        (f"torque, {units.over('Nm')}", [one.open_loop.torque for one in found]),
        ("correlation of torques", [one.open_loop.correlation for one in found]),
        ("lag of torque, ms", [1e3 * one.open_loop.lag for one in found]),
        (
            f"servo position, {units.over('mrad')}",
            [np.nan if one.closed_loop is None else 1e3 * one.closed_loop for one in found],
        ),
    ):
        values = [
            np.broadcast_to(np.asarray(row, dtype=float), len(found[0].joints)) for row in rows
        ]
        if not np.isfinite(values).any():
            continue
        table = new_table(title, *found[0].joints, right=found[0].joints)
        for name, row in zip(labels(found), values, strict=True):
            table.add_row(escape(name), *(f"{v:.4g}" if np.isfinite(v) else "–" for v in row))
        out.print(table)
    seconds = found[0].window
    out.print(
        f"root mean squares over {found[0].windows} windows of {seconds:g} s, driven by the"
        f" {found[0].torque} torque"
    )
