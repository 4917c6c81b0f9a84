"""Named arrays from files: .npz, .mat with nested structs, tables with or without names, folders of such files."""

from __future__ import annotations

import csv
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import IO

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
_NPY = b"\x93NUMPY"
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?$")


def load_arrays(path: Path) -> Arrays:
    """Read the arrays of a file, or of all files of a folder.

    Fields of a MATLAB struct are called `struct.field`; the columns of a table without a line of names by their
    numbers, from 0. In a folder a file's name without its ending stands before: `file.column`, and `file` alone for
    a whole table without names.
    """
    # Path.is_dir raises for names that are too long.
    if not os.path.isdir(path):
        return {name: values for name, values in _load(path).items() if name != _WHOLE_TABLE}
    try:
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in (*TABLES, ".npy", ".npz", ".mat"))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}", "Check its permissions.") from None
    arrays: Arrays = {}
    for file in files:
        found = _load(file)
        found = {f"{file.stem}.{name}" if name != _WHOLE_TABLE else file.stem: v for name, v in found.items()}
        if twice := sorted(arrays.keys() & found.keys()):
            raise RecordingError(f"{path}: two files hold an array {twice[0][:60]!r}", "Give files other names.")
        arrays |= found
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
            with zipfile.ZipFile(path) as archive:
                for entry in archive.namelist():
                    with archive.open(entry) as stream:
                        _refuse_objects(stream, path, entry.removesuffix(".npy"))
            with np.load(path, allow_pickle=False) as content:
                arrays = dict(content)
            # Where the head of an entry is damaged, numpy returns its bytes.
            if strange := [name for name, values in arrays.items() if not isinstance(values, np.ndarray)]:
                raise ValueError(f"its entry {strange[0][:60]!r} is no array")
            return arrays
        if kind == ".npy":
            with open(path, "rb") as file:
                _refuse_objects(file, path, "it")
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
    if not zipfile.is_zipfile(path):
        raise RecordingError(f"{path} cannot be read: it is no .npz file, or is cut off", "Save it with numpy.savez.")
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
    counts = Counter(entry.filename.removesuffix(".npy") for entry in entries)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise RecordingError(f"{path} holds two arrays called {twice[0][:60]!r}", "Save it with numpy.savez.")
    if any(entry.flag_bits & _ENCRYPTED for entry in entries):
        raise RecordingError(f"{path} is encrypted", "Save it with numpy.savez.")
    if other := [entry.filename for entry in entries if entry.compress_type not in _ZIP_METHODS]:
        raise RecordingError(f"{path}: {other[0]!r} is packed in a way that numpy does not use", "Save it with numpy.")
    claimed, most = sum(entry.file_size for entry in entries), limits.unpacked_bytes()
    if claimed > most:
        raise RecordingError(f"{path} unpacks to {claimed} bytes, {most} are the limit", "Cut it into parts.")


def _refuse_objects(stream: IO[bytes], path: Path, name: str) -> None:
    """Refuse an array of Python objects, such as lists of unequal length: reading one would run what it holds."""
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    start = stream.read(len(_NPY))
    if start != _NPY:
        if path.suffix.lower() == ".npy":
            raise RecordingError(f"{path} cannot be read: it is no .npy file", "Save it with numpy.save.")
        return
    version = tuple(stream.read(2))
    if version in readers and readers[version](stream)[2].hasobject:
        raise RecordingError(f"{path} cannot be read: {name} holds Python objects, no numbers", "Save numbers alone.")


def _load_table(path: Path) -> Arrays:
    # Excel begins a file with a mark that it is UTF-8.
    with open(path, encoding="utf-8-sig", newline="") as file:
        numbered = [(n, line) for n, line in enumerate(file.read().splitlines(), start=1) if line.strip()]
    if not numbered:
        raise RecordingError(f"{path} cannot be read: it is empty", "Give a file with a table of numbers.")
    head = numbered[0][1]
    delimiter = _delimiter([line for _, line in numbered[:2]])
    # Blanks may come several at a time, and stand behind the comment mark that numpy writes.
    words = head.lstrip("#").split() if delimiter is None else next(csv.reader([head], delimiter=delimiter))
    names = [name.strip().lstrip("#").strip() for name in words]
    nameless = all(_is_number(name) or _DECIMAL_COMMA.match(name) for name in names)
    rows = [(n, line) for n, line in numbered[0 if nameless else 1 :] if line.partition("#")[0].strip()]
    if not rows:
        raise ValueError("there are no numbers below the first line")
    try:
        table = np.loadtxt([line for _, line in rows], delimiter=delimiter, ndmin=2)
    except ValueError:
        _explain_row(path, rows, delimiter)
        raise
    if nameless:
        return {str(column): table[:, column] for column in range(table.shape[1])} | {_WHOLE_TABLE: table}
    if table.shape[1] != len(names):
        raise ValueError(f"{len(names)} names in the first line, {table.shape[1]} columns of numbers")
    if len(set(names)) < len(names):
        twice = Counter(names).most_common(1)[0][0]
        raise ValueError(f"two columns are called {twice[:60]!r}")
    return {name: table[:, column] for column, name in enumerate(names)}


def _delimiter(lines: Sequence[str]) -> str | None:
    """Return what parts the columns, by the first lines; None for blanks."""
    # Commas beside as many semicolons in every line are decimal ones, or parts of names.
    if lines[0].count(";") and len({line.count(";") for line in lines}) == 1:
        return ";"
    return next((mark for mark in (",", ";", "\t") if mark in lines[0]), None)


def _explain_row(path: Path, rows: Sequence[tuple[int, str]], delimiter: str | None) -> None:
    """Raise an error that names the first line of a table that cannot be read, and what to do about it."""
    width = 0
    read = ((number, content) for number, line in rows if (content := line.split("#")[0]).strip())
    for number, line in read:
        words = line.split(delimiter)
        width = width or len(words)
        wrong = next((word.strip() for word in words if not _is_number(word)), None)
        where = f"{path} cannot be read: line {number}"
        if wrong is not None and _DECIMAL_COMMA.match(wrong):
            raise RecordingError(f"{where}: {wrong!r} has a decimal comma", "Write numbers with decimal points.")
        if wrong is not None:
            what = f"{wrong[:60]!r} is no number" if wrong else "a number is missing"
            raise RecordingError(f"{where}: {what}", "Write nan where there is no number, and names in line 1 alone.")
        if len(words) != width:
            message = f"{where}: {len(words)} columns, where the lines before have {width}"
            raise RecordingError(message, "Give all lines as many columns; decimal marks are points.")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
