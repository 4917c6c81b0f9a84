"""`elastic-arm bag`: show, check, repair, import and export recordings."""

import os
import sys
from dataclasses import replace
from functools import partial
from json import dumps as json_text
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from elastic_arm.cli import options
from elastic_arm.cli.console import err, new_table, out, print_json, reports_errors, shares_of
from elastic_arm.cli.outputs import Force, claim_bag, claim_folder
from elastic_arm.errors import RecordingError, require_ros
from elastic_arm.output_files import write_result
from elastic_arm.recording import read_recording
from elastic_arm.recording.foreign.array_export import KINDS, export_arrays, export_paths
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.arrays import import_runs
from elastic_arm.recording.foreign.calibration import degrees_per_cent
from elastic_arm.recording.foreign.draft import Draft
from elastic_arm.recording.foreign.guess import guess_mapping
from elastic_arm.recording.inspection.info import BagInfo, bag_info
from elastic_arm.recording.inspection.magnitudes import hardly_usable
from elastic_arm.recording.inspection.repair import Repair, repair_bag
from elastic_arm.recording.inspection.report import Report
from elastic_arm.recording.storage.stream_writer import COMPRESSIONS, Compression
from elastic_arm.recording.writing import write_recording

bag_app = typer.Typer(
    name="bag", help="Inspect, check, repair, import and export recordings.", no_args_is_help=True
)

BagPath = Annotated[
    Path, typer.Argument(help="rosbag2 folder, .mcap or .db3 file.", show_default=False)
]

_COLOURS = {"error": "bold red", "warning": "yellow", "note": "cyan"}
# Findings that a repair does something about.
_MENDABLE = {"damaged", "missing_metadata", "count", "nan"}


@bag_app.command("info")
@reports_errors
def info(
    bag: BagPath,
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    json: options.Json = False,
) -> None:
    """Show topics, rates, joints and channels of a bag.

    Example: elastic-arm bag info bags/excitation
    """
    summary = bag_info(bag, options.channel_map(channels), namespace)
    if json:
        print_json(summary.to_json())
    else:
        _print_info(summary)


@bag_app.command("check")
@reports_errors
def check(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG…", help="Recordings, or folders of recordings.", show_default=False
        ),
    ],
    repair: Annotated[
        bool, typer.Option("--repair", help="Write a repaired copy next to the bag.")
    ] = False,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Folder for the copy; BAG_repaired by default.")
    ] = None,
    robot: Annotated[
        Path | None,
        typer.Option(
            help="Arm file, URDF or MJCF to check joint names, limits and gravity against."
        ),
    ] = None,
    chain: options.Chain = None,
    at: options.At = None,
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    json: options.Json = False,
) -> None:
    """List the faults of bags; with --repair, write a usable copy.

    Exit status: 0 without faults (with --repair: if the copy is usable), 1 with faults, 2 if a
    bag is unreadable.

    Example: elastic-arm bag check --repair runs/killed
    """
    paths = options.bags_in(bags)
    if out_folder is not None and len(paths) > 1:
        raise typer.BadParameter("applies only to a single bag", param_hint="--out")
    arm = None if robot is None else options.load_arm(robot, chain, at)
    mapped = options.channel_map(channels)
    # Its statistics take longer to load than the other commands take.
    from elastic_arm.recording.inspection.check import check_bag

    of_bag = partial(check_bag, channels=mapped, robot=arm, namespace=namespace)
    told = []
    status = 0
    for path in paths:
        try:
            with err.status(f"checking {escape(str(path))}") as shown:
                report = of_bag(path, report_share=shares_of(shown))
        except RecordingError as error:
            if len(paths) == 1:
                raise
            report = Report(str(path))
            report.add("error", "unreadable", str(error))
            status = 2
        # What no reader opens no repair does.
        wanted = repair and not report.ok and report.findings[0].code != "unreadable"
        mended = repair_bag(path, out_folder, mapped) if wanted else None
        after = None if mended is None else of_bag(mended.path)
        told.append({**report.to_json(), "repaired": _repaired(mended, after)})
        if not json:
            _print_report(report)
            if mended is not None and after is not None:
                _print_repair(mended)
                _print_report(after)
            elif _MENDABLE & {finding.code for finding in report.findings}:
                out.print(
                    f"`elastic-arm bag check --repair {escape(str(path))}` writes a copy of the"
                    " undamaged"
                    " parts",
                    soft_wrap=True,
                )
        # What was never recorded no copy can mend: gaps and the like are left to be judged.
        good = report.ok if after is None else after.usable
        status = max(status, 0 if good else 1)
    if json:
        print_json(told[0] if len(told) == 1 else {"bags": told})
    raise typer.Exit(status)


