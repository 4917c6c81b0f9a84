"""Find tables of all joints among the arrays of a file: single arrays, or groups of columns whose
names count the joints."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.channels import NANOSECONDS, stated_unit, time_unit
from elastic_arm.recording.foreign.text_layouts import RUN_NAME
from elastic_arm.recording.inspection.report import check_stamped, check_times
from elastic_arm.recording.sides import Array, short_names

# Sample rates of arms, Hz: the unit of the times is the one with which the rate is among them.
_RATES = (15.0, 12_000.0)
TIME_NAME = re.compile(
    r"(^|[._ ])(t|time|times|stamp|stamps|timestamp|timestamps|sec|secs|seconds)($|[._ \[(])", re.I
)
_NO_TIMES = (
    "Export the times in double precision (float64), or map the channels by hand with"
    " `times: {rate: HZ}`, if the samples are regular."
)
_NONE: Mapping[str, str] = MappingProxyType({})
_COUNTED = re.compile(r"^(.*?)(\d+)(\D*)$")


@dataclass(frozen=True, eq=False)
class JointTable:
    """One quantity of all joints."""

    keys: tuple[str, ...]  # names of the arrays: one with a column a joint, or one a joint
    columns: (
        tuple[int, ...] | None
    )  # columns of a single array that has more than the joints; None for all
    values: Array  # (N, n) numbers as recorded
    # what its arrays are called, with * for the joint, where their names hold the joints' own
    pattern: str = ""
    available: int = 0  # columns that there are; 0 where these are all
    flat: bool = False  # the numbers of all joints stand one after the other
    stated: str = ""  # unit by the name of the first array, or by a row of units
    called: bool = False  # whether its columns are those of the joints by their names

    @property
    def name(self) -> str:
        """The name of the table in messages: its array, or the common part of the names of its
        columns."""
        if len(self.keys) == 1:
            return self.keys[0]
        return self.pattern or f"{self.keys[0]} to {self.keys[-1]}"

    @property
    def stem(self) -> str:
        """The name without the number or name of the joint."""
        if len(self.keys) == 1:
            return self.keys[0]
        return self.pattern or re.sub(r"\d+\D*$", "", self.keys[0])


@dataclass(frozen=True, eq=False)
class TimeArray:
    """The times of the samples."""

    key: str  # key, unit: name of the array, and what its numbers count
    unit: str
    seconds: Array  # (N,) from the first sample
    fault: str = ""  # why they cannot be used as they are: they repeat or decrease

    @property
    def rate(self) -> float:
        """Samples per second, by the median interval."""
        steps = np.diff(self.seconds)
        return float(1.0 / np.median(steps[steps > 0]))


@dataclass(frozen=True, eq=False)
class Contents:
    """The arrays of a file as tables of n joints."""

    times: TimeArray | None  # none if no array looks like times
    tables: tuple[JointTable, ...]  # in the file's order
    rest: tuple[str, ...]  # names of the arrays that are neither
    runs: tuple[str, int] | None = (
        None  # the array that numbers several runs, and how many there are
    )


def find_tables(
    arrays: Mapping[str, np.ndarray],
    joints: Sequence[str],
    units: Mapping[str, str] = _NONE,
    columns: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> Contents:
    """Sort arrays into times, tables of n joints, and others; of several runs the first one is
    used.

    An array of more than n columns is a table of its first n columns, or of those that `columns`
    calls by the names of the joints. Columns whose names contain
    the names of the joints form a table, as do columns whose names count the joints. Columns
    without names are taken n at a time. For one joint every column is a table.
    """
    numeric = {
        key: np.squeeze(values) for key, values in arrays.items() if values.dtype.kind in "iuf"
    }
    runs = _find_runs(numeric)
    if runs is not None:
        numbers = numeric.pop(runs[0])
        first = numbers == numbers[0]
        numeric = {
            key: v[first] if len(v) == len(first) else v for key, v in numeric.items() if v.ndim
        }
    numeric = {
        key: _without_holes(values)
        for key, values in numeric.items()
        if values.ndim in (1, 2) and values.size
    }
    n = len(joints)
    chosen = {key: _places_of(names, joints) for key, names in columns.items()}
    count = _sample_count(numeric)
    times, tables = _sorted(numeric, joints, count, units)
    if not tables and n > 1 and count % n == 0:
        # Numbers one a line are those of all joints, sample by sample, where nothing else can be.
        shaped = {k: v.reshape(-1, n) if v.shape == (count,) else v for k, v in numeric.items()}
        times, tables = _sorted(shaped, joints, count // n, units)
        tables = [replace(table, flat=numeric[table.keys[0]].ndim == 1) for table in tables]
    used = {key for table in tables for key in table.keys}
    used |= ({times.key} if times is not None else set()) | (
        {runs[0]} if runs is not None else set()
    )
    tables = [
        replace(table, stated=stated_unit(table.keys[0], units.get(table.keys[0], "")))
        for table in tables
    ]
    tables = [
        _called(table, numeric[table.keys[0]], places)
        if (places := chosen.get(table.keys[0])) is not None and len(table.keys) == 1
        else table
        for table in tables
    ]
    return Contents(times, tuple(tables), tuple(key for key in arrays if key not in used), runs)


def _sorted(
    numeric: Mapping[str, np.ndarray], joints: Sequence[str], count: int, units: Mapping[str, str]
) -> tuple[TimeArray | None, list[JointTable]]:
    n = len(joints)
    numeric = {key: values for key, values in numeric.items() if count in values.shape}
    times = _find_times(numeric, count, units)
    columns = {
        key: values
        for key, values in numeric.items()
        if values.ndim == 1 and not (times and key == times.key)
    }
    tables = [
        table
        for key, values in numeric.items()
        if values.ndim == 2 and (table := _whole(key, values, count, n)) is not None
    ]
    tables += _named(columns, joints)
    named = {key for table in tables for key in table.keys}
    tables += _counted({key: values for key, values in columns.items() if key not in named}, n)
    if n == 1:
        taken = {key for table in tables for key in table.keys}
        tables += [
            JointTable((key,), None, v[:, None]) for key, v in columns.items() if key not in taken
        ]
    return times, tables


def _find_runs(arrays: Mapping[str, np.ndarray]) -> tuple[str, int] | None:
    """Return the array that numbers concatenated runs, and the number of runs."""
    for key, values in arrays.items():
        if (
            RUN_NAME.search(key)
            and values.ndim == 1
            and len(values) > 1
            and np.array_equal(values, np.round(values))
        ):
            count = 1 + int(np.count_nonzero(np.diff(values)))
            if 1 < count == len(np.unique(values)):
                return key, count
    return None


def _without_holes(values: np.ndarray) -> np.ndarray:
    """Return numbers with missing ones interpolated linearly; zeros if all are missing."""
    found = values.astype(np.float64) if values.dtype.kind == "f" else values
    for column in found.reshape(len(found), -1).T if found.dtype.kind == "f" else ():
        if not (whole := np.isfinite(column)).all():
            rows = np.arange(len(column))
            column[~whole] = (
                np.interp(rows[~whole], rows[whole], column[whole]) if whole.any() else 0.0
            )
    return found


def _sample_count(arrays: Mapping[str, np.ndarray]) -> int:
    """Return the length of most arrays."""
    lengths: Counter[int] = Counter()
    for values in arrays.values():
        if values.ndim and values.size > 1:
            lengths[max(values.shape)] += values.size
    return lengths.most_common(1)[0][0] if lengths else 0


def _find_times(
    arrays: Mapping[str, np.ndarray], count: int, units: Mapping[str, str]
) -> TimeArray | None:
    """Return the array that increases from sample to sample at a rate that arms have; arrays named
    like times come first.

    An array named like times that does not increase has a `fault`: its samples are in another
    order, or repeated, and a sample rate in its place would hide that.
    """
    found = []
    called = [
        key for key, values in arrays.items() if values.shape == (count,) and TIME_NAME.search(key)
    ]
    unusable: list[RecordingError] = []
    for key in called:
        largest = np.abs(arrays[key].astype(np.float64)).max(initial=0.0)
        fitting = (size for size in NANOSECONDS.values() if largest * size < 9e18)
        size = next(fitting, None)
        if size is not None and np.isfinite(arrays[key]).all():
            stamps = np.round(size * arrays[key].astype(np.float64))
            try:
                check_stamped(stamps.astype(np.int64), key)
            except RecordingError as error:
                unusable.append(error)
    if unusable and len(unusable) == len(called):
        raise RecordingError(unusable[0].problem, _NO_TIMES)
    for key, values in arrays.items():
        # Where one is called time no other that happens to grow is.
        if values.shape != (count,) or count < 2 or (called and key not in called):
            continue
        steps = np.diff(values.astype(np.float64))
        if np.all(steps >= 0) and np.mean(steps > 0) > 0.5:
            step = float(np.median(steps[steps > 0]))
            # An index grows by one too: times that are whole milliseconds are called times.
            unit = _unit_of_times(key, step, units)
            named = bool(TIME_NAME.search(key)) or key == next(iter(arrays))
            if unit is not None and (named or np.ptp(steps) > 0):
                seconds = (values - values[0]).astype(np.float64) * (NANOSECONDS[unit] * 1e-9)
                found.append((not TIME_NAME.search(key), TimeArray(key, unit, seconds)))
    if found:
        return min(found, key=lambda pair: pair[0])[1]
    return _faulty_times(arrays, called, units)


def _unit_of_times(key: str, step: float, units: Mapping[str, str]) -> str | None:
    """Return the unit by the name of an array, or the one in which its step gives a rate that arms
    have."""
    rates = {unit: 1e9 / (step * size) for unit, size in NANOSECONDS.items()}
    likely = (unit for unit, rate in rates.items() if _RATES[0] <= rate <= _RATES[1])
    return time_unit(stated_unit(key, units.get(key, ""))) or next(likely, None)


def _faulty_times(
    arrays: Mapping[str, np.ndarray], called: Sequence[str], units: Mapping[str, str]
) -> TimeArray | None:
    """Return the first array that is named like times and has their steps, but repeats or
    decreases, with that fault."""
    for key in called:
        values = arrays[key].astype(np.float64)
        steps = np.diff(np.unique(values))
        unit = _unit_of_times(key, float(np.median(steps)), units) if len(steps) else None
        if unit is None:
            continue
        seconds = (values - values[0]) * (NANOSECONDS[unit] * 1e-9)
        try:
            check_times(np.round(seconds * 1e9).astype(np.int64), key)
        except RecordingError as error:
            return TimeArray(key, unit, seconds, error.problem)
    return None


def _whole(key: str, values: np.ndarray, count: int, n: int) -> JointTable | None:
    values = (values if values.shape[0] == count else values.T).astype(np.float64)
    width = values.shape[1]
    if width < n:
        return None
    return JointTable(
        (key,), None if width == n else tuple(range(n)), values[:, :n], available=width
    )


def _places_of(names: Sequence[str], joints: Sequence[str]) -> tuple[int, ...] | None:
    """Return which columns are those of the joints, by names such as `shoulder_pan.pos` or
    `main_shoulder_pan`; None if that of a joint is missing or not the only one."""
    found = []
    for joint in joints:
        own = re.compile(rf"(?<![a-zA-Z0-9]){re.escape(joint)}(?![a-zA-Z0-9])")
        places = [k for k, name in enumerate(names) if own.search(name)]
        if len(places) != 1:
            return None
        found += places
    return tuple(found)


def _called(table: JointTable, values: np.ndarray, places: tuple[int, ...]) -> JointTable:
    """Return a table with the columns that are called as the joints."""
    if values.ndim != 2 or max(places) >= values.shape[1]:
        return table
    whole = values[:, list(places)].astype(np.float64)
    is_all = places == tuple(range(values.shape[1]))
    return replace(
        table, columns=None if is_all else places, values=whole, available=0, called=True
    )


def _named(columns: Mapping[str, np.ndarray], joints: Sequence[str]) -> list[JointTable]:
    """Return the groups of columns whose names differ only by the name of a joint, in the order of
    the joints."""
    called = {
        **dict(zip(short_names(joints), joints, strict=True)),
        **{joint: joint for joint in joints},
    }
    longest_first = sorted(called, key=len, reverse=True)
    own = re.compile(rf"(?<![a-zA-Z0-9])({'|'.join(map(re.escape, longest_first))})(?![a-zA-Z0-9])")
    groups: dict[str, dict[str, str]] = {}
    for key in columns:
        if (match := own.search(key)) is not None:
            groups.setdefault(f"{key[: match.start()]}*{key[match.end() :]}", {})[
                called[match[0]]
            ] = key
    complete = {
        pattern: members for pattern, members in groups.items() if len(members) == len(joints) > 1
    }
    found = []
    for pattern, members in complete.items():
        keys = tuple(members[joint] for joint in joints)
        found.append(
            JointTable(
                keys, None, np.column_stack([columns[k].astype(np.float64) for k in keys]), pattern
            )
        )
    return found


def _counted(columns: Mapping[str, np.ndarray], n: int) -> list[JointTable]:
    """Return the groups of columns whose names differ only by a number, in the order of the
    numbers."""
    groups: dict[tuple[str, str], dict[int, str]] = {}
    for key in columns:
        if (match := _COUNTED.match(key)) is not None:
            groups.setdefault((match[1], match[3]), {})[int(match[2])] = key
    tables = []
    for stem, members in groups.items():
        keys = [members[number] for number in sorted(members)]
        # Columns without names hold several quantities one after the other; a counted name is one
        # quantity.
        parts = (
            [keys[k : k + n] for k in range(0, len(keys), n)] if stem == ("", "") else [keys[:n]]
        )
        for part in parts:
            if len(part) == n:
                values = np.column_stack([columns[key].astype(np.float64) for key in part])
                more = 0 if stem == ("", "") else len(keys)
                tables.append(JointTable(tuple(part), None, values, available=more))
    return tables
