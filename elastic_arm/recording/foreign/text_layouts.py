"""Convert layouts of text tables other than one number per cell: lists in cells, tables with one
row per signal, dates, and stamps in two columns.

A column is a list of cells: numbers, lists of numbers or of names, texts, or None for an empty
cell.
"""

import ast
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
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
_NANOSECONDS = ("nsecs", "nsec", "nanosec", "nanosecs", "nanoseconds")
# A column that numbers several runs below each other.
RUN_NAME = re.compile(r"(episode|file|run|trial|traj(ectory)?)(_?(index|id|number|nr))?$", re.I)
_NAMES = re.compile(r"(^|[._ ])(joint_?)?names?$", re.I)
# Two numbers that are one with a decimal comma, or a date and a time.
_ONE_VALUE = re.compile(r"[+-]?\d+,\d+|\d{8}[ T]\d{6}(?:\.\d+)?")
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.((?:\d{2})?\d{2})\b")
_COLONS = re.compile(r"^(\d{4}):(\d{2}):(\d{2}) ")  # the date of a picture
_PARTED = re.compile(r"[;,\s]+")
_FEWEST = 3  # rows a name, of a table that has a row for each


def arrays_of(columns: Columns) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the arrays of columns, and the units of those that were dates.

    Cells with lists of equal length become an array with two axes, or with a column of names one
    array per name. A table with one row per name and time becomes one column per name. Dates become
    ns since 1970, times of day s. Columns of different lengths are separate tables.
    """
    arrays: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for length in dict.fromkeys(len(cells) for cells in columns.values()):
        table = {name: cells for name, cells in columns.items() if len(cells) == length}
        found, stated = _arrays_of_table(table)
        arrays |= found
        units |= stated
    return arrays, units


def _arrays_of_table(columns: Columns) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    read = {name: [_cell(cell) for cell in cells] for name, cells in columns.items()}
    units: dict[str, str] = {}
    for name, cells in read.items():
        found = _dates(cells)
        if found is not None:
            moments, units[name] = found
            read[name] = moments.tolist()
    for stem, (seconds, rest) in stamp_pairs(read).items():
        with suppress(TypeError, ValueError):
            pairs = zip(read[seconds], read[rest], strict=True)
            read[stem] = [_stamp(whole, fraction) for whole, fraction in pairs]
            units[stem] = "ns"
            del read[seconds], read[rest]
    read, units = _wide(_by_joints(read), units)
    arrays: dict[str, np.ndarray] = {}
    for name, cells in read.items():
        if _lists_of(cells, float):
            arrays |= _table(name, cells)
        else:
            arrays[name] = _column(cells, units.get(name))
    return arrays, {name: unit for name, unit in units.items() if name in arrays}


def _cell(cell: Any) -> Any:
    """Return the list that a text contains, or the text."""
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
    """Return whether all non-empty cells are lists of numbers, or of texts."""
    kinds = (int, float, type(None)) if kind is float else (kind,)
    lists = [cell for cell in cells if cell is not None]
    for one in lists:
        if not isinstance(one, list) or not all(isinstance(item, kinds) for item in one):
            return False
    return bool(lists)


def _table(name: str, cells: Sequence[Any]) -> dict[str, np.ndarray]:
    """Return lists of numbers as one array (N, k); empty lists become NaN.

    Lists of different lengths become a text that states their lengths.
    """
    width = max(len(cell) for cell in cells if cell is not None)
    if not width:
        return {}
    lengths = {len(cell) for cell in cells if cell}
    if len(lengths) > 1:
        return {name: np.full(len(cells), f"lists of {min(lengths)} to {max(lengths)} numbers")}
    rows = [cell or [np.nan] * width for cell in cells]
    return {name: np.array(rows, np.float64)}  # None becomes NaN


def _by_joints(columns: Columns) -> Columns:
    """Return columns of lists next to a column of names as one column per name, whatever the order
    in each row; other columns unchanged."""
    called = [name for name in columns if _NAMES.search(name)]
    names = next((name for name in called if _lists_of(columns[name], str)), None)
    if names is None:
        return columns
    found = {}
    for name, cells in columns.items():
        rows = list(zip(cells, columns[names], strict=True))
        if not _lists_of(cells, float) or not _of_equal_lengths(rows):
            if name != names:
                found[name] = cells
            continue
        for k, (row, words) in enumerate(rows):
            for word, number in zip(words or [], row or [], strict=False):
                column = found.setdefault(f"{name}.{word}", [None] * len(cells))
                column[k] = number
    return {name: cells for name, cells in found.items() if cells.count(None) < len(cells)}


def _of_equal_lengths(rows: Sequence[tuple[Any, Any]]) -> bool:
    """Return whether the lists of numbers are empty, or as long as the lists of names."""
    return all(not row or len(row) == len(words or []) for row, words in rows)


def _column(cells: Sequence[Any], unit: str | None) -> np.ndarray:
    """Return numbers, or texts if any cell is not a number."""
    whole = all(type(cell) is int for cell in cells)
    # Of nanoseconds since 1970 doubles lose the last ones.
    if whole and cells and 2**53 < max(map(abs, cells)) < 2**63:
        return np.array(cells, np.int64)
    try:
        return np.array([np.nan if cell in (None, "") else float(cell) for cell in cells])
    except (TypeError, ValueError):
        return np.array(["" if cell is None else str(cell) for cell in cells])


def _dates(cells: Sequence[Any]) -> tuple[np.ndarray, str] | None:
    """Return dates as ns since 1970 or times of day as s, with the unit; None if any cell is
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
    """Return dates as ns since 1970; dates without a time zone are UTC."""
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
    """Return a date with dots, day first, as year, month, day; a year of two digits belongs to this
    century."""
    day, month, year = date.groups()
    return f"{year if len(year) == 4 else '20' + year}-{int(month):02d}-{int(day):02d}"


