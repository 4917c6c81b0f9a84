"""A recording as arrays, .csv, .npz, .parquet or .h5, with the mapping that imports them again."""

import csv
import io
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import RecordingError, require_libraries
from elastic_arm.output_files import write_result, yaml_text
from elastic_arm.recording.foreign.channels import DEFAULT_UNIT
from elastic_arm.recording.foreign.compiled_readers import LIBRARIES
from elastic_arm.recording.recording import Recording

KINDS = (".csv", ".npz", ".parquet", ".h5")
_ONE_TABLE = (".csv", ".parquet")  # kinds of which a file is one table
Table = dict[str, np.ndarray]


def export_paths(path: Path, joined: bool = False) -> list[Path]:
    """Return the files or folder that an export to `path` may make; refuse a path of another
    kind."""
    if path.suffix.lower() not in KINDS:
        raise RecordingError(
            f"{path} does not have one of the extensions {', '.join(KINDS)}",
            "Give the file one of these extensions.",
        )
    return [path] if joined else [path, path.with_suffix(".yaml"), path.with_suffix(".urdf")]


def export_arrays(recording: Recording, path: Path, joined: bool = False) -> list[str]:
    """Write a recording as arrays, and return a line for each step.

    Each side is a table with its own stamps. An .npz or .h5 file contains all tables; for .csv and
    .parquet, several sides become a folder with one file each. With `joined`, all channels are on
    one time base; sides with different stamps are interpolated.
    """
    export_paths(path, joined)
    if (kind := path.suffix.lower()) in LIBRARIES:
        require_libraries(f"{kind} files need", LIBRARIES[kind])
    return _joined(recording, path) if joined else _sides(recording, path)


def _sides(recording: Recording, path: Path) -> list[str]:
    sides = {
        "command" if name == "reference" else name: side for name, side in recording.sides().items()
    }
    tables = {name: {"stamp_ns": side.stamp_ns, **side.channels()} for name, side in sides.items()}
    mapping: dict[str, Any] = {"times": {}, "joints": list(recording.joints)}
    # Blanks at the end of a line of names are none of a name.
    joints = [joint.rstrip() for joint in recording.joints]
    said = []
    of_joints = path.suffix.lower() in _ONE_TABLE
    in_folder = of_joints and len(tables) > 1
    for side, table in tables.items():
        file = path / f"{side}{path.suffix}" if in_folder else path
        prefix = f"{side}." if in_folder or not of_joints else ""
        times = {"key": f"{prefix}stamp_ns", "unit": "ns"}
        mapping["times"] = mapping["times"] or dict(times)
        mapping[side] = {"times": times}
        for name in list(table)[1:]:
            key = [f"{prefix}{name}.{j}" for j in joints] if of_joints else f"{prefix}{name}"
            # Stated, as a joint's name may end as a unit does.
            unit = {"full_scale": 1.0} if name == "pwm" else {"unit": DEFAULT_UNIT[name]}  # type: ignore[index]
            mapping[side][name] = {"key": key, **unit}
        if of_joints:
            _write(file, _columns(table, joints))
        said.append(
            f"{file}: {len(table['stamp_ns'])} samples of the {side} side, {', '.join(table)}"
        )
    if not of_joints:
        _write(
            path,
            {
                f"{side}.{name}": values
                for side, table in tables.items()
                for name, values in table.items()
            },
        )
    if recording.currents:
        mapping["from_currents"] = list(recording.currents)
    if recording.firmware_gains:
        mapping["firmware_gain"] = dict(recording.firmware_gains)
    if recording.robot_description is not None:
        urdf = path.with_suffix(".urdf")
        write_result(urdf, recording.robot_description)
        mapping["robot_description"] = urdf.name
        said.append(f"{urdf}: the robot description")
    file = path.with_suffix(".yaml")
    write_result(file, yaml_text(mapping))
    command = shlex.join(["elastic-arm", "bag", "import", str(path), "--map", str(file), "--out"])
    return [*said, f"{file}: the mapping; {command} BAG imports the bag again"]


def _joined(recording: Recording, path: Path) -> list[str]:
    samples = recording.samples()
    channels = samples.recorded()
    one_table = path.suffix.lower() in _ONE_TABLE
    _write(
        path,
        {"time": samples.t, **(_columns(channels, recording.joints) if one_table else channels)},
    )
    counts = " and ".join(
        f"{len(side)} of the {name} side" for name, side in recording.measured().items()
    )
    said = [
        f"{path}: {len(samples)} samples on one time base of {counts}: time, {', '.join(channels)}"
    ]
    left = "; without the commands" if recording.reference is not None else ""
    return [
        *said,
        *samples.notes,
        f"time in s since the first sample, at {samples.stamp_ns[0]} ns{left}",
    ]


def _columns(table: Mapping[str, np.ndarray], joints: Any) -> Table:
    """Return the columns of a table: one a joint for each channel."""
    columns: Table = {}
    for name, values in table.items():
        columns |= (
            {name: values}
            if values.ndim == 1
            else {f"{name}.{j}": values[:, k] for k, j in enumerate(joints)}
        )
    return columns


def _write(path: Path, arrays: Table) -> None:
    content = io.BytesIO()
    match path.suffix.lower():
        case ".npz":
            np.savez(content, **arrays)  # type: ignore[arg-type]
        case ".csv":
            names = io.StringIO()
            csv.writer(names, lineterminator="\n").writerow(arrays)
            content.write(names.getvalue().encode())
            formats = ["%d" if values.dtype.kind == "i" else "%.17g" for values in arrays.values()]
            np.savetxt(
                content, np.rec.fromarrays(list(arrays.values())), delimiter=",", fmt=formats
            )
        case ".parquet":
            import pyarrow as pa
            import pyarrow.parquet as pq

            pq.write_table(pa.table(arrays), content)
        case _:
            import h5py

            with h5py.File(content, "w") as file:
                for name, values in arrays.items():
                    file[name.replace(".", "/")] = values
    write_result(path, content.getvalue(), remedy="Choose another file with --out.")
