"""Named arrays from files: .npz, .npy, .mat, tables as text, Parquet and HDF5, and folders of such
files."""

import codecs
import csv
import itertools
import json
import os
import re
import stat
import struct
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np

from elastic_arm.errors import MissingExtraError, RecordingError
from elastic_arm.recording import limits
from elastic_arm.recording.foreign.compiled_readers import load_compiled
from elastic_arm.recording.foreign.text_layouts import arrays_of, has_layout, records
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
_WHOLE_TABLE = ""
_REMARK = "#%"  # begin of a line that is a comment, as numpy and MATLAB write it
_BLANK = ("", "na", "n/a", "#n/a", "null", "none", "-", "--")  # cells that hold no number
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?$")


class Arrays(dict[str, np.ndarray]):
    """Arrays by name, with what a table as text states beside its numbers."""

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray] = MappingProxyType({}),
        units: dict[str, str] | None = None,
    ) -> None:
        super().__init__(arrays)
        self.units = units or {}  # of columns, by a row of units
        # of columns that are no numbers: what is none, with its line where it is known
        self.faults: dict[str, str] = {}
        self.decimal = "."


def load_arrays(path: Path, decimal: str | None = ".") -> Arrays:
    """Read the arrays of a file, or of all files of a folder, as docs/channel_maps.md names them.

    `decimal` is the decimal mark of tables as text; None for the one that fits. Columns that are no
    numbers come as texts. Files of a dataset, which are numbered and all hold the same arrays, are
    read one below the other, and `file_index` numbers them.
    """
    # Path.is_dir raises for names that are too long.
    if not os.path.isdir(path):
        (found,) = _load([path], decimal)
        found.pop(_WHOLE_TABLE, None)
        return found
    try:
        # a dataset of LeRobot's
        root = path / "data" if (path / "meta" / "info.json").is_file() else path
        files = [
            file
            for file in sorted(path.iterdir())
            if file.suffix.lower() in set(ARRAY_FILES) - set(LEARNERS)
        ]
        below = [file for depth in ("*", "*/*", "*/*/*") for file in root.glob(depth)]
        learned = sorted(
            (f for f in below if f.suffix.lower() in LEARNERS and f.is_file()), key=_number
        )
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}", "Check its permissions."
        ) from None
    if not files and not learned and (path / METADATA).is_file():
        raise RecordingError(f"{path} {_A_BAG[0]}", _A_BAG[1])
    if not files and not learned:
        raise RecordingError(
            f"{path} contains no arrays", f"Give a folder of files {', '.join(KINDS)}."
        )
    parts: dict[Path, Arrays] = {}
    for some in [*([file] for file in files), *([learned] if learned else [])]:
        parts |= zip(some, _load(some, decimal), strict=True)
        _refuse_large(path, sum(array.nbytes for part in parts.values() for array in part.values()))
    if files:
        return _side_by_side(path, parts)
    rows = [_rows(part) for part in parts.values()]
    # Texts, which are left out where some are missing, keep no files apart.
    kinds = [{n: v.shape[1:] for n, v in part.items() if v.dtype.kind != "U"} for part in rows]
    alike = {tuple(one.items()) for one in kinds}
    numbered = len(alike) == 1 and all(file.stem[-1:].isdecimal() for file in learned)
    if not numbered and len(learned) > 1:
        return _side_by_side(path, parts)
    common = set.intersection(*(set(part) for part in rows))
    return _stacked([Arrays({n: v for n, v in part.items() if n in common}) for part in rows])


def _number(file: Path) -> list[tuple[int, str]]:
    """Order `episode_2` before `episode_10`."""
    return [
        (int(word), "") if word.isdecimal() else (-1, word)
        for word in re.split(r"(\d{1,18})", str(file))
    ]


