"""Import the arrays of a real robot as a recording, with a mapping file (docs/channel_maps.md)."""

import fnmatch
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from elastic_arm.arrays import Mask
from elastic_arm.errors import RecordingError
from elastic_arm.input_files import Number, WholeNumber, read_text
from elastic_arm.recording.foreign.array_files import FILE_INDEX, load_arrays
from elastic_arm.recording.foreign.calibration import degrees_per_cent
from elastic_arm.recording.foreign.channels import (
    DAY,
    DEFAULT_UNIT,
    DUTY_AND_TORQUE,
    DUTY_OF_COUPLED,
    MOST_JOINTS,
    NANOSECONDS,
    SIDE_NAMES,
    TO_SI,
    ChannelName,
    ChannelScale,
    Coupling,
    Present,
    SideName,
    Sign,
    Strict,
    Unit,
    check_sides,
    coupled,
    coupling_matrix,
    from_currents,
    known_unit,
    load_model,
    stated_unit,
    time_unit,
)
from elastic_arm.recording.foreign.text_tables import Arrays
from elastic_arm.recording.inspection.report import REPAIR, checked
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, Stamps, joints_with

MEND = (
    "Correct these samples in the file: times have to increase (sort the rows, remove repeated"
    " ones, export times in double precision), and numbers have to be finite."
)
# The columns of a table without names are called by their numbers.
Key = Annotated[str, BeforeValidator(lambda key: str(key) if type(key) is int else key)]


Gain = Annotated[Number, Field(gt=0)]


class Times(Strict):
    """Where the times come from: an array, or a constant rate."""

    key: Key | None = None  # name of the array
    unit: Literal["s", "ms", "us", "ns", "d"] = "s"  # of its numbers
    rate: Annotated[Number, Field(gt=1e-6, lt=1e9)] | None = None  # hz, where there is no array
    start: Annotated[Number, Field(ge=0, lt=2**31)] = (
        0.0  # unix seconds of the first sample, with `rate`
    )

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if (self.key is None) == (self.rate is None):
            raise ValueError("give either a key or a rate")
        return self


class Rows(Strict):
    """Selects runs from arrays that contain several: the rows of a run have the same number in
    array `key`."""

    key: Key
    value: WholeNumber | list[WholeNumber] | None = None  # of one run, or of several; all when None


class ArrayChannel(Strict):
    """One channel of all joints, or of some."""

    # name of an array with one column a joint, or one name a joint
    key: Key | Annotated[list[Key], Field(min_length=1)]
    # those that have the channel; all by default. What is given a joint is given for these.
    joints: Annotated[list[str], Field(min_length=1)] | None = None
    # columns of the array, one a joint; all by default
    columns: Annotated[list[Annotated[WholeNumber, Field(ge=0)]], Field(min_length=1)] | None = None
    # the array holds the numbers of all joints one after the other, sample by sample: one a line of
    # a text file
    flat: bool = False
    # unit, offset, factor, sign, torque_constant, ratio, full_scale: as in a channel map; one for
    # all joints, or one a joint, as where some of them slide (null for those without)
    unit: Unit | list[Unit] | None = None
    offset: Number | list[Number] = 0.0
    factor: Number | list[Number] = 1.0
    sign: Sign | list[Sign] = 1
    torque_constant: Number | list[Number | None] | None = None
    ratio: Number | list[Number | None] | None = None
    full_scale: Number | list[Number | None] | None = None  # of pwm

    @model_validator(mode="after")
    def _one_layout(self) -> Self:
        if self.flat and (self.columns is not None or not isinstance(self.key, str)):
            raise ValueError("flat requires a single key and no columns")
        return self

    def arrays(self) -> list[str]:
        """Return the names of all arrays used."""
        return [self.key] if isinstance(self.key, str) else self.key

    def places(self, joints: Sequence[str]) -> list[int]:
        """Return which of all joints have the channel."""
        own = self.joints or list(joints)
        if unknown := [name for name in own if name not in joints]:
            raise ValueError(
                f"unknown joint {', '.join(unknown)}; the joints are {', '.join(joints)}"
            )
        if len(set(own)) < len(own):
            raise ValueError(f"joints {', '.join(own)}: duplicate name")
        return [list(joints).index(name) for name in own]

    def scales(self, channel: ChannelName, n: int) -> list[ChannelScale]:
        """Return for each of n joints how its numbers are converted to SI units at the
        harmonic-drive output."""
        names = ("unit", "offset", "factor", "sign", "torque_constant", "ratio", "full_scale")
        given = {name: getattr(self, name) for name in names}
        for name, value in given.items():
            if isinstance(value, list) and len(value) != n:
                raise ValueError(f"{channel}.{name} has {len(value)} values for {n} joints")
        found = []
        for joint in range(n):
            own = {k: v[joint] if isinstance(v, list) else v for k, v in given.items()}
            scale = ChannelScale(**own)
            scale.check_unit(channel)
            found.append(scale)
        return found


