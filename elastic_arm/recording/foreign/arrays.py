"""Arrays of a real robot as a recording, by a small mapping file (docs/channel_maps.md)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import Number, WholeNumber, read_text
from elastic_arm.recording.foreign.array_files import load_arrays
from elastic_arm.recording.foreign.channels import (
    CHANNEL_NAMES,
    MOST_JOINTS,
    ChannelName,
    ChannelScale,
    Sign,
    Strict,
    Unit,
    from_currents,
    load_yaml,
    validated,
)
from elastic_arm.recording.foreign.coupling import Coupling, coupled, coupling_matrix
from elastic_arm.recording.inspection.quality import REPAIR, checked
from elastic_arm.recording.recording import Recording
from elastic_arm.recording.sides import Array, Side, Stamps

MEND = "Mend these samples in the file: times have to advance, and numbers to be finite."
_NS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
# The columns of a table without names are called by their numbers.
Key = Annotated[str, BeforeValidator(lambda key: str(key) if type(key) is int else key)]


class Times(Strict):
    """Where the times come from: an array, or a constant rate."""

    key: Key | None = None  # name of the array
    unit: Literal["s", "ms", "us", "ns"] = "s"  # of its numbers
    rate: Annotated[Number, Field(gt=1e-6, lt=1e9)] | None = None  # hz, where there is no array
    start: Annotated[Number, Field(ge=0, lt=2**31)] = 0.0  # unix seconds of the first sample, with `rate`

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if (self.key is None) == (self.rate is None):
            raise ValueError("give either key or rate")
        return self


class Rows(Strict):
    """Which rows are taken of arrays that hold several runs: those where array `key` is `value`, as an episode's."""

    key: Key
    value: WholeNumber


class ArrayChannel(Strict):
    """One channel of all joints, or of some."""

    # name of an array with one column a joint, or one name a joint
    key: Key | Annotated[list[Key], Field(min_length=1)]
    # those that have the channel; all by default. What is given a joint is given for these.
    joints: Annotated[list[str], Field(min_length=1)] | None = None
    # columns of the array, one a joint; all by default
    columns: Annotated[list[Annotated[WholeNumber, Field(ge=0)]], Field(min_length=1)] | None = None
    # the array holds the numbers of all joints one after the other, sample by sample: one a line of a text file
    flat: bool = False
    # unit, offset, factor, sign, torque_constant, ratio: as in a channel map; one for all joints, or one a joint, as
    # where some of them slide (null for those without)
    unit: Unit | list[Unit] | None = None
    offset: Number | list[Number] = 0.0
    factor: Number | list[Number] = 1.0
    sign: Sign | list[Sign] = 1
    torque_constant: Number | list[Number | None] | None = None
    ratio: Number | list[Number | None] | None = None

    @model_validator(mode="after")
    def _one_layout(self) -> Self:
        if self.flat and (self.columns is not None or not isinstance(self.key, str)):
            raise ValueError("flat takes one key, and no columns")
        return self

    def arrays(self) -> list[str]:
        """Return the names of all arrays used."""
        return [self.key] if isinstance(self.key, str) else self.key

    def places(self, joints: Sequence[str]) -> list[int]:
        """Return which of all joints have the channel."""
        own = self.joints or list(joints)
        if unknown := [name for name in own if name not in joints]:
            raise ValueError(f"there is no joint {', '.join(unknown)}; there are {', '.join(joints)}")
        if len(set(own)) < len(own):
            raise ValueError(f"joints {', '.join(own)}: a name occurs twice")
        return [list(joints).index(name) for name in own]

    def scales(self, channel: ChannelName, n: int) -> list[ChannelScale]:
        """Return how each of n joints' numbers become ones in SI units at the harmonic-drive output."""
        names = ("unit", "offset", "factor", "sign", "torque_constant", "ratio")
        given = {name: getattr(self, name) for name in names}
        for name, value in given.items():
            if isinstance(value, list) and len(value) != n:
                raise ValueError(f"{channel}.{name} has {len(value)} values for {n} joints")
        of_joint = [
            ChannelScale(**{k: v[joint] if isinstance(v, list) else v for k, v in given.items()}) for joint in range(n)
        ]
        for scale in of_joint:
            scale.check_unit(channel)
        return of_joint


class SideArrays(Strict):
    """The channels of one side."""

    position: ArrayChannel | None = None
    velocity: ArrayChannel | None = None
    effort: ArrayChannel | None = None

    def present(self) -> dict[ChannelName, ArrayChannel]:
        """Return the channels that are there."""
        return {name: channel for name in CHANNEL_NAMES if (channel := getattr(self, name)) is not None}