def stamp_pairs(names: Collection[str]) -> dict[str, tuple[str, str]]:
    """Return the pairs of columns with seconds and nanoseconds, as in ROS, by their common name."""
    pairs = {}
    for name in names:
        match = _SECONDS.match(name)
        if match is None or not match[1].strip("._"):
            continue
        rest = [match[1] + word for word in _NANOSECONDS if match[1] + word in names]
        if rest:
            pairs[match[1].strip("._")] = (name, rest[0])
    return pairs


def _stamp(seconds: Any, nanoseconds: Any) -> int | None:
    if seconds is None or nanoseconds is None:
        return None
    return int(float(seconds)) * 1_000_000_000 + int(float(nanoseconds))


def _wide(columns: Columns, units: dict[str, str]) -> tuple[Columns, dict[str, str]]:
    """Return a table with one row per name and time as one with a column per name, and the units of
    its columns; any other table unchanged."""
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
    """Return the columns that name the signal of each row of a long table; an empty list for any
    other table.

    The columns contain texts, or the number of a joint if each time has one row per joint.
    """
    stamps = [str(stamp) for stamp in columns[times]]
    repeated = 2 * len(set(stamps)) <= len(stamps)
    texts = []
    numbers = []
    for name, cells in columns.items():
        if name == times or RUN_NAME.search(name):
            continue
        if _is_numbers(cells):
            numbers += [name] if repeated and _counts_rows(stamps, cells) else []
        elif all(isinstance(cell, str) and cell for cell in cells):
            texts += [] if _is_of_runs(columns, cells) else [name]
    if not repeated:
        # Signals with times of their own: one column names them.
        few = len(texts) == 1 and len(set(columns[texts[0]])) <= len(stamps) // _FEWEST
        return texts if few else []
    for some in (texts, numbers[:1]):
        if some and _tells_apart(stamps, columns, some):
            return [name for name in some if _is_needed(name, stamps, columns, some)]
    # One name may come twice at a time where its stamps are coarse.
    return texts if len(texts) == 1 else []


def _is_of_runs(columns: Columns, cells: Sequence[str]) -> bool:
    """Return whether a text is constant within each of several runs, as the task of an episode
    is."""
    for name, numbers in columns.items():
        if RUN_NAME.search(name) and len(set(map(str, numbers))) > 1:
            runs = list(map(str, numbers))
            return len(set(zip(runs, cells, strict=True))) == len(set(runs))
    return False


