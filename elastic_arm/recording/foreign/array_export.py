"""A recording as arrays: .csv, .npz or .parquet, one row a sample of the common time base."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from elastic_arm.errors import MissingExtraError, OutputError, RecordingError
from elastic_arm.recording.recording import Recording

KINDS = (".csv", ".npz", ".parquet")
CHANNELS = ("q", "dq", "tau_J", "theta", "dtheta", "tau_m")


def export_arrays(recording: Recording, path: Path) -> list[str]:
    """Write the channels of a recording, and return the names of what was written.

    Columns are called `time` (s, from the first sample), then `q.joint`, `tau_m.joint` …; an .npz holds `time`,
    `joints` and one array (N, n) a channel. `bag import` reads them back.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise RecordingError(f"{path} is none of {', '.join(KINDS)}", "Give the file one of these endings.")
    samples = recording.samples()
    channels = {name: values for name in CHANNELS if (values := getattr(samples, name)) is not None}
    time = samples.t
    columns = {"time": time}
    for name, values in channels.items():
        columns |= {f"{name}.{joint}": values[:, i] for i, joint in enumerate(recording.joints)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind == ".npz":
            np.savez(path, time=time, joints=np.array(recording.joints), **channels)
            return ["time", "joints", *channels]
        if kind == ".csv":
            table = np.column_stack(list(columns.values()))
            np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
        else:
            _write_parquet(path, columns)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror}", "Name another file with --out.") from error
    return list(columns)


def _write_parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError(
            "Parquet files need pyarrow, which is not installed",
            "Install it with: pip install 'elastic_arm[learning]', or write .npz",
        ) from error
    pq.write_table(pa.table(columns), path)
