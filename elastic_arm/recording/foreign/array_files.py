"""Read named arrays from files (.npz, .npy, .mat, text tables, Parquet, HDF5) and from folders of
such files."""

import csv
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from elastic_arm.errors import MissingExtraError, RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.foreign.compiled_readers import load_compiled
from elastic_arm.recording.foreign.lerobot import INFO, lerobot_columns
from elastic_arm.recording.foreign.text_layouts import has_layout
from elastic_arm.recording.foreign.text_tables import (
    WHOLE_TABLE,
    Arrays,
    laid_out,
    read_records,
    read_text_table,
)
from elastic_arm.recording.storage.bag import ARRAY_FILES, METADATA, RECORD_FILES, TEXT_TABLES

LEARNERS = (".parquet", ".h5", ".hdf5")
KINDS = (*ARRAY_FILES, *RECORD_FILES)
_PICKLED = (
    "is a pickled object; reading it could run any program",
    (
        "Convert it where it was created, or where you trust it:"
        " pandas.read_pickle('{0}').to_parquet('table.parquet')."
    ),
)
_ELSEWHERE = dict.fromkeys((".pkl", ".pickle", ".p", ".joblib"), _PICKLED)
_A_BAG = (
    "is a bag, which needs no import",
    (
        "Give it to `bag check`, `identify` or `diagnose`; with --channels FILE if its topics or"
        " units differ (docs/channel_maps.md)."
    ),
)
_ELSEWHERE |= dict.fromkeys((".mcap", ".db3"), _A_BAG)
_ELSEWHERE |= dict.fromkeys(
    (".feather", ".arrow"),
    (
        "is a Feather file",
        "Save it as Parquet: pandas.read_feather('{0}').to_parquet('t.parquet').",
    ),
)
_ELSEWHERE |= dict.fromkeys(
    (".xlsx", ".xls", ".ods"), ("is a spreadsheet", "Save its sheet as .csv.")
)
_ELSEWHERE |= dict.fromkeys(
    (".gz", ".bz2", ".xz", ".zst", ".zip", ".tar", ".7z"),
    ("is a packed file", "Unpack it, and give the file or folder in it."),
)
_ELSEWHERE |= dict.fromkeys(
    (".yaml", ".yml"),
    (
        "is YAML, as `ros2 topic echo` prints messages",
        "Record them instead: `ros2 bag record TOPIC`; bags need no import.",
    ),
)
_ELSEWHERE[".tdms"] = (
    "is a TDMS file of LabVIEW",
    "Save it as .csv: nptdms.TdmsFile.read('{0}').as_dataframe().to_csv('table.csv').",
)
FILE_INDEX = (  # array that numbers the files of a folder whose files hold the same arrays
    "file_index"
)
# What numpy, csv and the libraries of the formats raise for a file that is not what its name
# promises.
_UNREADABLE: tuple[type[Exception], ...] = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NameError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    csv.Error,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def load_arrays(path: Path, decimal: str | None = ".") -> Arrays:
    """Read the arrays of a file, or of all files of a folder; docs/channel_maps.md lists their
    names.

    `decimal` is the decimal mark of text tables; None to detect it. Columns that are not numeric
    are returned as texts. Files of a dataset, which are numbered and contain the same arrays, are
    concatenated, and `file_index` numbers them.
    """
    # Path.is_dir raises for names that are too long.
    if not os.path.isdir(path):
        (found,) = _load([path], decimal)
        found.pop(WHOLE_TABLE, None)
        return found
    files, learned = _files_of(path)
    parts: dict[Path, Arrays] = {}
    groups = [[file] for file in files]
    if learned:
        groups.append(learned)
    for group in groups:
        parts |= zip(group, _load(group, decimal), strict=True)
        _refuse_large(path, sum(part.nbytes for part in parts.values()))
    if files:
        return _side_by_side(path, parts)
    episodes = [_rows(part) for part in parts.values()]
    alike = len(set(map(_numeric_shapes, episodes))) == 1
    numbered = all(file.stem[-1:].isdecimal() for file in learned)
    if len(learned) > 1 and not (alike and numbered):
        return _side_by_side(path, parts)
    stacked = _stacked(episodes)
    stacked.columns = lerobot_columns(path)
    return stacked


