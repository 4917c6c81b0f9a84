"""What tables of texts hold besides one number a cell: lists, long tables, dates, and stamps in two
columns.

A column is a list of cells: numbers, lists of numbers or of names, texts, or None for an empty one.
"""

import ast
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np

from elastic_arm.errors import RecordingError

Columns = dict[str, list[Any]]
_TIME = re.compile(r"(^|[._ /])(t|time|stamp|timestamp|date|datetime)s?($|[._ \[(])", re.I)
_VALUE = re.compile(r"^(value|val|data|number)s?$", re.I)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)$")
_SECONDS = re.compile(r"(.*[._]?)(?:secs?|seconds)$", re.I)
_NAMES = re.compile(r"(^|[._ ])(joint_?)?names?$", re.I)
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})")
_FEWEST = 3  # rows a name, of a table that has a row for each


def arrays_of(columns: Columns) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the arrays of columns, and the units of those that were dates.

    Cells that hold lists of one length become an array of two axes, or with a column of names one
    array a name; a table with a row for each name and time becomes one column a name; dates become
    ns since 1970, times of day s.
    """
    read = {name: [_cell(cell) for cell in cells] for name, cells in columns.items()}
    units: dict[str, str] = {}
    for name, cells in read.items():
        found = _dates(cells)
        if found is not None:
            read[name], units[name] = found[0].tolist(), found[1]
    _join_stamps(read, units)
    read = _wide(read)
    names = next(
        (name for name, cells in read.items() if _NAMES.search(name) and _lists_of(cells, str)),
        None,
    )
    arrays: dict[str, np.ndarray] = {}
    for name, cells in read.items():
        if _lists_of(cells, float):
            arrays |= (
                _by_names(name, cells, read[names]) if names is not None else _table(name, cells)
            )
        elif name != names:
            arrays[name] = _column(cells, units.get(name))
    return arrays, {name: unit for name, unit in units.items() if name in arrays}


def _cell(cell: Any) -> Any:
    """Return what a text holds: a list, or itself."""
    text = cell.strip() if isinstance(cell, str) else ""
    if not text or text[0] not in "[(a" or text[-1] not in "])":
        return cell
    text = re.sub(r"^array\((?:'\w',\s*)?(.*)\)$", r"\1", text, flags=re.S)
    with suppress(ValueError, SyntaxError, MemoryError, RecursionError):
        return list(json.loads(text))
    with suppress(ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        return list(ast.literal_eval(text))
    with suppress(ValueError):  # as NumPy prints them, without commas
        return [float(word) for word in text.strip("[]()").split()]
    return cell


def _lists_of(cells: Sequence[Any], kind: type) -> bool:
    """Return whether all cells that are there are lists of numbers, or of texts."""
    lists = [cell for cell in cells if cell is not None]
    kinds = (int, float, type(None)) if kind is float else (kind,)
    return bool(lists) and all(
        isinstance(one, list) and all(isinstance(x, kinds) for x in one) for one in lists
    )


def _table(name: str, cells: Sequence[Any]) -> dict[str, np.ndarray]:
    """Return lists of numbers as one array (N, k); the empty ones of a column are NaN."""
    width = max(len(cell) for cell in cells if cell is not None)
    if not width:
        return {}
    lengths = {len(cell) for cell in cells if cell}
    if len(lengths) > 1:
        raise RecordingError(
            f"the lists of {name} have {min(lengths)} to {max(lengths)} numbers",
            "Give all of them the same number.",
        )
    rows = [cell or [np.nan] * width for cell in cells]
    return {name: np.array([[np.nan if x is None else x for x in row] for row in rows], np.float64)}


def _by_names(name: str, cells: Sequence[Any], names: Sequence[Any]) -> dict[str, np.ndarray]:
    """Return lists of numbers as one array a name, in whichever order each row has them."""
    known = list(dict.fromkeys(word for row in names for word in row or []))
    columns = {word: np.full(len(cells), np.nan) for word in known}
    for k, (row, words) in enumerate(zip(cells, names, strict=True)):
        if not row or words is None:
            continue
        if len(row) != len(words):
            return _table(name, cells)
        for word, number in zip(words, row, strict=True):
            columns[word][k] = np.nan if number is None else number
    held = {word: values for word, values in columns.items() if not np.isnan(values).all()}
    return {f"{name}.{word}": values for word, values in held.items()}


def _column(cells: Sequence[Any], unit: str | None) -> np.ndarray:
    """Return numbers, or texts where any cell is none."""
    if unit == "ns":
        return np.array(cells, np.int64)
    try:
        return np.array([np.nan if cell in (None, "") else float(cell) for cell in cells])
    except (TypeError, ValueError):
        return np.array(["" if cell is None else str(cell) for cell in cells])


def _dates(cells: Sequence[Any]) -> tuple[np.ndarray, str] | None:
    """Return dates as ns since 1970, times of day as s, each with its unit; None where any cell is
    neither."""
    if not cells or not all(
        isinstance(cell, str) and re.match(r"\s*\d{1,4}[-:./]\d", cell) for cell in cells
    ):
        return None
    texts = [cell.strip() for cell in cells]
    if all(map(_CLOCK.match, texts)):
        parts = [_CLOCK.match(text).groups() for text in texts]  # type: ignore[union-attr]
        seconds = np.array(
            [3600.0 * int(h) + 60.0 * int(m) + float(s.replace(",", ".")) for h, m, s in parts]
        )
        # Midnight is no step back.
        days = np.concatenate([[0.0], np.cumsum(np.diff(seconds) < -43_200.0)])
        return seconds + 86_400.0 * days, "s"
    with suppress(ValueError):
        return np.array([_nanoseconds(text) for text in texts], np.int64), "ns"
    return None


def _nanoseconds(text: str) -> int:
    """Return the ns since 1970 of a date, of one without a zone as UTC."""
    text = _DAY_FIRST.sub(r"\3-\2-\1", text).replace("/", "-").replace(",", ".")
    found = datetime.fromisoformat(text)
    found = found if found.tzinfo is not None else found.replace(tzinfo=UTC)
    # Python keeps six digits of the second.
    digits = re.search(r"\.(\d+)", text)
    fraction = digits[1][:9].ljust(9, "0") if digits else "0"
    return int(found.replace(microsecond=0).timestamp()) * 1_000_000_000 + int(fraction)


def _join_stamps(columns: Columns, units: dict[str, str]) -> None:
    """Make one column of stamps of seconds and nanoseconds beside each other, as ROS has them."""
    for name in list(columns):
        match = _SECONDS.match(name)
        if match is None or not match[1].strip("._"):
            continue
        rest = [match[1] + word for word in ("nsecs", "nsec", "nanosec", "nanosecs", "nanoseconds")]
        beside = next((other for other in rest if other in columns), None)
        if beside is None:
            continue
        with suppress(TypeError, ValueError):
            pairs = zip(columns[name], columns[beside], strict=True)
            stamps = [int(float(s)) * 1_000_000_000 + int(float(ns)) for s, ns in pairs]
            stem = match[1].strip("._")
            columns[stem], units[stem] = stamps, "ns"
            del columns[name], columns[beside]


def _wide(columns: Columns) -> Columns:
    """Return a table that has a row for each name and time with a column for each name; any other
    as it is."""
    times = next((name for name in columns if _TIME.search(name)), None)
    words = [
        name
        for name, cells in columns.items()
        if cells and all(isinstance(c, str) and c for c in cells)
    ]
    keys = [name for name in words if not _is_numbers(columns[name])]
    if times is None or times in keys or len(keys) != 1:
        return columns
    key, stamps = keys[0], columns[times]
    known = list(dict.fromkeys(columns[key]))
    advancing = all(str(a) != str(b) for a, b in pairwise(stamps))
    if (
        len(known) < 2
        or len(stamps) < _FEWEST * len(known)
        or (advancing and len(known) > len(stamps) // _FEWEST)
    ):
        return columns
    rows: dict[Any, list[int]] = {name: [] for name in known}
    for k, name in enumerate(columns[key]):
        rows[name].append(k)
    values = [name for name in columns if name not in (key, times)]
    alone = len(values) == 1 and _VALUE.match(values[0])
    first = [stamps[k] for k in rows[known[0]]]
    found: Columns = {times: first}
    for name, where in rows.items():
        own = [stamps[k] for k in where]
        if own != first and not any(own == cells for cells in found.values()):
            found[f"{name}.{times}"] = own
        for value in values:
            found[name if alone else f"{value}.{name}"] = [columns[value][k] for k in where]
    return found


def _is_numbers(cells: Sequence[Any]) -> bool:
    try:
        return bool([float(cell) for cell in cells])
    except (TypeError, ValueError):
        return False


def records(content: Any, path: str) -> Columns:
    """Return the columns of JSON: a list of records, or an object of lists; objects within are
    named with dots."""
    while (
        isinstance(content, Mapping)
        and len(content) == 1
        and isinstance(next(iter(content.values())), list | dict)
    ):
        content = next(iter(content.values()))
    if isinstance(content, list) and content and all(isinstance(row, Mapping) for row in content):
        flat = [_flat(row) for row in content]
        names = list(dict.fromkeys(name for row in flat for name in row))
        return {name: [row.get(name) for row in flat] for name in names}
    columns = _flat(content) if isinstance(content, Mapping) else {}
    lists = {name: values for name, values in columns.items() if isinstance(values, list)}
    if not lists:
        raise RecordingError(
            f"{path} contains no table",
            "Give a list of records, an object of lists, or one record per line (JSON Lines).",
        )
    count = max(map(len, lists.values()))
    return {name: values for name, values in lists.items() if len(values) == count}


def _flat(record: Mapping[str, Any], within: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in record.items():
        found |= (
            _flat(value, f"{within}{name}.")
            if isinstance(value, Mapping)
            else {f"{within}{name}": value}
        )
    return found