class ArrayMap(Strict):
    """A mapping of arrays to a recording."""

    times: Times  # of the samples
    joints: Annotated[list[str], Field(min_length=1, max_length=MOST_JOINTS)]  # names, in robot-description order
    link: SideArrays = SideArrays()  # link, motor: the channels of each side
    motor: SideArrays = SideArrays()
    rows: Rows | None = None  # one run of several, such as an episode of a dataset; all rows when None
    # arrays that are left out on purpose, `*` and `?` as in file names; any other that is not mapped is an error
    ignore: Annotated[list[str], Field(default_factory=list)]
    robot_description: str | None = None  # URDF file to put into the bag; relative to the mapping file
    coupling: Coupling = Field(default_factory=dict)  # of motors that move several joints: joint -> motor -> factor

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints: a name occurs twice")
        if not self.link.present() and not self.motor.present():
            raise ValueError("neither link nor motor has a channel")
        for side in (self.link, self.motor):
            for name, channel in side.present().items():
                channel.scales(name, len(channel.places(self.joints)))
        coupling_matrix(self.coupling, self.joints)
        return self

    def currents(self) -> tuple[str, ...]:
        """Return the torque channels, by the names of a recording, that are currents of any joint."""
        units = (None if own is None else own.unit for own in (self.link.effort, self.motor.effort))
        return from_currents(*(unit if isinstance(unit, list) else [unit] for unit in units))


def load_array_map(path: str | Path) -> ArrayMap:
    """Read a mapping file (YAML)."""
    return validated(ArrayMap, load_yaml(path, "mapping"), path)


def import_arrays(path: str | Path, mapping: str | Path) -> Recording:
    """Make a recording of a file of arrays."""
    arrays, rules = load_arrays(Path(path)), load_array_map(mapping)
    try:
        _refuse_strays(arrays, rules)
        arrays = _of_run(arrays, rules.rows)
        stamp_ns = _stamps(arrays, rules)
        link = _side(arrays, rules, "link", stamp_ns)
        motor = coupled(_side(arrays, rules, "motor", stamp_ns), coupling_matrix(rules.coupling, rules.joints))
    except RecordingError as error:
        # There is no bag yet that could be repaired.
        remedy = MEND if REPAIR in error.remedy else error.remedy
        raise RecordingError(f"{path}: {error.problem}", remedy) from None
    urdf = None
    if rules.robot_description is not None:
        file = Path(mapping).parent / rules.robot_description
        urdf = read_text(file, RecordingError, f"Mend robot_description in {mapping}: a path beside that file.")
    return Recording(
        tuple(rules.joints), link, motor, robot_description=urdf, source=str(path), currents=rules.currents()
    )


def _of_run(arrays: dict[str, np.ndarray], rows: Rows | None) -> dict[str, np.ndarray]:
    """Return the rows of one run."""
    if rows is None:
        return arrays
    numbers = np.asarray(arrays[rows.key]).ravel()
    chosen = numbers == rows.value
    if not chosen.any():
        known = ", ".join(f"{number:g}" for number in np.unique(numbers)[:8])
        raise RecordingError(f"no row has {rows.key} {rows.value}", f"Take one of {known} under rows.value.")
    return {name: values[chosen] if len(values) == len(chosen) else values for name, values in arrays.items()}


def _refuse_strays(arrays: Mapping[str, np.ndarray], rules: ArrayMap) -> None:
    sides = (rules.link, rules.motor)
    used = {key for side in sides for channel in side.present().values() for key in channel.arrays()}
    used |= {rules.times.key} if rules.times.key is not None else set()
    used |= {rules.rows.key} if rules.rows is not None else set()
    known = ", ".join(arrays)
    if missing := sorted(used - set(arrays)):
        raise RecordingError(f"no array {', '.join(missing)}; there is {known}", "Correct the names in the mapping.")
    left = {name for name in arrays if not _other_form(name, arrays, used)} - used
    if strays := sorted(name for name in left if not any(fnmatchcase(name, pattern) for pattern in rules.ignore)):
        raise RecordingError(
            f"arrays {', '.join(strays)} are not mapped", "Map them, or list them under 'ignore' in the mapping."
        )