class SideArrays(Present):
    """The channels of one side."""

    times: Times | None = None  # of its samples, where they are its own
    position: ArrayChannel | None = None
    velocity: ArrayChannel | None = None
    effort: ArrayChannel | None = None
    # duty that servos applied, and voltage of their supply, of the motor side alone
    pwm: ArrayChannel | None = None
    supply: ArrayChannel | None = None


class CommandArrays(SideArrays):
    """The commands of the arm. Accelerations of measured sides are derived quantities and not
    imported."""

    acceleration: ArrayChannel | None = None


class ArrayMap(Strict):
    """A mapping of arrays to a recording, or to several runs."""

    times: Times  # of the samples
    joints: Annotated[
        list[str], Field(min_length=1, max_length=MOST_JOINTS)
    ]  # names, in robot-description order
    link: SideArrays = SideArrays()  # link, motor: the channels of each side
    motor: SideArrays = SideArrays()
    command: CommandArrays = CommandArrays()  # what the arm was told, the recording's reference
    rows: Rows | None = (
        None  # runs of several, such as the episodes of a dataset; all rows are one when None
    )
    every: Annotated[WholeNumber, Field(ge=1)] = 1  # of the rows each so many-th is taken
    decimal: Literal[".", ","] = "."  # mark of tables as text
    # arrays that are left out on purpose, `*` and `?` as in file names; any other that is not
    # mapped is an error
    ignore: Annotated[list[str], Field(default_factory=list)]
    robot_description: str | None = (
        None  # URDF file to put into the bag; relative to the mapping file
    )
    # LeRobot's calibration file, by which positions without a unit are per cent of ranges; relative
    # to the mapping file
    calibration: str | None = None
    # of motors that move several joints: joint -> motor -> factor
    coupling: Coupling = Field(default_factory=dict)
    # number in the servos' register of the position gain during the runs: one of all joints, or by
    # joint
    firmware_gain: Gain | dict[str, Gain] | None = None
    # torque channels that were computed from currents before
    from_currents: Annotated[
        list[Literal["joint_torque", "motor_torque"]], Field(default_factory=list)
    ]

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: duplicate name")
        if not self.link.present() and not self.motor.present():
            raise ValueError("neither link nor motor has a channel")
        for _, name, channel in self.channels():
            channel.scales(name, len(channel.places(self.joints)))
        self._check_duty()
        coupling_matrix(self.coupling, self.joints)
        if unknown := [name for name in self.firmware_gains() if name not in self.joints]:
            raise ValueError(
                f"firmware_gain: unknown joint {unknown[0]}; the joints are"
                f" {', '.join(self.joints)}"
            )
        return self

    def _check_duty(self) -> None:
        check_sides({side: getattr(self, side).present() for side in ("link", "command")})
        duty = self.motor.pwm
        if duty is None:
            return
        if self.coupling:
            raise ValueError(DUTY_OF_COUPLED)
        effort = self.motor.effort
        if effort is not None and set(effort.places(self.joints)) & set(duty.places(self.joints)):
            raise ValueError(DUTY_AND_TORQUE)

    def firmware_gains(self) -> dict[str, float]:
        """Return the numbers in the servos' registers of the position gain, by joint."""
        if self.firmware_gain is None:
            return {}
        if isinstance(self.firmware_gain, dict):
            return self.firmware_gain
        return dict.fromkeys(self.joints, self.firmware_gain)

    def channels(self) -> Iterator[tuple[SideName, ChannelName, ArrayChannel]]:
        """Yield the channels of all sides."""
        for side in SIDE_NAMES:
            yield from (
                (side, name, channel) for name, channel in getattr(self, side).present().items()
            )

    def currents(self) -> tuple[str, ...]:
        """Return which torque channels, by their names in a recording, are currents at any
        joint."""
        units = (None if own is None else own.unit for own in (self.link.effort, self.motor.effort))
        found = from_currents(*(unit if isinstance(unit, list) else [unit] for unit in units))
        return tuple(dict.fromkeys((*self.from_currents, *found)))

    def times_of(self, side: SideName) -> Times:
        """Return the source of the times of a side."""
        return getattr(self, side).times or self.times


def load_array_map(path: str | Path) -> ArrayMap:
    """Read a mapping file (YAML)."""
    return load_model(ArrayMap, path, "mapping")