def _files_of(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files of arrays in a folder, and those of a dataset in it and below."""
    try:
        files = [
            file
            for file in sorted(folder.iterdir())
            if file.suffix.lower() in ARRAY_FILES and file.suffix.lower() not in LEARNERS
        ]
        is_lerobot = (folder / INFO).is_file()
        root = folder / "data" if is_lerobot else folder
        below = [file for depth in ("*", "*/*", "*/*/*") for file in root.glob(depth)]
        learned = [file for file in below if file.suffix.lower() in LEARNERS and file.is_file()]
    except OSError as error:
        raise RecordingError(
            f"{folder} cannot be read: {error.strerror}", "Check its permissions."
        ) from None
    if files or learned:
        return files, sorted(learned, key=_number)
    if (folder / METADATA).is_file():
        raise RecordingError(f"{folder} {_A_BAG[0]}", _A_BAG[1])
    raise RecordingError(
        f"{folder} contains no arrays", f"Give a folder of files {', '.join(KINDS)}."
    )


def _numeric_shapes(part: Arrays) -> tuple[Any, ...]:
    """Return names and shapes of the numeric arrays of a file.

    Texts do not count: a text that is missing in some files is left out.
    """
    return tuple(
        (name, values.shape[1:]) for name, values in part.items() if values.dtype.kind != "U"
    )


def _number(file: Path) -> list[tuple[int, str]]:
    """Order `episode_2` before `episode_10`."""
    return [
        (int(word), "") if word.isdecimal() else (-1, word)
        for word in re.split(r"(\d{1,18})", str(file))
    ]


def _rows(part: Arrays) -> Arrays:
    """Return the arrays of a file with one row per sample (the most frequent length), and its
    texts, which describe content that was not read."""
    texts = {name: values for name, values in part.items() if values.dtype.kind == "U"}
    lengths = Counter(len(values) for name, values in part.items() if name not in texts)
    count = max(lengths, key=lambda length: lengths[length], default=0)
    return Arrays(
        {name: values for name, values in part.items() if len(values) == count or name in texts}
    )


def _stacked(parts: Sequence[Arrays]) -> Arrays:
    """Return the arrays that all files contain, concatenated."""
    common = set.intersection(*map(set, parts))
    arrays = Arrays()
    for name in parts[0]:
        if name in common:
            arrays[name] = np.concatenate([part[name] for part in parts])
    if len(parts) > 1:
        counts = [len(next(iter(part.values()))) for part in parts]
        arrays.setdefault(FILE_INDEX, np.repeat(np.arange(len(parts)), counts))
    return arrays


def _side_by_side(path: Path, parts: Mapping[Path, Arrays]) -> Arrays:
    arrays = Arrays()
    for file, part in parts.items():
        # The one column of a file of one number a line is the file.
        only = WHOLE_TABLE in part and len(part) == 2
        names = {
            name: f"{file.stem}.{name}" if name else file.stem
            for name in part
            if not (only and name)
        }
        found = Arrays({called: part[name] for name, called in names.items()})
        if twice := sorted(arrays.keys() & found.keys()):
            raise RecordingError(
                f"{path}: two files contain an array {twice[0][:60]!r}", "Rename one of the files."
            )
        arrays.update(found)
        arrays.units |= {f"{file.stem}.{name}": unit for name, unit in part.units.items()}
        arrays.faults |= {f"{file.stem}.{name}": fault for name, fault in part.faults.items()}
        arrays.decimal = "," if part.decimal == "," else arrays.decimal
    return arrays


def _load(paths: Sequence[Path], decimal: str | None) -> list[Arrays]:
    """Read one file, or several files of formats that compiled libraries read."""
    path = paths[0]
    kind = paths[0].suffix.lower()
    if kind in _ELSEWHERE:
        raise RecordingError(f"{path} {_ELSEWHERE[kind][0]}", _ELSEWHERE[kind][1].format(path))
    if kind not in KINDS:
        raise RecordingError(
            f"{path} does not have one of the extensions {', '.join(KINDS)}",
            "Convert it to one of these formats; if it is a table as text, rename it to .csv.",
        )
    try:
        for file in paths:
            if not stat.S_ISREG(file.stat().st_mode):
                raise RecordingError(
                    f"{file} is a pipe or a device, not a file", "Save its content as a file first."
                )
        _refuse_large(path, sum(file.stat().st_size for file in paths))
        if kind in TEXT_TABLES:
            return [read_text_table(path, decimal)]
        if kind in RECORD_FILES:
            return [read_records(path)]
        if kind == ".npz":
            return [_npz(path)]
        if kind == ".npy":
            return [_plain(path, {WHOLE_TABLE: np.load(path, allow_pickle=False)})]
        found = load_compiled(paths, limits.unpacked_bytes())
        if empty := [file for file, arrays in zip(paths, found, strict=True) if not arrays]:
            raise RecordingError(
                f"{empty[0]} contains no tables of numbers", "Give a file with joint states."
            )
        return [_plain(file, arrays) for file, arrays in zip(paths, found, strict=True)]
    except (RecordingError, MissingExtraError):
        raise
    except _UNREADABLE as error:
        if kind in (".npy", ".npz") and "pickle" in str(error):
            raise RecordingError(
                f"{path} cannot be read: it holds pickled objects, which could run any program",
                "Save arrays of numbers: numpy.savez('table.npz', time=…, position=…).",
            ) from None
        reason = (
            getattr(error, "strerror", None)
            or " ".join(str(error).split())[:200]
            or type(error).__name__
        )
        raise RecordingError(
            f"{path} cannot be read: {reason}", "Check the path and the format."
        ) from None


def _refuse_large(path: Path, size: int) -> None:
    """Refuse data larger than the limit."""
    if size > (most := limits.unpacked_bytes()):
        raise RecordingError(
            f"{path} unpacks to {size} bytes; the limit is {most}", "Split it into parts."
        )


def _npz(path: Path) -> Arrays:
    if not zipfile.is_zipfile(path):
        raise ValueError("it is not an .npz file, or is truncated")
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
    counts = Counter(entry.filename.removesuffix(".npy") for entry in entries)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"it contains two arrays called {twice[0][:60]!r}")
    _refuse_large(path, sum(entry.file_size for entry in entries))
    with np.load(path, allow_pickle=False) as content:
        arrays = dict(content)
    # Where the head of an entry is damaged, numpy returns its bytes.
    if strange := [name for name, values in arrays.items() if not isinstance(values, np.ndarray)]:
        raise ValueError(f"its entry {strange[0][:60]!r} is not an array")
    return _plain(path, arrays)


def _plain(path: Path, arrays: Mapping[str, np.ndarray]) -> Arrays:
    """Return arrays of numbers and texts: records by their fields, dates as ns, and tables with
    texts, stamps in two columns or one row per joint converted as those of text files."""
    found = Arrays()
    for name, values in arrays.items():
        found.update(_fields(name, values))
    lengths = {len(v) for v in found.values() if v.ndim == 1 and v.size > 1}
    rows = {name: v for name, v in found.items() if v.ndim and len(v) in lengths}
    table = Arrays(
        {n: v for n, v in rows.items() if v.ndim == 1 or (v.ndim == 2 and v.dtype.kind in "biuf")}
    )
    if not has_layout(table):
        return found
    arrays = laid_out(path, table)
    arrays.update({name: v for name, v in found.items() if name not in table})
    return arrays


def _fields(name: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield an array, or the fields of an array of records."""
    if values.dtype.names is not None:
        for field in values.dtype.names:
            yield from _fields(f"{name}.{field}" if name else field, values[field])
    elif values.dtype.kind in "mM":
        kind = "datetime64[ns]" if values.dtype.kind == "M" else "timedelta64[ns]"
        yield name, values.astype(kind).astype(np.int64)
    elif values.dtype.kind == "S":
        yield name, np.char.decode(values, "utf-8", "replace")
    else:
        yield name, values
