"""Arrays of robot learners' files: Parquet, as LeRobot's datasets are, and HDF5."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import MissingExtraError, RecordingError
from elastic_arm.recording import limits

KINDS = (".parquet", ".h5", ".hdf5")
_INSTALL = "Install it with: pip install 'elastic_arm[learning]'"


def load_columns(path: Path) -> dict[str, np.ndarray]:
    """Read the numbers of a Parquet or HDF5 file.

    A column of lists, such as LeRobot's `observation.state`, is one array with a column a joint. The datasets of an
    HDF5 file are called by their paths with dots, `observations.qpos`; pictures and texts are left out.
    """
    arrays = _parquet(path) if path.suffix.lower() == ".parquet" else dict(_hdf5(path))
    if not arrays:
        raise RecordingError(f"{path} holds no tables of numbers", "Give a file with joint states.")
    return arrays


def _parquet(path: Path) -> dict[str, np.ndarray]:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise MissingExtraError("Parquet files need pyarrow, which is not installed", _INSTALL) from error
    try:
        size = sum(
            pq.read_metadata(path).row_group(k).total_byte_size for k in range(pq.read_metadata(path).num_row_groups)
        )
        _refuse_large(path, size)
        table = pq.read_table(path)
        return {name: values for name in table.column_names if (values := _column(table.column(name))) is not None}
    except pa.ArrowException as error:
        raise ValueError(str(error)) from None


def _column(column: Any) -> np.ndarray | None:
    """Return a column of numbers (N,), or of lists of equal length (N, k); None for what is neither."""
    import pyarrow.types as types

    kind = column.type
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        rows = column.to_pylist()
        lengths = {len(row) for row in rows if row is not None}
        if len(lengths) != 1 or None in rows or not _is_number(kind.value_type):
            return None
        return np.array(rows, dtype=np.float64)
    return np.asarray(column.to_numpy()) if _is_number(kind) and not column.null_count else None


def _is_number(kind: Any) -> bool:
    import pyarrow.types as types

    return bool(types.is_integer(kind) or types.is_floating(kind))


def _hdf5(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("HDF5 files need h5py, which is not installed", _INSTALL) from error
    found: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.ndim in (1, 2):
            found.append((name, item))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        _refuse_large(path, sum(item.size * item.dtype.itemsize for _, item in found))
        for name, item in found:
            yield name.replace("/", "."), item[()]


def _refuse_large(path: Path, size: int) -> None:
    most = limits.unpacked_bytes()
    if size > most:
        raise RecordingError(f"{path} unpacks to {size} bytes, {most} are the limit", "Cut it into parts.")