def import_arrays(path: str | Path, mapping: str | Path) -> Recording:
    """Make a recording of a file of arrays, or of all files of a folder."""
    runs = import_runs(path, mapping)
    if len(runs) > 1:
        raise RecordingError(
            f"{path} contains {len(runs)} runs", "Give the number of one run under rows.value."
        )
    return next(iter(runs.values()))


def import_runs(
    path: str | Path, mapping: str | Path, calibration: str | Path | None = None
) -> dict[str, Recording]:
    """Make recordings of a file or folder of arrays, by the names of the runs; one alone has an
    empty name.

    calibration: LeRobot's calibration file, instead of the one that the mapping states.
    """
    rules = load_array_map(mapping)
    if calibration is not None:
        rules = rules.model_copy(update={"calibration": str(Path(calibration).absolute())})
    rules = _calibrated(rules, Path(mapping).parent)
    arrays = load_arrays(Path(path), rules.decimal)
    urdf = None
    if rules.robot_description is not None:
        file = Path(mapping).parent / rules.robot_description
        urdf = read_text(
            file,
            RecordingError,
            f"Correct robot_description in {mapping}: the path is relative to its folder.",
        )
    try:
        _refuse_strays(arrays, rules)
        notes: list[str] = []
        sides = {
            side: _read_side(arrays, rules, side, notes)
            for side in SIDE_NAMES
            if getattr(rules, side).present()
        }
        runs = {name: _recording(rules, sides, rows) for name, rows in _runs(arrays, rules)}
    except RecordingError as error:
        # There is no bag yet that could be repaired.
        remedy = MEND if REPAIR in error.remedy else error.remedy
        raise RecordingError(f"{path}: {error.problem}", remedy) from None
    return {
        name: replace(
            run, robot_description=urdf, source=f"{path} {name}".strip(), notes=(*notes, *run.notes)
        )
        for name, run in runs.items()
    }


@dataclass(frozen=True)
class _SideTable:
    """All rows of a side: times, or row numbers if a rate is given, and channels in SI units."""

    rules: Times
    times: np.ndarray
    channels: Mapping[ChannelName, Array]


def _refuse_strays(arrays: Arrays, rules: ArrayMap) -> None:
    used = {key for _, _, channel in rules.channels() for key in channel.arrays()}
    used |= {times.key for side in SIDE_NAMES if (times := rules.times_of(side)).key is not None}
    used |= {rules.rows.key} if rules.rows is not None else set()
    if missing := sorted(used - set(arrays)):
        problem = f"no array {', '.join(missing)}; the arrays are {', '.join(arrays)}"
        raise RecordingError(problem, "Correct the names in the mapping.")
    numbers = {
        name
        for name, values in arrays.items()
        if values.dtype.kind in "iufc" and name != FILE_INDEX
    }
    # A bracket in a pattern may be one of the name: columns are called `Time [ms]`.
    patterns = [*rules.ignore, *(pattern.replace("[", "[[]") for pattern in rules.ignore)]
    ignored = {name for pattern in patterns for name in fnmatch.filter(numbers, pattern)}
    left = numbers - used - ignored
    strays = sorted(name for name in left if not _other_form(name, arrays, used))
    if strays:
        problem = f"arrays {', '.join(strays)} are not mapped"
        raise RecordingError(problem, "Map them, or list them under 'ignore' in the mapping.")


def _other_form(name: str, arrays: Mapping[str, np.ndarray], used: Collection[str]) -> bool:
    """Return whether an unused array contains the same data as a used one, under another name.

    A table without names in a folder is available as `file`, and by columns as `file.0`, `file.1` …
    """
    whole, _, column = name.rpartition(".")
    if column.isdecimal() and whole in arrays:
        # Of a table that is used by some columns the others are strays; of one that is not used it
        # is one by itself.
        return whole in used or not any(key.startswith(f"{whole}.") for key in used)
    return f"{name}.0" in arrays and any(key.rpartition(".")[0] == name for key in used)


def _calibrated(rules: ArrayMap, folder: Path) -> ArrayMap:
    """Return a mapping with the units of positions that are per cent of calibrated ranges."""
    if rules.calibration is None:
        return rules
    sides: dict[str, SideArrays] = {}
    for side in SIDE_NAMES:
        own = getattr(rules, side)
        channel = own.position
        if channel is None or channel.unit is not None:
            continue
        joints = channel.joints or rules.joints
        sizes = degrees_per_cent(folder / rules.calibration, joints)
        given = channel.factor if isinstance(channel.factor, list) else None
        factors = given or [channel.factor] * len(joints)
        scaled = [sizes[name] * by for name, by in zip(joints, factors, strict=True)]
        stated = channel.model_copy(update={"unit": "deg", "factor": scaled})
        sides[side] = own.model_copy(update={"position": stated})
    return rules.model_copy(update=sides)


