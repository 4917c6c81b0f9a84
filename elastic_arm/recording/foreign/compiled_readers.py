"""MATLAB, Parquet and HDF5 files, read by ``python -m …compiled_readers BYTES SECONDS FILE…``, a
process with bounds.

The libraries that read these formats are compiled code, which may end its process on a damaged
file, and believe the sizes that a file claims. Here that costs no more than this process, whose
memory (bytes beside what Python itself takes) and processor time are limited. The arrays go to
standard output as an .npz file; why a file is refused goes to standard error, as problem and
remedy.
"""

import importlib
import io
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import ElasticArmError, RecordingError, require_libraries

# Processor time: to start, and for each byte of the file (packed files of 10 MB take a second).
START_SECONDS = 20
BYTES_A_SECOND = 1_000_000
# time on the clock for a second of the processor: a busy machine gives a process a tenth of a core
PATIENCE = 10
REFUSED = 3  # exit code where the reason stands on standard error
MODULE = "elastic_arm.recording.foreign.compiled_readers"
LIBRARIES = {".mat": "scipy", ".parquet": "pyarrow", ".h5": "h5py", ".hdf5": "h5py"}
_FILE = "file "  # begin of a line on standard error


def load_compiled(paths: Sequence[Path], most: int) -> list[dict[str, np.ndarray]]:
    """Read the arrays of files that unpack to at most `most` bytes together.

    Fields of a MATLAB struct are named `struct.field`, datasets of HDF5 by their paths with dots. A
    Parquet column of lists of equal length, such as LeRobot's `observation.state`, is one array.
    Images and texts of MATLAB are omitted.
    """
    kinds = sorted({path.suffix.lower() for path in paths})
    require_libraries(f"{' and '.join(kinds)} files need", *_libraries(paths))
    seconds = START_SECONDS + sum(path.stat().st_size for path in paths) // BYTES_A_SECOND
    # As here, and without the folder that the user stands in, which may hold modules of any name.
    command = [
        sys.executable,
        "-P",
        "-m",
        MODULE,
        str(most),
        str(seconds),
        *(str(path.absolute()) for path in paths),
    ]
    known = [folder or os.getcwd() for folder in sys.path]
    where = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1") | {
        "PYTHONPATH": os.pathsep.join(known)
    }
    try:
        run = subprocess.run(
            command, capture_output=True, timeout=PATIENCE * seconds, env=os.environ | where
        )
    except subprocess.TimeoutExpired:
        raise RecordingError(
            f"{paths[0]} takes longer than {PATIENCE * seconds} s to read", "Save it as .npz."
        ) from None
    if run.returncode != 0:
        # Every file is announced by a line with its number.
        said = run.stderr.decode("utf-8", "replace").strip().splitlines()
        path = paths[
            max((int(line[len(_FILE) :]) for line in said if line.startswith(_FILE)), default=0)
        ]
        if run.returncode == REFUSED:
            raise RecordingError(f"{path}{said[-2]}", said[-1])
        reason = " ".join(said[-1:])[:200] or "it is damaged"
        if run.returncode < 0:
            reason = (
                f"its reader ends with {signal.Signals(-run.returncode).name}: it is damaged,"
                " or reading takes too long"
            )
        raise RecordingError(f"{path} cannot be read: {reason}", "Check the path and the format.")
    found: list[dict[str, np.ndarray]] = [{} for _ in paths]
    with np.load(io.BytesIO(run.stdout), allow_pickle=False) as content:
        for k, (file, name) in enumerate(
            zip(content["files"].tolist(), content["names"].tolist(), strict=True)
        ):
            found[file][name] = content[f"array_{k}"]
    return found


def _matlab(path: str, most: int) -> Iterator[tuple[str, np.ndarray]]:
    import scipy.io

    try:
        content = scipy.io.loadmat(path)
    except NotImplementedError:
        # Version 7.3 is HDF5; the contents of cells, and texts, lie under #refs#.
        for name, values in _hdf5(path, most):
            if not name.startswith("#"):
                yield name, values
        yield from _cells_of_hdf5(path, most)
        return
    for name in content:
        yield from _fields(name, content[name])


def _fields(name: object, values: object) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of a MATLAB variable: those of a struct's fields, or itself."""
    # What MATLAB keeps for itself has no name, or one with two underscores in front.
    if not isinstance(name, str) or name.startswith("__") or not isinstance(values, np.ndarray):
        return
    if values.dtype.names is None:
        yield name, _of_cells(values) if values.dtype.hasobject else values
    elif values.size == 1:
        for field in values.dtype.names:
            yield from _fields(f"{name}.{field}", values[field].item())
    else:
        for field in values.dtype.names:
            yield f"{name}.{field}", _of_cells(values[field])


def _of_cells(cells: np.ndarray) -> np.ndarray:
    """Return cells, or a field of several structs, as a table with one column per cell.

    Cells that are not numeric, or differ in size, cannot be sent as plain data and become texts.
    """
    parts = [np.asarray(cell) for cell in cells.ravel().tolist()]
    sizes = {part.size for part in parts}
    if len(sizes) != 1 or not all(part.dtype.kind in "biuf" for part in parts):
        return np.full(cells.shape, "cell")
    table = np.stack([part.ravel() for part in parts], axis=-1)
    return table.ravel() if table.shape[0] == 1 else table


