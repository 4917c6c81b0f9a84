"""Tables as text, and JSON, as arrays by name."""

import codecs
import csv
import itertools
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.text_layouts import arrays_of, has_layout, records

Row = tuple[int, str]  # the number of a line, and the line
WHOLE_TABLE = ""  # name of the table of a file whose columns have no names
_REMARK = "#%"  # begin of a line that is a comment, as numpy and MATLAB write it
_BLANK = ("", "na", "n/a", "#n/a", "null", "none", "-", "--")  # cells that hold no number
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?$")
_IN_BRACKETS = re.compile(r"\(.*\)|\[.*\]")


class Arrays(dict[str, np.ndarray]):
    """Arrays by name, with the further contents of a text table."""

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
        # of arrays of several columns, what each column is called, where a dataset states it
        self.columns: dict[str, tuple[str, ...]] = {}

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(array.nbytes for array in self.values())


def read_text_table(path: Path, decimal: str | None) -> Arrays:
    """Read a table as text: with or without a line of names, a row of units, columns of texts, and
    blank cells."""
    rows, delimiter = _rows_from_names(path, decimal)
    names, rows = _named(rows, delimiter)
    nameless = not names
    if nameless:
        first = _cells(rows[0][1].lstrip(_REMARK), delimiter)
        names = [str(column) for column in range(len(first))]
    units, rows = _units(names, rows, delimiter)
    mark = _decimal_mark(path, rows, delimiter, decimal)
    try:
        arrays = _of_numbers(names, rows, delimiter, mark)
    except ValueError:
        arrays = _by_cells(path, names, rows, delimiter, mark)
    arrays.units = units
    if arrays.faults or has_layout(arrays):
        arrays = laid_out(path, arrays)
    arrays.decimal = mark
    if nameless and not arrays.faults:
        arrays[WHOLE_TABLE] = np.column_stack(list(arrays.values()))
    return arrays


def _rows_from_names(path: Path, decimal: str | None) -> tuple[list[Row], str | None]:
    """Return the rows from the line of names or the first numbers on, and the delimiter of the
    columns."""
    lines = _text(path).split("\n")
    rows = [(n, line) for n, line in enumerate(lines, start=1) if line.strip()]
    if not rows:
        raise RecordingError(
            f"{path} cannot be read: it is empty", "Give a file with a table of numbers."
        )
    rows = rows[_before_names([line for _, line in rows]) :]
    delimiter = _delimiter([line for _, line in rows[:2]], decimal)
    if delimiter is not None:
        rows = _whole_rows(lines, rows[0][0], delimiter)
    return rows, delimiter


def _named(rows: list[Row], delimiter: str | None) -> tuple[list[str], list[Row]]:
    """Return the names of the columns and the rows below them; no names if the first row contains
    numbers."""
    # Blanks may come several at a time, and stand behind the comment mark that numpy writes.
    head = _cells(rows[0][1].lstrip(_REMARK), delimiter)
    names = [name.strip().lstrip(_REMARK).strip() for name in head]
    nameless = all(_is_number(name) or _DECIMAL_COMMA.match(name) for name in names)
    below = rows if nameless else rows[1:]
    below = [(n, line) for n, line in below if line.partition("#")[0].strip()]
    if not below:
        raise ValueError("there are no numbers below the first line")
    if nameless:
        return [], below
    if len(set(names)) < len(names):
        # A second line of names says which joint, as data frames with names of two levels have it.
        further = [cell.strip() for cell in _cells(below.pop(0)[1], delimiter)]
        if len(further) == len(names) and not any(map(_is_number, further)):
            both = zip(names, further, strict=True)
            names = [f"{name}.{more}" if more else name for name, more in both]
    if len(set(names)) < len(names) or not below:
        raise ValueError(f"two columns are called {Counter(names).most_common(1)[0][0][:60]!r}")
    return names, below


def _units(
    names: Sequence[str], rows: list[Row], delimiter: str | None
) -> tuple[dict[str, str], list[Row]]:
    """Return the units stated by a row below the names, by column, and the rows below it."""
    cells = [cell.strip() for cell in _cells(rows[0][1], delimiter)]
    numbers = any(_is_number(cell.replace(",", ".")) for cell in cells)
    if len(rows) < 2 or numbers or not any(cells):
        return {}, rows
    units = [cell[1:-1] if _IN_BRACKETS.fullmatch(cell) else cell for cell in cells]
    stated = {name: unit for name, unit in zip(names, units, strict=False) if unit}
    return stated, rows[1:]


def _decimal_mark(
    path: Path, rows: Sequence[Row], delimiter: str | None, decimal: str | None
) -> str:
    """Return the decimal mark of the numbers in the rows."""
    for n, line in rows:
        if "," not in line or (delimiter == "," and '"' not in line):
            continue
        cells = map(str.strip, _cells(line, delimiter))
        comma = next(filter(_DECIMAL_COMMA.match, cells), None)
        if comma is None:
            continue
        if decimal == ".":
            problem = f"{path} cannot be read: line {n}: {comma!r} has a decimal comma"
            raise RecordingError(
                problem, "Write decimal: ',' in the mapping, or numbers with decimal points."
            )
        return ","
    return "."


def _of_numbers(
    names: Sequence[str], rows: Sequence[Row], delimiter: str | None, mark: str
) -> Arrays:
    """Return the columns of a table that contains only numbers; a ValueError for any other
    table."""
    lines = [line for _, line in rows]
    if mark == "," and delimiter != ",":
        lines = [line.replace(",", ".") for line in lines]
    table = np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    arrays = Arrays(dict(zip(names, table.T, strict=True)))
    # Doubles lose the last digits of nanoseconds since 1970.
    size = np.abs(table)
    long = ((size > 2**53) & (size < 2**63)).all(axis=0)
    for k in np.flatnonzero(long).tolist():
        whole = np.loadtxt(lines, delimiter=delimiter, usecols=k, dtype=np.int64, ndmin=1)
        arrays[names[k]] = whole
    return arrays


def _before_names(lines: Sequence[str]) -> int:
    """Return the number of lines before the line of names.

    The names are in the first line that is not a comment, or in the last comment before it, as
    numpy writes them. The lines before may state the delimiter, as Excel writes it, or contain a
    title, which has no delimiter.
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


def _whole_rows(lines: Sequence[str], first: int, delimiter: str) -> list[Row]:
    """Return the rows from a line on, each with the number of its first line.

    A cell in quotes may extend over several lines.
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
    """Return a line without its comment, which begins at the first # outside of quotes."""
    for at, mark in enumerate(line):
        if mark == "#" and line[:at].count('"') % 2 == 0:
            return line[:at]
    return line


def _text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in the encodings of Excel and Windows."""
    with path.open("rb") as file:
        wide = file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    for encoding in ("utf-16",) if wide else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            return path.read_text(encoding)
    raise ValueError("it is not text")


def _by_cells(
    path: Path,
    names: Sequence[str],
    rows: Sequence[Row],
    delimiter: str | None,
    decimal: str,
) -> Arrays:
    """Read a table with empty cells or texts."""
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


def laid_out(path: Path, table: Arrays) -> Arrays:
    """Return a table with its lists, long layout or dates converted to arrays; any other table
    unchanged."""
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


def read_records(path: Path) -> Arrays:
    """Read a list of records, an object of lists, or one record per line."""
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
    """Return the delimiter of the columns according to the first lines; None for blanks."""
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