@bag_app.command("import")
@reports_errors
def import_(
    arrays: Annotated[
        Path,
        typer.Argument(
            help="Array file (.npz, .csv, .mat, .parquet or .h5), or a folder of them.",
            show_default=False,
        ),
    ],
    out_folder: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Bag to write, or folder of bags; with --guess, the mapping file.",
            show_default=False,
        ),
    ],
    mapping: Annotated[
        Path | None, typer.Option("--map", help="Mapping file (YAML).", show_default=False)
    ] = None,
    guess: Annotated[
        bool, typer.Option("--guess", help="Write a draft of the mapping for review.")
    ] = False,
    robot: Annotated[
        Path | None, typer.Option(help="Arm file or URDF with the joint names, for --guess.")
    ] = None,
    chain: options.Chain = None,
    at: options.At = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="LeRobot's calibration file: positions without a unit are per cent of its ranges.",
            show_default=False,
        ),
    ] = None,
    compression: Annotated[
        str, typer.Option(help=f"Compression of the chunks: {', '.join(COMPRESSIONS)}.")
    ] = "zstd",
    json: options.Json = False,
) -> None:
    """Convert arrays of a real robot to a bag.

    Examples:

        elastic-arm bag import run.mat --guess --robot arm.urdf --out import.yaml

        elastic-arm bag import run.mat --map import.yaml --out run
    """
    if guess:
        if mapping is not None or robot is None:
            raise typer.BadParameter("requires --robot and excludes --map", param_hint="--guess")
        arm = options.load_arm(robot, chain, at)
        stated = None
        if calibration is not None:
            degrees_per_cent(calibration, arm.joint_names)  # before a draft names it
            stated = os.path.relpath(calibration, out_folder.parent)
        draft = guess_mapping(
            load_arrays(arrays, None), arm.joint_names, arm.units.prismatic, stated
        )
        _write_draft(arrays, out_folder, draft)
        return
    if mapping is None:
        raise typer.BadParameter(
            "give a mapping file, or draft one with --guess", param_hint="--map"
        )
    chosen: Compression = next((name for name in COMPRESSIONS if name == compression), "zstd")
    if chosen != compression:
        raise typer.BadParameter(
            f"choose one of {', '.join(COMPRESSIONS)}", param_hint="--compression"
        )
    runs = import_runs(arrays, mapping, calibration)
    folders = {name: out_folder / name for name in runs}
    for folder in folders.values():
        claim_bag(folder)
    written = []
    for name, recording in runs.items():
        summary = bag_info(write_recording(folders[name], recording, chosen))
        written.append(
            replace(summary, notes=[*recording.notes, *summary.notes, *hardly_usable(recording)])
        )
        if not json:
            _print_info(written[-1])
    if json:
        print_json(
            written[0].to_json()
            if len(written) == 1
            else {"bags": [bag.to_json() for bag in written]}
        )


@bag_app.command("export")
@reports_errors
def export(
    bag: BagPath,
    file: Annotated[
        Path, typer.Option("--out", help=f"File: {', '.join(KINDS)}.", show_default=False)
    ],
    joined: Annotated[
        bool, typer.Option("--joined", help="Interpolate all channels to one time base.")
    ] = False,
    channels: options.Channels = None,
    namespace: options.Namespace = None,
    force: Force = False,
) -> None:
    """Write a bag as arrays, each side with its own stamps, and the mapping for importing them.

    Example: elastic-arm bag export bags/excitation --out excitation.parquet
    """
    claim_folder(file.parent, [path.name for path in export_paths(file, joined)], force=force)
    recording = read_recording(bag, options.channel_map(channels), namespace=namespace)
    for line in (*export_arrays(recording, file, joined), *recording.notes):
        out.print(escape(line), soft_wrap=True)