def _in_stated_unit(
    channel: ArrayChannel, name: ChannelName, arrays: Arrays, n: int
) -> tuple[ArrayChannel, list[str]]:
    """Give a channel without a unit the units that its column names or a row of units state; note
    those that differ."""
    if name == "pwm":  # `%` in its name is no unit, but tells what its full scale is
        return channel, []
    keys = channel.arrays()
    words = [stated_unit(key, arrays.units.get(key, "")) for key in keys]
    known = [known_unit(word) or ("", 1.0) for word in words]
    if channel.unit is not None:
        units = channel.unit if isinstance(channel.unit, list) else [channel.unit] * len(keys)
        others = [
            f"{key} is in {word} according to its name, but the mapping gives {unit}"
            for key, word, found, unit in zip(keys, words, known, units, strict=False)
            if word
            and not (found[0] and unit.startswith(found[0]) and found[1] == 1.0)
            and channel.factor == 1.0
        ]
        return channel, others
    if not any(words):
        return channel, []
    for key, word, (unit, _) in zip(keys, words, known, strict=True):
        if word and (unit not in TO_SI[name] or unit == "A"):
            raise RecordingError(
                f"{key} is in {word}",
                f"Give {name} a unit in the mapping, and the values that the unit requires.",
            )
    known = [
        found if word else (DEFAULT_UNIT[name], 1.0)
        for word, found in zip(words, known, strict=True)
    ]
    known = known * n if len(known) == 1 else known
    factors = channel.factor if isinstance(channel.factor, list) else [channel.factor] * n
    scaled = [factor * size for factor, (_, size) in zip(factors, known, strict=False)]
    return channel.model_copy(update={"unit": [unit for unit, _ in known], "factor": scaled}), []


def _read_side(arrays: Arrays, rules: ArrayMap, side: SideName, notes: list[str]) -> _SideTable:
    """Read all rows of a side."""
    times = rules.times_of(side)
    channels = getattr(rules, side).present()
    if times.key is None:
        channel = next(iter(channels.values()))
        first = arrays[channel.arrays()[0]]
        size = (
            first.size // len(channel.places(rules.joints))
            if channel.flat
            else max(first.shape, default=1)
        )
        values = np.arange(size)
    else:
        values = np.asarray(arrays[times.key]).ravel()
        if values.dtype.kind not in "iuf":
            raise RecordingError(
                f"{times.key} contains no numbers", "Give the array of times in the mapping."
            )
        if "unit" not in times.model_fields_set:
            word = stated_unit(times.key, arrays.units.get(times.key, ""))
            times = times.model_copy(update={"unit": time_unit(word) or "s"})
        if times.unit == DAY and len(values):
            # They count from the year 0 or 1900: the time of day is kept.
            values = values - np.floor(values[0])
        # Beyond this 64 bits of nanoseconds, and the stamps of ROS, hold no time.
        late = np.abs(values.astype(np.float64)) >= 2**31 * 1e9 / NANOSECONDS[times.unit]
        if late.any():
            row = int(np.argmax(late))
            problem = (
                f"{times.key} is {values[row]} {times.unit} in row {row}; stamps end at 2^31 s, in"
                " 2038"
            )
            raise RecordingError(problem, "Correct the unit under times, or subtract a constant.")
    tables = {}
    for name, channel in channels.items():
        places = channel.places(rules.joints)
        channel, others = _in_stated_unit(channel, name, arrays, len(places))
        notes += others
        table = _table(arrays, channel, len(values), len(places))
        tables[name] = np.full((len(values), len(rules.joints)), np.nan)
        for i, (place, scale) in enumerate(
            zip(places, channel.scales(name, len(places)), strict=True)
        ):
            tables[name][:, place] = scale.applied(table[:, i], name)
    return _SideTable(times, values, tables)


def _runs(arrays: Mapping[str, np.ndarray], rules: ArrayMap) -> list[tuple[str, Mask | None]]:
    """Return the runs by name, each with its rows; None for all rows."""
    if rules.rows is None:
        return [("", None)]
    key = rules.rows.key
    value = rules.rows.value
    numbers = np.asarray(arrays[key]).ravel()
    known = np.unique(numbers)
    wanted = known.tolist()
    if value is not None:
        wanted = value if isinstance(value, list) else [value]
    if missing := [number for number in wanted if number not in known]:
        shown = ", ".join(f"{number:g}" for number in known[:8])
        raise RecordingError(
            f"no row has {key} {missing[0]}", f"Choose one of {shown} under rows.value."
        )
    return [
        (f"{key}_{number:g}" if len(wanted) > 1 else "", numbers == number) for number in wanted
    ]


