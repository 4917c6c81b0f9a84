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
from typing import Any

import numpy as np
from dateutil import parser as dates

from elastic_arm.errors import RecordingError

Columns = dict[str, list[Any]]
_TIME = re.compile(r"(^|[._ /])(t|time|stamp|timestamp|date|datetime)s?($|[._ \[(])", re.I)
_VALUE = re.compile(r"^(value|val|data|number)s?$", re.I)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)(?:\s*([AP])\.?M\.?)?$", re.I)
_MINUTES = re.compile(r"(\d{1,3}):(\d{2}[.,]\d+)$")  # as Excel shows times of day
_DATED = re.compile(r"\d{1,2}:\d{2}|\d{8}T?\d{6}")  # a text that may be a date with a time
_SECONDS = re.compile(r"(.*[._]?)(?:secs?|seconds)$", re.I)
_NAMES = re.compile(r"(^|[._ ])(joint_?)?names?$", re.I)
# Two numbers that are one with a decimal comma, or a date and a time.
_ONE_VALUE = re.compile(r"[+-]?\d+,\d+|\d{8}[ T]\d{6}(?:\.\d+)?")
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.((?:\d{2})?\d{2})\b")
_COLONS = re.compile(r"^(\d{4}):(\d{2}):(\d{2}) ")  # the date of a picture
_PARTED = re.compile(r"[;,\s]+")
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
    read, units = _wide(_by_joints(read), units)
    arrays: dict[str, np.ndarray] = {}
    for name, cells in read.items():
        if _lists_of(cells, float):
            arrays |= _table(name, cells)
        else:
            arrays[name] = _column(cells, units.get(name))
    return arrays, {name: unit for name, unit in units.items() if name in arrays}