def _other_form(name: str, arrays: Mapping[str, np.ndarray], used: Collection[str]) -> bool:
    """Return whether an array that is not used is another form of one that is, or of one that names it shorter.

    A table without names in a folder is there as `file`, and by columns as `file.0`, `file.1` …
    """
    whole, _, column = name.rpartition(".")
    if column.isdecimal() and whole in arrays:
        # Of a table that is used by some columns the others are strays; of one that is not used it is one by itself.
        return whole in used or not any(key.startswith(f"{whole}.") for key in used)
    return f"{name}.0" in arrays and any(key.rpartition(".")[0] == name for key in used)


def _stamps(arrays: Mapping[str, np.ndarray], rules: ArrayMap) -> Stamps:
    times = rules.times
    if times.key is None:
        side = rules.link if rules.link.present() else rules.motor
        channel = next(iter(side.present().values()))
        first = arrays[channel.arrays()[0]]
        n = len(channel.places(rules.joints))
        count = first.size // n if channel.flat else max(first.shape, default=1)
        return round(times.start * 1e9) + np.rint(np.arange(count) * (1e9 / float(times.rate or 1))).astype(np.int64)
    values = np.asarray(arrays[times.key]).ravel()
    if values.dtype.kind not in "iuf":
        raise RecordingError(f"{times.key} holds no numbers", "Name the array of times in the mapping.")
    _refuse_late(times.key, values, times.unit)
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * int(_NS[times.unit])
    if not np.isfinite(values).all():
        raise RecordingError(f"{times.key} is not finite in row {int(np.argmin(np.isfinite(values)))}")
    # Whole units and the rest apart: unix seconds times 1e9 would lose the last bits.
    whole = np.floor(values)
    rest = np.rint((values - whole) * _NS[times.unit]).astype(np.int64)
    return whole.astype(np.int64) * int(_NS[times.unit]) + rest


def _refuse_late(key: str, values: np.ndarray, unit: str) -> None:
    """Raise if a time is beyond what 64 bits of nanoseconds, and the stamps of ROS, hold."""
    limit = 2**31 * 1e9 / _NS[unit]
    late = np.abs(values.astype(np.float64)) >= limit
    if late.any():
        row = int(np.argmax(late))
        raise RecordingError(
            f"{key} is {values[row]} {unit} in row {row}; stamps end at 2^31 s, in January 2038",
            "Give the right unit under times, or subtract a constant.",
        )


def _side(
    arrays: Mapping[str, np.ndarray], rules: ArrayMap, name: Literal["link", "motor"], stamp_ns: Stamps
) -> Side | None:
    channels: dict[ChannelName, ArrayChannel] = getattr(rules, name).present()
    if not channels:
        return None
    n = len(rules.joints)
    values: dict[str, Any] = {}
    for channel, source in channels.items():
        places = source.places(rules.joints)
        table = _table(arrays, source, len(stamp_ns), len(places))
        values[channel] = np.full((len(stamp_ns), n), np.nan)
        for i, (place, scale) in enumerate(zip(places, source.scales(channel, len(places)), strict=True)):
            values[channel][:, place] = scale.applied(table[:, i], channel)
    return checked(Side(stamp_ns, **values), name, rules.joints)


def _table(arrays: Mapping[str, np.ndarray], source: ArrayChannel, count: int, n: int) -> Array:
    """(count, n) numbers of a channel; an array with samples along its second axis is turned."""
    keys = source.arrays()
    for key in keys:
        if arrays[key].dtype.kind not in "biuf":
            raise RecordingError(
                f"{key} is no table of numbers, but of {arrays[key].dtype.name}", "Map arrays of real numbers."
            )
    try:
        parts = [np.asarray(arrays[key], dtype=np.float64) for key in keys]
        table = parts[0] if len(parts) == 1 else np.column_stack([part.ravel() for part in parts])
    except (TypeError, ValueError) as error:
        raise RecordingError(f"{', '.join(keys)} is no table of numbers ({error})", "Map arrays of numbers.") from None
    if source.flat and table.size == count * n:
        table = table.reshape(count, n)
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim == 2 and table.shape[0] != count and table.shape[1] == count:
        table = table.T
    if source.columns is not None and table.ndim == 2 and max(source.columns) < table.shape[1]:
        table = table[:, source.columns]
    if table.shape != (count, n):
        remedy = "Name one column a joint ('columns', or a list of keys), and the right times."
        if 1 in table.shape and n > 1 and table.size % n == 0 and len(keys) == 1 and not source.flat:
            remedy += f" If it holds {n} numbers a sample one after the other, add flat: true to the channel."
        raise RecordingError(
            f"{', '.join(keys)} has shape {table.shape}; {count} samples of {n} joints are wanted", remedy
        )
    return table