@bag_app.command("replay")
@reports_errors
def replay(
    bag: BagPath,
    rate: Annotated[float, typer.Option(min=0.01, help="Speed relative to the recording.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Restart at the end, until Ctrl-C.")] = False,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Wait for a subscriber before starting.")
    ] = True,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            autocompletion=options.topics, help="Topic to play, may be repeated; all by default."
        ),
    ] = None,
) -> None:
    """Publish a bag in the ROS 2 graph with /clock, like `ros2 run elastic_arm replayer`.

    Examples:

        elastic-arm bag replay bags/excitation --rate 2

        elastic-arm bag replay bags/excitation --topic /joint_states --topic /motor_states
    """
    require_ros("`bag replay` starts a node, which needs")
    try:
        str(bag).encode()
    except UnicodeEncodeError:
        raise RecordingError(
            f"the name {str(bag)!r} is not valid UTF-8, which ROS requires", "Rename the bag."
        ) from None
    # Quoted as YAML: a folder may be called 123, or `a: b`.
    given = {
        "bag": json_text(str(bag)),
        "rate": rate,
        "loop": str(loop).lower(),
        "wait": str(wait).lower(),
    }
    if topic:
        given["topics"] = json_text(topic)
    arguments = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
    # The process becomes the node: Ctrl-C and exit code are the node's own.
    os.execv(
        sys.executable,
        [sys.executable, "-m", "elastic_arm.nodes.entry", "replayer", "--ros-args", *arguments],
    )


def _repaired(mended: Repair | None, after: Report | None) -> dict[str, Any] | None:
    if mended is None or after is None:
        return None
    summary = {"path": str(mended.path), "kept": mended.kept, "dropped": mended.dropped}
    return {**summary, "after": after.to_json()}


def _write_draft(arrays: Path, file: Path, draft: Draft) -> None:
    """Write the draft of a mapping and print it, with what to do next."""
    if os.path.exists(file):
        raise RecordingError(f"{file} exists", "Give another --out, or move the file away.")
    write_result(file, draft.to_yaml(), remedy="Choose another --out.")
    out.print(escape(draft.to_yaml()), soft_wrap=True, highlight=False)
    if draft.missing:
        out.print(f"[yellow]fill in:[/] {', '.join(draft.missing)}", soft_wrap=True)
    out.print(
        f"Review and correct {escape(str(file))}, then run: elastic-arm bag import"
        f" {escape(str(arrays))} --map {escape(str(file))} --out BAG",
        soft_wrap=True,
    )


def _print_info(summary: BagInfo) -> None:
    size = sum(summary.files.values())
    files = f"{len(summary.files)} file{'s' if len(summary.files) != 1 else ''}"
    out.print(
        f"[bold]{escape(summary.path)}[/]  {files}, {_size(size)},"
        f" {', '.join(summary.compression) or 'no messages'}"
    )
    out.print(f"{summary.messages} messages in {summary.duration:.6g} s")
    table = new_table("topic", "type", "messages", "rate, Hz", right=("messages", "rate, Hz"))
    for topic in summary.topics:
        rate = "–" if topic.rate is None else f"{topic.rate:.6g}"
        table.add_row(escape(topic.name), escape(topic.type_name), str(topic.count), rate)
    out.print(table)
    if summary.joints:
        out.print(f"joints    {escape(', '.join(summary.joints))}", soft_wrap=True)
        out.print(f"channels  {', '.join(summary.channels)}", soft_wrap=True)
    for words in (*summary.damage, *summary.notes):
        out.print(f"[yellow]note[/]      {escape(words)}", soft_wrap=True)


def _print_report(report: Report) -> None:
    out.print(f"[bold]{escape(report.path)}[/]", soft_wrap=True)
    for finding in report.findings:
        colour = _COLOURS[finding.severity]
        out.print(f"  [{colour}]{finding.severity:8}[/] {escape(finding.message)}", soft_wrap=True)
    out.print("  [green]no faults found[/]" if report.ok else "  [red]faults found[/]")


def _print_repair(mended: Repair) -> None:
    out.print(f"copy with {mended.kept} messages; omitted or not repaired:", soft_wrap=True)
    for words in mended.dropped or ["nothing"]:
        out.print(f"  {escape(words)}", soft_wrap=True)


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.4g} {unit}"
        count /= 1000
    return f"{count:.4g} GB"