def _parquet(path: str, most: int) -> Iterator[tuple[str, np.ndarray]]:
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        # A few bytes may stand for any number of equal values, so that the file's own sizes do not
        # count.
        groups = (file.metadata.row_group(k) for k in range(file.metadata.num_row_groups))
        columns = (group.column(k) for group in groups for k in range(group.num_columns))
        _refuse_large(
            8 * sum(c.num_values for c in columns if c.physical_type != "BYTE_ARRAY"), most
        )
        leaves = [file.schema.column(k) for k in range(len(file.schema))]
        table = file.read(columns=[leaf.path for leaf in leaves if _is_read(leaf)])
    for name in table.column_names:
        for leaf_name, column in _leaves(name, table.column(name)):
            yield leaf_name, _column(column, most)


def _is_read(leaf: Any) -> bool:
    """Return whether the innermost part of a column contains numbers, times or texts instead of
    bytes, such as those of images."""
    of_bytes = leaf.physical_type in ("BYTE_ARRAY", "FIXED_LEN_BYTE_ARRAY")
    return not of_bytes or leaf.logical_type.type in ("STRING", "DECIMAL", "FLOAT16")


def _leaves(name: str, column: Any) -> Iterator[tuple[str, Any]]:
    """Yield a column, or the columns of its structs with dotted names; lists of structs become one
    list per field."""
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import types

    kind = column.type
    if types.is_struct(kind):
        for field in kind:
            yield from _leaves(f"{name}.{field.name}", pc.struct_field(column, field.name))
    elif (types.is_list(kind) or types.is_large_list(kind)) and types.is_struct(kind.value_type):
        for field in kind.value_type:
            chunks = [
                type(lists).from_arrays(lists.offsets, pc.struct_field(lists.values, field.name))
                for lists in column.chunks
            ]
            yield from _leaves(f"{name}.{field.name}", pa.chunked_array(chunks))
    elif types.is_dictionary(kind):
        yield name, column.cast(kind.value_type)
    else:
        yield name, column


def _column(column: Any, most: int) -> np.ndarray:
    """Return a column as (N,), or as (N, k) for lists of k numbers; other lists as JSON, dates and
    times as ns, and any other content as a text that names its type."""
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import types

    kind = column.type
    if types.is_timestamp(kind):
        return column.cast(pa.timestamp("ns")).cast(pa.int64()).to_numpy()
    if types.is_duration(kind):
        return column.cast(pa.duration("ns")).cast(pa.int64()).to_numpy()
    if types.is_time(kind):
        return column.cast(pa.time64("ns")).cast(pa.int64()).to_numpy()
    if types.is_decimal(kind):
        return column.cast(pa.float64()).to_numpy()
    if types.is_string(kind) or types.is_large_string(kind):
        return _texts(pc.fill_null(column, "").to_pylist(), most)
    if types.is_date(kind):
        return _texts(column.cast(pa.string()).to_pylist(), most)
    if not types.is_nested(kind):
        values = np.asarray(column.to_numpy())
        return values if values.dtype.kind in "biuf" else np.full(len(values), str(kind))
    of = kind.value_type
    lengths = {n for n in pc.unique(pc.list_value_length(column)).to_pylist() if n is not None}
    if _is_number(of) and len(lengths) == 1:
        values = np.full((len(column), lengths.pop()), np.nan)
        values[column.is_valid().to_numpy()] = (
            pc.list_flatten(column).to_numpy().reshape(-1, values.shape[1])
        )
        return values
    if _is_number(of) or types.is_string(of) or types.is_large_string(of):
        return _texts([json.dumps(cell) for cell in column.to_pylist()], most)
    return np.full(len(column), f"lists of {of}"[:60])


def _texts(texts: Sequence[str], most: int) -> np.ndarray:
    """Return texts as an array, whose items all take as many bytes as the longest."""
    longest = max(map(len, texts), default=0)
    if 4 * longest * len(texts) > most // 8:
        return np.full(len(texts), f"texts of up to {longest} characters")
    return np.array(texts, dtype=np.str_)


def _is_number(kind: Any) -> bool:
    from pyarrow import types

    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind))