def _cell(cell: Any) -> Any:
    """Return what a text holds: a list, or itself."""
    text = cell.strip() if isinstance(cell, str) else ""
    if not text or text[-1] not in "])}.0123456789":
        return cell
    text = re.sub(r"^array\((?:'\w',\s*)?(.*)\)$", r"\1", text, flags=re.S)
    if text[0] in "[(":
        with suppress(ValueError, SyntaxError, MemoryError, RecursionError):
            return list(json.loads(text))
        with suppress(ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
            return list(ast.literal_eval(text))
    # As NumPy prints them, without commas; or without brackets.
    words = _PARTED.split(text.strip("[](){}; \n"))
    if _ONE_VALUE.fullmatch(text):
        return cell
    if len(words) > 1 or text[0] in "[({":
        with suppress(ValueError):
            return [float(word) for word in words if word]
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


def _by_joints(columns: Columns) -> Columns:
    """Return columns of lists beside a column of names as one column a name, in whichever order
    each row has them; any others as they are."""
    names = next(
        (name for name, cells in columns.items() if _NAMES.search(name) and _lists_of(cells, str)),
        None,
    )
    if names is None:
        return columns
    found: Columns = {}
    for name, cells in columns.items():
        rows = list(zip(cells, columns[names], strict=True))
        if not _lists_of(cells, float) or any(
            row and len(row) != len(words or []) for row, words in rows
        ):
            found |= {name: cells} if name != names else {}
            continue
        for k, (row, words) in enumerate(rows):
            for word, number in zip(words or [], row or [], strict=False):
                column = found.setdefault(f"{name}.{word}", [None] * len(cells))
                column[k] = number
    return {name: cells for name, cells in found.items() if any(cell is not None for cell in cells)}


def _column(cells: Sequence[Any], unit: str | None) -> np.ndarray:
    """Return numbers, or texts where any cell is none."""
    if unit == "ns" and None not in cells:
        return np.array(cells, np.int64)
    try:
        return np.array([np.nan if cell in (None, "") else float(cell) for cell in cells])
    except (TypeError, ValueError):
        return np.array(["" if cell is None else str(cell) for cell in cells])


def _dates(cells: Sequence[Any]) -> tuple[np.ndarray, str] | None:
    """Return dates as ns since 1970, times of day as s, each with its unit; None where any cell is
    neither."""
    if not cells or not all(isinstance(cell, str) for cell in cells):
        return None
    texts = [cell.strip() for cell in cells]
    for pattern, seconds_of, around in (
        (_CLOCK, _time_of_day, 86_400.0),
        (_MINUTES, _time_of_hour, 3_600.0),
    ):
        matches = [pattern.match(text) for text in texts]
        if all(matches):
            seconds = np.array([seconds_of(*match.groups()) for match in matches if match])
            # Midnight, or the full hour, is no step back.
            turns = np.concatenate([[0.0], np.cumsum(np.diff(seconds) < -0.5 * around)])
            return seconds + around * turns, "s"
    if all(map(_DATED.search, texts)):
        with suppress(ValueError, OverflowError):
            return np.array(_nanoseconds(texts), np.int64), "ns"
    return None


def _time_of_day(hours: str, minutes: str, seconds: str, half: str | None) -> float:
    hour = int(hours)
    if half is not None:
        hour = hour % 12 + 12 * (half.upper() == "P")
    return 3600.0 * hour + _time_of_hour(minutes, seconds)


def _time_of_hour(minutes: str, seconds: str) -> float:
    return 60.0 * int(minutes) + float(seconds.replace(",", "."))


def _nanoseconds(texts: Sequence[str]) -> list[int]:
    """Return the ns since 1970 of dates; those without a zone are UTC."""
    plain = []
    for text in texts:
        iso = _COLONS.sub(r"\1-\2-\3 ", _DAY_FIRST.sub(_year_first, text))
        plain.append(iso.replace(",", "."))
    # 03/01 is March 1st, unless another row shows that the day comes first.
    firsts = [re.match(r"\d+(?=/)", text) for text in plain]
    day_first = any(first is not None and 12 < int(first[0]) < 32 for first in firsts)
    found = []
    for text in plain:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            moment = dates.parse(text, dayfirst=day_first)
        moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        # Python keeps six digits of the second.
        digits = re.search(r"(?::\d{2}|\d{6})\.(\d+)", text)
        fraction = digits[1][:9].ljust(9, "0") if digits else "0"
        whole = int(moment.replace(microsecond=0).timestamp())
        found.append(whole * 1_000_000_000 + int(fraction))
    return found


def _year_first(date: re.Match[str]) -> str:
    """Return a date with dots, the day first, as year, month, day; a year of two digits is of this
    century."""
    day, month, year = date.groups()
    return f"{year if len(year) == 4 else '20' + year}-{int(month):02d}-{int(day):02d}"


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
            stem = match[1].strip("._")
            columns[stem] = [_stamp(s, ns) for s, ns in pairs]
            units[stem] = "ns"
            del columns[name], columns[beside]


def _stamp(seconds: Any, nanoseconds: Any) -> int | None:
    if seconds is None or nanoseconds is None:
        return None
    return int(float(seconds)) * 1_000_000_000 + int(float(nanoseconds))


def _wide(columns: Columns, units: dict[str, str]) -> tuple[Columns, dict[str, str]]:
    """Return a table that has a row for each name and time with a column for each name, and the
    units of its columns; any other table as it is."""
    times = next((name for name in columns if _TIME.search(name)), None)
    keys = [] if times is None else _keys(columns, times)
    if times is None or not keys:
        return columns, units
    rows: dict[str, list[int]] = {}
    for k, words in enumerate(zip(*(columns[key] for key in keys), strict=True)):
        name = ".".join(f"{word:g}" if isinstance(word, float) else str(word) for word in words)
        rows.setdefault(name, []).append(k)
    stamps = columns[times]
    if len(rows) < 2 or len(stamps) < _FEWEST * len(rows):
        return columns, units
    values = [name for name in columns if name not in (*keys, times)]
    alone = len(values) == 1 and _VALUE.match(values[0])
    found: Columns = {}
    found_units: dict[str, str] = {}

    def put(name: str, of: str, cells: list[Any]) -> None:
        found[name] = cells
        if of in units:
            found_units[name] = units[of]

    put(times, times, [stamps[k] for k in next(iter(rows.values()))])
    for name, where in rows.items():
        own = [stamps[k] for k in where]
        if not any(own == cells for cells in found.values()):
            put(f"{name}.{times}", times, own)
        for value in values:
            cells = [columns[value][k] for k in where]
            if any(cell is not None for cell in cells):
                put(name if alone else f"{value}.{name}", value, cells)
    return found, found_units


def _keys(columns: Columns, times: str) -> list[str]:
    """Return the columns that say what a row of a long table is of; none of any other table.

    They are texts, or the number of a joint where each time has a row for each of them.
    """
    stamps = [str(stamp) for stamp in columns[times]]
    repeated = 2 * len(set(stamps)) <= len(stamps)
    texts = []
    numbers = []
    for name, cells in columns.items():
        if name == times:
            continue
        if _is_numbers(cells):
            numbers += [name] if repeated and _counts_rows(stamps, cells) else []
        elif all(isinstance(cell, str) and cell for cell in cells):
            texts.append(name)
    if not repeated:
        # Signals with times of their own: one column names them.
        few = len(texts) == 1 and len(set(columns[texts[0]])) <= len(stamps) // _FEWEST
        return texts if few else []
    for some in (texts, numbers[:1]):
        if some and _tells_apart(stamps, columns, some):
            needless = [
                name
                for name in some
                if _tells_apart(stamps, columns, [one for one in some if one != name])
            ]
            return [name for name in some if name not in needless]
    # One name may come twice at a time where its stamps are coarse.
    return texts if len(texts) == 1 else []


def _tells_apart(stamps: Sequence[str], columns: Columns, keys: Sequence[str]) -> bool:
    """Return whether every row has another time or another key."""
    return len(set(zip(stamps, *(columns[key] for key in keys), strict=True))) == len(stamps)


def _counts_rows(stamps: Sequence[str], cells: Sequence[Any]) -> bool:
    """Return whether whole numbers are the same few at each time."""
    numbers = [float(cell) for cell in cells]
    if not all(number.is_integer() for number in numbers):
        return False
    full = len(set(stamps)) * len(set(numbers))
    return full - len(set(numbers)) < len(stamps) <= full


def is_long(arrays: Mapping[str, np.ndarray]) -> bool:
    """Return whether a table without texts has several rows a time, and a column that counts
    them."""
    times = next((name for name in arrays if _TIME.search(name)), None)
    if times is None or arrays[times].ndim != 1 or len(arrays[times]) < 2 * _FEWEST:
        return False
    if arrays[times].dtype.kind not in "iuf":
        return False
    if np.mean(np.diff(arrays[times]) == 0) < 0.3:  # a quick look, before all cells are
        return False
    same = {n: v.tolist() for n, v in arrays.items() if v.shape == arrays[times].shape}
    return bool(_keys(same, times))


def _is_numbers(cells: Sequence[Any]) -> bool:
    try:
        return bool([float(cell) for cell in cells])
    except (TypeError, ValueError):
        return False


def records(content: Any, path: str) -> Columns:
    """Return the columns of JSON: a list of records, or an object of lists; objects within are
    named with dots.

    A list of records may lie beside other things, and a table may have a row a joint.
    """
    rows = _longest_records(content)
    columns = _flat(content) if isinstance(content, Mapping) else {}
    lists = {name: values for name, values in columns.items() if _is_column(values)}
    # Records beside longer columns describe joints or sensors.
    if len(rows) > max((len(values) for values in lists.values()), default=0):
        flat = [_flat(row) for row in rows]
        names = list(dict.fromkeys(name for row in flat for name in row))
        return {name: [row.get(name) for row in flat] for name in names}
    if not lists:
        raise RecordingError(
            f"{path} contains no table",
            "Give a list of records, an object of lists, or one record per line (JSON Lines).",
        )
    count = max(len(values) for values in lists.values())
    found: Columns = {}
    for name, values in lists.items():
        if len(values) == count:
            found[name] = values
        elif values and all(isinstance(row, list) and len(row) == count for row in values):
            found[name] = [list(row) for row in zip(*values, strict=True)]
    return found


def _is_column(values: Any) -> bool:
    """Return whether something is a list of other things than records."""
    return isinstance(values, list) and not any(isinstance(one, Mapping) for one in values)


def _longest_records(content: Any) -> list[Mapping[str, Any]]:
    """Return the longest list of records within objects; none where there is none."""
    if isinstance(content, list):
        return content if all(isinstance(row, Mapping) for row in content) else []
    if not isinstance(content, Mapping):
        return []
    return max((_longest_records(value) for value in content.values()), key=len, default=[])


def _flat(record: Mapping[str, Any], within: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, list) and value and all(isinstance(one, Mapping) for one in value):
            value = _by_name(value)
        found |= (
            _flat(value, f"{within}{name}.")
            if isinstance(value, Mapping)
            else {f"{within}{name}": value}
        )
    return found


def _by_name(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a list of objects as an object: by their names where they have some, else by their
    places."""
    found = {}
    for k, one in enumerate(records):
        name = next((key for key in one if _NAMES.search(key) and isinstance(one[key], str)), None)
        called = str(k) if name is None else one[name]
        found[called] = {key: value for key, value in one.items() if key != name}
    return found