def _is_needed(name: str, stamps: Sequence[str], columns: Columns, keys: Sequence[str]) -> bool:
    """Return whether the other keys do not tell all rows apart."""
    others = [key for key in keys if key != name]
    return not _tells_apart(stamps, columns, others)


def _tells_apart(stamps: Sequence[str], columns: Columns, keys: Sequence[str]) -> bool:
    """Return whether time and keys differ between all rows."""
    return len(set(zip(stamps, *(columns[key] for key in keys), strict=True))) == len(stamps)


def _counts_rows(stamps: Sequence[str], cells: Sequence[Any]) -> bool:
    """Return whether integers repeat in the same way at each time."""
    numbers = [float(cell) for cell in cells]
    if not all(number.is_integer() for number in numbers):
        return False
    full = len(set(stamps)) * len(set(numbers))
    return full - len(set(numbers)) < len(stamps) <= full


def has_layout(arrays: Mapping[str, np.ndarray]) -> bool:
    """Return whether a table contains texts, stamps in two columns, or several rows per time with a
    column that counts them."""
    if stamp_pairs(arrays) or any(values.dtype.kind == "U" for values in arrays.values()):
        return True
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
    """Return the columns of JSON: of a list of records, or of an object with lists; names of nested
    objects are joined by dots.

    The list of records may be one entry among others, and a table may have one row per joint.
    """
    content = _as_lists(content)
    within = _flat(content) if isinstance(content, Mapping) else {}
    lists = {name: values for name, values in within.items() if _is_column(values)}
    count = max((len(values) for values in lists.values()), default=0)
    found = {}
    for name, values in lists.items():
        by_joint = all(isinstance(row, list) and len(row) == count for row in values)
        turned = by_joint and 0 < len(values) < count
        found[name] = [list(row) for row in zip(*values, strict=True)] if turned else values
    tables = dict(_record_lists(content))
    longest = max(tables, key=lambda where: len(tables[where]), default="")
    for where, rows in tables.items():
        flat = [_flat(row) for row in rows]
        names = list(dict.fromkeys(name for row in flat for name in row))
        # Records beside longer columns, and those without a time, describe joints or sensors.
        is_main = where == longest and len(rows) > count
        if is_main or any(map(_TIME.search, names)):
            stem = "" if is_main or not where else f"{where}."
            found |= {f"{stem}{name}": [row.get(name) for row in flat] for name in names}
    if not found:
        raise RecordingError(
            f"{path} contains no table",
            "Give a list of records, an object of lists, or one record per line (JSON Lines).",
        )
    return found


def _as_lists(content: Any) -> Any:
    """Return content with the tables of pandas as lists: numbered rows, rows with separate column
    names, and lists of rows without names."""
    if isinstance(content, list) and content and all(isinstance(row, list) for row in content):
        return {str(k): list(column) for k, column in enumerate(zip(*content, strict=False))}
    if not isinstance(content, Mapping):
        return content
    names = content.get("columns")
    rows = content.get("data")
    if isinstance(names, list) and isinstance(rows, list):
        return dict(zip(map(str, names), map(list, zip(*rows, strict=False)), strict=False))
    found = {name: _numbered_rows(value) for name, value in content.items()}
    return _numbered_rows(found)


def _numbered_rows(content: Any) -> Any:
    """Return an object whose keys count from 0 as a list of its values, if these are numbers or
    records of numbers."""
    if not isinstance(content, Mapping) or list(content) != [str(k) for k in range(len(content))]:
        return content
    rows = [one if isinstance(one, Mapping) else {"": one} for one in content.values()]
    of_lists = any(isinstance(cell, list | dict) for row in rows for cell in row.values())
    return content if of_lists else list(content.values())


def _is_column(values: Any) -> bool:
    """Return whether something is a list without records."""
    return isinstance(values, list) and not any(isinstance(one, Mapping) for one in values)


def _record_lists(content: Any, within: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Yield the lists of records within objects, by the names that lead to them."""
    if isinstance(content, list) and content and all(isinstance(row, Mapping) for row in content):
        yield within, content
    elif isinstance(content, Mapping):
        for name, value in content.items():
            yield from _record_lists(value, f"{within}.{name}" if within else str(name))


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