def _rows(part: Arrays) -> Arrays:
    """Return the arrays of a file that have a row a sample, which most have, and texts, which say
    why they are none."""
    texts = {name: values for name, values in part.items() if values.dtype.kind == "U"}
    lengths = Counter(len(values) for name, values in part.items() if name not in texts)
    count = max(lengths, key=lambda length: lengths[length], default=0)
    return Arrays(
        {name: values for name, values in part.items() if len(values) == count or name in texts}
    )


def _stacked(parts: Sequence[Arrays]) -> Arrays:
    arrays = Arrays({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    if len(parts) > 1:
        counts = [len(next(iter(part.values()))) for part in parts]
        arrays.setdefault(FILE_INDEX, np.repeat(np.arange(len(parts)), counts))
    return arrays


def _side_by_side(path: Path, parts: Mapping[Path, Arrays]) -> Arrays:
    arrays = Arrays()
    for file, part in parts.items():
        # The one column of a file of one number a line is the file.
        only = _WHOLE_TABLE in part and len(part) == 2
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
    """Read one file, or several of formats that compiled libraries read."""
    path, kind = paths[0], paths[0].suffix.lower()
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
            return [_table(path, decimal)]
        if kind in RECORD_FILES:
            return [_json(path)]
        if kind == ".npz":
            return [_npz(path)]
        if kind == ".npy":
            return [_plain(path, {_WHOLE_TABLE: np.load(path, allow_pickle=False)})]
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
    """Refuse what does not fit into the memory."""
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


def _table(path: Path, decimal: str | None) -> Arrays:
    """Read a table as text: with or without a line of names, a row of units, columns of texts, and
    blank cells."""
    lines = _text(path).split("\n")
    numbered = [(n, line) for n, line in enumerate(lines, start=1) if line.strip()]
    if not numbered:
        raise RecordingError(
            f"{path} cannot be read: it is empty", "Give a file with a table of numbers."
        )
    numbered = numbered[_before_names([line for _, line in numbered]) :]
    delimiter = _delimiter([line for _, line in numbered[:2]], decimal)
    # Blanks may come several at a time, and stand behind the comment mark that numpy writes.
    head = numbered[0][1].lstrip(_REMARK)
    if delimiter is not None:
        numbered = _whole_rows(lines, numbered[0][0], delimiter)
        head = numbered[0][1].lstrip(_REMARK)
    names = [name.strip().lstrip(_REMARK).strip() for name in _cells(head, delimiter)]
    nameless = all(_is_number(name) or _DECIMAL_COMMA.match(name) for name in names)
    below = numbered if nameless else numbered[1:]
    rows = [(n, line) for n, line in below if line.partition("#")[0].strip()]
    if not rows:
        raise ValueError("there are no numbers below the first line")
    if nameless:
        names = [str(column) for column in range(len(names))]
    elif len(set(names)) < len(names):
        # A second line of names says which joint, as data frames with names of two levels have it.
        further = [cell.strip() for cell in _cells(rows.pop(0)[1], delimiter)]
        if len(further) == len(names) and not any(map(_is_number, further)):
            both = zip(names, further, strict=True)
            names = [f"{name}.{more}" if more else name for name, more in both]
        if len(set(names)) < len(names) or not rows:
            raise ValueError(f"two columns are called {Counter(names).most_common(1)[0][0][:60]!r}")
    units = [cell.strip() for cell in _cells(rows[0][1], delimiter)]
    stated = (
        len(rows) > 1
        and any(units)
        and not any(_is_number(cell.replace(",", ".")) for cell in units)
    )
    rows = rows[1:] if stated else rows
    with_commas = (row for row in rows if "," in row[1] and (delimiter != "," or '"' in row[1]))
    cells = ((n, cell) for n, line in with_commas for cell in _cells(line, delimiter))
    comma = next(((n, cell) for n, cell in cells if _DECIMAL_COMMA.match(cell.strip())), None)
    if comma is not None and decimal == ".":
        problem = (
            f"{path} cannot be read: line {comma[0]}: {comma[1].strip()!r} has a decimal comma"
        )
        raise RecordingError(
            problem, "Write decimal: ',' in the mapping, or numbers with decimal points."
        )
    plain = [
        line if comma is None or delimiter == "," else line.replace(",", ".") for _, line in rows
    ]
    try:
        table = np.loadtxt(plain, delimiter=delimiter, ndmin=2)
        arrays = Arrays(dict(zip(names, table.T, strict=True)))
        # Of nanoseconds since 1970 doubles lose the last ones.
        for k in np.flatnonzero(
            (np.abs(table) > 2**53).all(axis=0) & (np.abs(table) < 2**63).all(axis=0)
        ).tolist():
            arrays[names[k]] = np.loadtxt(
                plain, delimiter=delimiter, usecols=k, dtype=np.int64, ndmin=1
            )
    except ValueError:
        arrays = _by_cells(path, names, rows, delimiter, "." if comma is None else ",")
    units = [unit[1:-1] if re.fullmatch(r"\(.*\)|\[.*\]", unit) else unit for unit in units]
    arrays.units = {name: unit for name, unit in zip(names, units, strict=False) if stated and unit}
    if arrays.faults or has_layout(arrays):
        arrays = _laid_out(path, arrays)
    arrays.decimal = "." if comma is None else ","
    if nameless and not arrays.faults:
        arrays[_WHOLE_TABLE] = np.column_stack(list(arrays.values()))
    return arrays


def _before_names(lines: Sequence[str]) -> int:
    """Return how many lines there are before the line of names.

    Names stand in the first line that is no comment, or in the last of the comments before it, as
    numpy writes them. Lines before them may name the mark that parts the columns, as Excel writes
    it, or be a title, which holds no such mark.
    """
    if re.fullmatch(r"sep=.", lines[0].strip()):
        return 1
    remarks = sum(1 for _ in itertools.takewhile(lambda line: line.lstrip()[0] in _REMARK, lines))
    mark = _delimiter(lines[-2:], None)
    words = len(lines[-1].split())
    # Blanks part a table with decimal commas.
    titles = itertools.takewhile(
        lambda line: mark and mark not in line and len(line.split()) != words, lines[remarks:]
    )
    first = remarks + sum(1 for _ in titles)
    named = first < len(lines) and not any(map(_is_number, re.split(r"[;,\s]+", lines[first])))
    return first if named or first > remarks else max(remarks - 1, 0)


def _whole_rows(lines: Sequence[str], first: int, delimiter: str) -> list[tuple[int, str]]:
    """Return the rows from a line on, each with the number of its first line.

    A cell in quotes may go over several lines.
    """
    # The first line may be a header behind a comment mark.
    plain = itertools.chain([lines[first - 1]], map(_uncommented, lines[first:]))
    reader = csv.reader((f"{line}\n" for line in plain), delimiter=delimiter)
    rows = []
    begin = first - 1
    for cells in reader:
        end = first - 1 + reader.line_num
        if any(cell.strip() for cell in cells):
            rows.append((begin + 1, "\n".join(lines[begin:end])))
        begin = end
    return rows


def _uncommented(line: str) -> str:
    """Return a line without a comment, which begins at the first # that no quotes enclose."""
    for at, mark in enumerate(line):
        if mark == "#" and line[:at].count('"') % 2 == 0:
            return line[:at]
    return line


def _text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in what Excel and Windows write."""
    with path.open("rb") as file:
        wide = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            return path.read_text(encoding)
    raise ValueError("it is not text")


def _by_cells(
    path: Path,
    names: Sequence[str],
    rows: Sequence[tuple[int, str]],
    delimiter: str | None,
    decimal: str,
) -> Arrays:
    """Read a table with blank cells or texts."""
    parted = [(n, _cells(line.partition("#")[0], delimiter)) for n, line in rows]
    for n, cells in parted:
        if len(cells) == len(names) + 1 and not cells[-1].strip():
            cells.pop()  # a mark at the end of the line parts nothing
        if len(cells) != len(names):
            problem = (
                f"{path} cannot be read: line {n}: {len(cells)} columns, where the lines before"
                f" have {len(names)}"
            )
            raise RecordingError(
                problem, "Start with a header line, and give all lines the same number of columns."
            )
    arrays = Arrays()
    for k, name in enumerate(names):
        column = [cells[k].strip().replace(decimal, ".") for _, cells in parted]
        try:
            if name or any(column):
                arrays[name] = np.array(
                    [np.nan if cell.lower() in _BLANK else float(cell) for cell in column]
                )
        except ValueError:
            arrays[name] = np.array(column)
            wrong = next(
                i
                for i, cell in enumerate(column)
                if not (cell.lower() in _BLANK or _is_number(cell))
            )
            arrays.faults[name] = f"line {parted[wrong][0]}: {column[wrong][:60]!r} is not a number"
    return arrays


def _plain(path: Path, arrays: Mapping[str, np.ndarray]) -> Arrays:
    """Return arrays of numbers and texts: records by their fields, dates as ns, and tables with
    texts, stamps in two columns or a row a joint laid out as those of text files are."""
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
    laid_out = _laid_out(path, table)
    laid_out.update({name: v for name, v in found.items() if name not in table})
    return laid_out


def _fields(name: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield an array, or the fields of one of records."""
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


def _laid_out(path: Path, table: Arrays) -> Arrays:
    """Return a table whose texts are lists, names of a long table or dates as arrays; any other as
    it is."""
    try:
        found, units = arrays_of({name: values.tolist() for name, values in table.items()})
    except RecordingError as error:
        raise RecordingError(f"{path}: {error.problem}", error.remedy) from None
    stated = {name: unit for name, unit in table.units.items() if name in found}
    arrays = _with_faults(found, stated | units)
    for name in arrays.faults.keys() & table.faults.keys():
        if np.array_equal(arrays[name], table[name]):
            arrays.faults[name] = table.faults[name]  # with its line
    return arrays


def _json(path: Path) -> Arrays:
    """Read a list of records, an object of lists, or a record a line."""
    text = _text(path)
    try:
        content = json.loads(text)
    except RecursionError:
        raise ValueError("its nesting is too deep") from None
    except json.JSONDecodeError as error:
        lines = [line for line in text.splitlines() if line.strip()]
        if len(lines) < 2:
            raise ValueError(f"it is not valid JSON: {error}") from None
        content = []
        for n, line in enumerate(lines, start=1):
            try:
                content.append(json.loads(line))
            except (json.JSONDecodeError, RecursionError) as fault:
                if n == len(lines) and n > 2:  # a recorder that was killed
                    break
                raise ValueError(f"record {n} is not valid JSON: {fault}") from None
    return _with_faults(*arrays_of(records(content, str(path))))


def _with_faults(found: Mapping[str, np.ndarray], units: dict[str, str]) -> Arrays:
    arrays = Arrays(found, units)
    texts = {name: values for name, values in found.items() if values.dtype.kind == "U"}
    arrays.faults = {
        name: f"{str(values[0])[:60]!r} is not a number" for name, values in texts.items()
    }
    return arrays


def _cells(line: str, delimiter: str | None) -> list[str]:
    return line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter), [])


def _delimiter(lines: Sequence[str], decimal: str | None) -> str | None:
    """Return what parts the columns, by the first lines; None for blanks."""
    # Commas beside as many semicolons or tabs in every line are decimal ones, or parts of names.
    for mark in ";\t":
        if lines[0].count(mark) and len({line.count(mark) for line in lines}) == 1:
            return mark
    if decimal == "," and '"' not in lines[-1]:
        return None
    return next((mark for mark in (",", ";", "\t") if mark in lines[0]), None)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
