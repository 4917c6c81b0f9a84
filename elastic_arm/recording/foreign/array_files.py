"""Named arrays from files: .npz, .mat with nested structs, tables with or without names, folders of such files."""

from __future__ import annotations

import csv
import stat
import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from elastic_arm.errors import MissingExtraError, RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.foreign import columnar
from elastic_arm.recording.foreign.matlab import load_matlab

Arrays = dict[str, np.ndarray]

TABLES = (".csv", ".txt", ".dat")
# What numpy and csv raise for a file that is not what its name promises.
_UNREADABLE: tuple[type[Exception], ...] = (OSError, ValueError, TypeError, LookupError, EOFError, MemoryError)
_UNREADABLE += (
    AttributeError,
    NameError,
    SyntaxError,
    OverflowError,
    RuntimeError,
    AssertionError,
    struct.error,
    csv.Error,
)
_UNREADABLE += (zlib.error, zipfile.BadZipFile, tokenize.TokenError)
_ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what numpy writes
_ENCRYPTED = 1  # flag of an entry
_WHOLE_TABLE = ""


def load_arrays(path: Path) -> Arrays:
    """Read the arrays of a file, or of all files of a folder.

    Fields of a MATLAB struct are called `struct.field`; the columns of a table without a line of names by their
    numbers, from 0. In a folder a file's name without its ending stands before: `file.column`, and `file` alone for
    a whole table without names.

    Raises
    ------
    RecordingError
        If it cannot be read, naming the file.
    """
    if not path.is_dir():
        return {name: values for name, values in _load(path).items() if name != _WHOLE_TABLE}
    arrays: Arrays = {}
    for file in sorted(file for file in path.iterdir() if file.suffix.lower() in (*TABLES, ".npy", ".npz", ".mat")):
        found = _load(file)
        arrays |= {f"{file.stem}.{name}" if name != _WHOLE_TABLE else file.stem: v for name, v in found.items()}
    if not arrays:
        raise RecordingError(f"{path} holds no arrays", "Give a folder of .csv, .txt, .npy, .npz or .mat files.")
    return arrays


def _load(path: Path) -> Arrays:
    kind = path.suffix.lower()
    try:
        if kind in (*TABLES, *columnar.KINDS, ".npy", ".npz", ".mat"):
            _check_file(path)
        if kind in columnar.KINDS:
            return columnar.load_columns(path)
        if kind == ".npz":
            _check_zip(path)
            with np.load(path, allow_pickle=False) as content:
                arrays = dict(content)
            # Where the head of an entry is damaged, numpy returns its bytes.
            if strange := [name for name, values in arrays.items() if not isinstance(values, np.ndarray)]:
                raise ValueError(f"its entry {strange[0][:60]!r} is no array")
            return arrays
        if kind == ".npy":
            return {_WHOLE_TABLE: np.load(path, allow_pickle=False)}
        if kind == ".mat":
            return load_matlab(path)
        if kind in TABLES:
            return _load_table(path)
    except (RecordingError, MissingExtraError):
        raise
    except _UNREADABLE as error:
        reason = getattr(error, "strerror", None) or str(error)[:200] or type(error).__name__
        raise RecordingError(f"{path} cannot be read: {reason}", "Check the path and the format.") from None
    raise RecordingError(f"{path} is none of .npz, .csv, .mat, .parquet, .hdf5", "Convert it to one of them.")


def _check_file(path: Path) -> None:
    """Refuse what may not end, or does not fit into the memory."""
    status, most = path.stat(), limits.unpacked_bytes()
    if not stat.S_ISREG(status.st_mode):
        raise RecordingError(f"{path} is no file, but a pipe or a device", "Save it as a file first.")
    if status.st_size > most:
        raise RecordingError(f"{path} has {status.st_size} bytes, {most} are the limit", "Cut it into parts.")


def _check_zip(path: Path) -> None:
    """Refuse entries that numpy cannot read, or that claim more than fits into the memory."""
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
    if any(entry.flag_bits & _ENCRYPTED for entry in entries):
        raise RecordingError(f"{path} is encrypted", "Save it with numpy.savez.")
    if other := [entry.filename for entry in entries if entry.compress_type not in _ZIP_METHODS]:
        raise RecordingError(f"{path}: {other[0]!r} is packed in a way that numpy does not use", "Save it with numpy.")
    claimed, most = sum(entry.file_size for entry in entries), limits.unpacked_bytes()
    if claimed > most:
        raise RecordingError(f"{path} unpacks to {claimed} bytes, {most} are the limit", "Cut it into parts.")


def _load_table(path: Path) -> Arrays:
    with open(path, encoding="utf-8", newline="") as file:
        lines = [line for line in file.read().splitlines() if line.strip()]
    head = lines[0] if lines else ""
    delimiter = next((mark for mark in (",", ";", "\t") if mark in head), None)
    # Blanks may come several at a time, and stand behind the comment mark that numpy writes.
    words = head.lstrip("#").split() if delimiter is None else next(csv.reader([head], delimiter=delimiter))
    names = [name.strip().lstrip("#").strip() for name in words]
    nameless = all(_is_number(name) for name in names)
    rows = lines if nameless else lines[1:]
    if not rows:
        raise ValueError("there are no numbers below the first line")
    table = np.loadtxt(rows, delimiter=delimiter, ndmin=2)
    if nameless:
        return {str(column): table[:, column] for column in range(table.shape[1])} | {_WHOLE_TABLE: table}
    if table.shape[1] != len(names):
        raise ValueError(f"{len(names)} names in the first line, {table.shape[1]} columns of numbers")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"two columns are called {twice[:60]!r}")
    return {name: table[:, column] for column, name in enumerate(names)}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