def _hdf5(path: str, most: int) -> Iterator[tuple[str, np.ndarray]]:
    import h5py

    links: list[tuple[str, Any]] = []
    found: list[tuple[str, Any]] = []
    with h5py.File(path, "r") as file:
        file.visititems_links(lambda name, link: links.append((name, link)))
        for name, link in links:
            item = file[name] if isinstance(link, h5py.HardLink) else None
            if not isinstance(item, h5py.Dataset) or item.attrs.get("MATLAB_class", b"") == b"char":
                continue
            plain = item.dtype.kind in "biuf" and _width(item.shape) in (1, 2)
            if plain or (len(item.shape) == 1 and _is_rows(item.dtype)):
                if item.external or item.is_virtual:
                    problem = (
                        f": {name[:60]} is in other files, which could be any file on this machine"
                    )
                    raise RecordingError(
                        problem, "Copy the data into the file, for example with h5repack."
                    )
                found.append((name, item))
        _refuse_large(sum(item.size * item.dtype.itemsize for _, item in found), most)
        for name, item in found:
            if h5py.check_string_dtype(item.dtype):
                yield name.replace("/", "."), _texts(item.asstr(errors="replace")[()], most)
                continue
            # MATLAB gives every array two axes and more.
            values = item[()]
            yield (
                name.replace("/", "."),
                values.squeeze() if values.ndim > 2 or 1 in values.shape[1:] else values,
            )
    for name, link in links:  # what is not followed is a text, as what is no numbers
        if not isinstance(link, h5py.HardLink):
            where = (
                f"{link.path} of {link.filename}"
                if isinstance(link, h5py.ExternalLink)
                else link.path
            )
            yield name.replace("/", "."), np.array([f"a link to {where}, which is not followed"])


def _is_rows(kind: np.dtype[Any]) -> bool:
    """Return whether an array contains texts, or records of numbers."""
    import h5py

    is_text = h5py.check_string_dtype(kind) is not None
    return is_text or (kind.names is not None and not kind.hasobject)


def _cells_of_hdf5(path: str, most: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield MATLAB's cells of numbers, and fields of several structs, which are stored as
    references."""
    import h5py

    found: dict[str, Any] = {}
    with h5py.File(path, "r") as file:

        def keep(name: str, item: Any) -> None:
            of_references = isinstance(item, h5py.Dataset) and item.dtype == h5py.ref_dtype
            if of_references and not name.startswith("#"):
                found[name] = item

        file.visititems(keep)
        for name, item in found.items():
            parts = [file[reference] for reference in item[()].ravel() if reference]
            if not parts or not all(map(_is_plain, parts)):
                continue
            _refuse_large(sum(part.size * part.dtype.itemsize for part in parts), most)
            cells = np.empty(len(parts), object)
            for k, part in enumerate(parts):
                cells[k] = part[()]
            yield name.replace("/", "."), _of_cells(cells)


def _is_plain(item: Any) -> bool:
    """Return whether an object of an HDF5 file contains numbers stored in the file itself."""
    import h5py

    return (
        isinstance(item, h5py.Dataset)
        and item.attrs.get("MATLAB_class", b"") != b"char"
        and item.dtype.kind in "biuf"
        and not item.external
        and not item.is_virtual
    )


def _width(shape: tuple[int, ...]) -> int:
    """Return the number of axes of an array without those of length one; at least one."""
    return max(sum(length > 1 for length in shape), 1) if len(shape) > 2 else len(shape)


def _refuse_large(size: int, most: int) -> None:
    if size > most:
        raise RecordingError(
            f" unpacks to {size} bytes; the limit is {most}", "Split it into parts."
        )


def _libraries(paths: Sequence[Path]) -> list[str]:
    """Return the libraries that read the files; MATLAB's version 7.3 is HDF5."""
    needed = [LIBRARIES[path.suffix.lower()] for path in paths]
    for path in paths:
        with path.open("rb") as file:
            if file.read(10) == b"MATLAB 7.3":
                needed.append("h5py")
    return list(dict.fromkeys(needed))


def _main(most: int, seconds: int, paths: Sequence[Path]) -> int:
    """Read files within the bounds, and write an .npz file to standard output."""
    for library in _libraries(paths):
        importlib.import_module(library)
    own = (
        int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        * resource.getpagesize()
    )
    # 3 of the arrays in the process, packed ones included
    bounds = {
        resource.RLIMIT_AS: own + 3 * most,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_CORE: 0,
    }
    for limited, bound in bounds.items():
        _, allowed = resource.getrlimit(limited)  # a limit of the user's shell cannot be raised
        bound = bound if allowed == resource.RLIM_INFINITY else min(bound, allowed)
        resource.setrlimit(limited, (bound, bound))
    files: list[int] = []
    names: list[str] = []
    arrays: dict[str, np.ndarray] = {}
    try:
        for number, path in enumerate(paths):
            print(f"{_FILE}{number}", file=sys.stderr, flush=True)
            read = {".mat": _matlab, ".parquet": _parquet}.get(path.suffix.lower(), _hdf5)
            for name, values in read(str(path), most - sum(one.nbytes for one in arrays.values())):
                files.append(number)
                names.append(name)
                arrays[f"array_{len(arrays)}"] = values
    except ElasticArmError as error:
        print(f"{error.problem}\n{error.remedy}", file=sys.stderr)
        return REFUSED
    packed = io.BytesIO()
    np.savez(packed, files=np.array(files, int), names=np.array(names, dtype=np.str_), **arrays)  # type: ignore[arg-type]
    sys.stdout.buffer.write(packed.getbuffer())
    return 0


if __name__ == "__main__":
    sys.exit(_main(int(sys.argv[1]), int(sys.argv[2]), [Path(path) for path in sys.argv[3:]]))