def _recording(
    rules: ArrayMap, tables: Mapping[SideName, _SideTable], chosen: Mask | None
) -> Recording:
    """Build the recording of one run; rows with missing numbers are omitted from their side."""
    notes: list[str] = []
    sides: dict[str, Side | None] = dict.fromkeys(SIDE_NAMES)
    for side, table in tables.items():
        if chosen is not None and len(chosen) != len(table.times):
            problem = (
                f"the {side} side has {len(table.times)} rows, but the array of the runs"
                f" {len(chosen)}"
            )
            raise RecordingError(problem, "Choose another array under rows.key.")
        rows = (np.arange(len(table.times)) if chosen is None else np.flatnonzero(chosen))[
            :: rules.every
        ]
        times = table.times[rows]
        values = {name: channel[rows] for name, channel in table.channels.items()}
        whole = ~np.isnan(times) if times.dtype.kind == "f" else np.ones(len(rows), np.bool_)
        for channel in values.values():
            whole &= ~np.isnan(channel[:, joints_with(channel)]).any(axis=1)
        if not whole.any() and len(whole):
            raise RecordingError(f"no row is complete on the {side} side", "Map fewer channels.")
        if not whole.all():
            notes.append(
                f"{np.sum(~whole)} of {len(whole)} rows have missing values on the {side} side"
                " and were skipped"
            )
        stamp_ns = _stamps(times[whole], table.rules, int(rows[0]) if len(rows) else 0)
        sides[side] = checked(
            Side(stamp_ns, **{k: v[whole] for k, v in values.items()}), side, rules.joints
        )
    return Recording(
        tuple(rules.joints),
        sides["link"],
        coupled(sides["motor"], coupling_matrix(rules.coupling, rules.joints)),
        sides["command"],
        notes=tuple(notes),
        currents=rules.currents(),
        firmware_gains=rules.firmware_gains(),
    )


def _stamps(values: np.ndarray, times: Times, first: int) -> Stamps:
    """Return the times (N,) in ns."""
    if times.key is None:
        return round(times.start * 1e9) + np.rint(
            (values - first) * (1e9 / float(times.rate or 1))
        ).astype(np.int64)
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * NANOSECONDS[times.unit]
    # Whole units and the rest apart: unix seconds times 1e9 would lose the last bits.
    whole = np.floor(values)
    rest = np.rint((values - whole) * NANOSECONDS[times.unit]).astype(np.int64)
    return whole.astype(np.int64) * NANOSECONDS[times.unit] + rest


def _table(arrays: Arrays, source: ArrayChannel, count: int, n: int) -> Array:
    """(count, n) numbers of a channel; an array with samples along its second axis is turned."""
    keys = source.arrays()
    for key in keys:
        if key in arrays.faults:
            raise RecordingError(
                f"{key}: {arrays.faults[key]}", "Write nan, or leave missing values empty."
            )
        if arrays[key].dtype.kind not in "biuf":
            first = f"{arrays[key].ravel()[:1].tolist()!s:.80}"
            problem = f"{key} is not a table of numbers but of {arrays[key].dtype.name}: {first}"
            raise RecordingError(problem, "Map arrays of real numbers.")
    try:
        parts = [np.asarray(arrays[key], dtype=np.float64) for key in keys]
        table = parts[0] if len(parts) == 1 else np.column_stack([part.ravel() for part in parts])
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"{', '.join(keys)} is not a table of numbers ({error})", "Map arrays of numbers."
        ) from None
    if source.flat and table.size == count * n:
        table = table.reshape(count, n)
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim == 2 and table.shape[0] != count and table.shape[1] == count:
        table = table.T
    if source.columns is not None and table.ndim == 2 and max(source.columns) < table.shape[1]:
        table = table[:, source.columns]
    if table.shape != (count, n):
        remedy = "Give one column per joint ('columns', or a list of keys), and the correct times."
        if (
            1 in table.shape
            and n > 1
            and table.size % n == 0
            and len(keys) == 1
            and not source.flat
        ):
            remedy += (
                f" If it contains {n} numbers per sample one after the other, add flat: true"
                " to the channel."
            )
        problem = (
            f"{', '.join(keys)} has shape {table.shape}; expected {count} samples of {n} joints"
        )
        raise RecordingError(problem, remedy)
    return table
