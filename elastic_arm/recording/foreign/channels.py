"""Channel maps: the names, units and scales of the channels of a foreign bag
(docs/channel_maps.md)."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from elastic_arm.errors import RecordingError
from elastic_arm.input_files import Number, WholeNumber, explain, read_fields, refuse_truth
from elastic_arm.recording.sides import MOST_DUTY, Array, Side
from elastic_arm.recording.storage.metadata import TORQUE_CHANNELS
from elastic_arm.recording.topics import OF_MOTOR

SideName = Literal["link", "motor", "command"]
SIDE_NAMES: tuple[SideName, ...] = ("link", "motor", "command")
ChannelName = Literal["position", "velocity", "effort", "acceleration", "pwm", "supply"]
Unit = Literal[
    "rad", "deg", "turns", "rad/s", "deg/s", "turns/s", "rpm", "Nm", "Nm_motor", "A", "m", "mm",
    "m/s", "mm/s", "N", "rad/s^2", "deg/s^2", "m/s^2", "V",
]  # fmt: skip
# Of motors that move several joints at once, as in a wrist: joint -> motor -> how much the joint
# turns for one turn of the motor, both at the joint's output.
Coupling = dict[str, dict[str, Number]]
Sign = Annotated[Literal[1, -1], BeforeValidator(refuse_truth)]
REMEDY = "See docs/channel_maps.md."
REFERENCE = "docs/channel_maps.md shows every key"
MOST_JOINTS = 1000
NOT_OF_MOTOR = "{0} under {1}: it is of the motor, list it under motor"
DUTY_AND_TORQUE = (
    "both effort and pwm of the motor: map the effort if it is a measured torque or current,"
    " otherwise pwm"
)
DUTY_OF_COUPLED = "pwm with coupling: the duties of coupled motors are not converted; leave pwm out"
CHANNEL_NAMES: tuple[ChannelName, ...] = ("position", "velocity", "effort", "pwm", "supply")

_SIZES = {"rad": 1.0, "deg": math.pi / 180, "turns": 2 * math.pi, "m": 1.0, "mm": 1e-3}
# A position's unit on a velocity means that unit per second.
TO_SI: dict[ChannelName, dict[str, float]] = {
    "position": _SIZES,
    "velocity": (
        _SIZES | {f"{unit}/s": size for unit, size in _SIZES.items()} | {"rpm": 2 * math.pi / 60}
    ),
    "effort": dict.fromkeys(("Nm", "N", "Nm_motor", "A"), 1.0),
    "acceleration": {f"{unit}/s^2": size for unit, size in _SIZES.items()},
    "pwm": {},  # a share: `full_scale` is its unit
    "supply": {"V": 1.0},
}
# How files call units beside their own names, without blanks and in small letters.
_CALLED: dict[Unit, str] = {
    "rad": "rads radian radians",
    "deg": "degs degree degrees ° º",
    "turns": "turn rev revs",
    "rad/s": "rads/s rad_s rad/sec rad*s^-1",
    "deg/s": "degs/s deg_s degrees/s deg/sec °/s º/s",
    "turns/s": "rev/s",
    "rpm": "1/min rev/min u/min",
    "Nm": "n*m n·m n.m n-m",
    "A": "amp amps",
}
# Which unit a word means, and how many of it that is.
_WRITTEN: dict[str, tuple[Unit, float]] = {unit.lower(): (unit, 1.0) for unit in get_args(Unit)}
_WRITTEN |= {word: (unit, 1.0) for unit, words in _CALLED.items() for word in words.split()}
_WRITTEN |= {"mrad": ("rad", 1e-3), "mrad/s": ("rad/s", 1e-3), "ma": ("A", 1e-3)}
_WRITTEN |= {"mnm": ("Nm", 1e-3), "knm": ("Nm", 1e3), "kn": ("N", 1e3)}
_WRITTEN |= dict.fromkeys(("ncm", "n*cm", "n·cm", "n.cm", "cnm"), ("Nm", 1e-2))
# 1 kgf is 9.80665 N; data sheets of servos state kg cm.
_WRITTEN |= dict.fromkeys(("kgcm", "kg*cm", "kg·cm", "kgf*cm", "kgf·cm"), ("Nm", 9.80665e-2))
# The unit in a column's name: in brackets, unless it is a number; in parentheses, unless it is a
# remark; at the end.
_IN_NAME = re.compile(
    r"\[\s*([^\]\d][^\]]*?)\s*\]|_((?:deg|m?rad)(?:_s)?|[mkc]?Nm|Ncm|rpm|m[mA])$"
    r"|\(\s*([^()\d][^()]*?)\s*\)|\s(?:/|in)\s+(\S.*?)\s*$"
)
_OF_A_RANGE = re.compile(r"%|‰|per ?cent|per ?mille?", re.I)
DAY = "d"  # of MATLAB's datenum and of Excel
NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 1000, "ns": 1, DAY: 86_400 * 10**9}
DEFAULT_UNIT: dict[ChannelName, Unit] = {
    "position": "rad",
    "velocity": "rad/s",
    "effort": "Nm",
    "acceleration": "rad/s^2",
    "supply": "V",
}


def stated_unit(name: str, row: str = "") -> str:
    """Return the unit in the name of a column, or in its cell of a row of units; empty if neither
    states one."""
    if row:
        return row
    for match in _IN_NAME.finditer(name):
        certain = match[1] or match[2]
        likely = match[3] or match[4]
        if certain or known_unit(likely) is not None or likely in ("s", "ms", "us", "µs", "ns"):
            return certain or likely
    share = _OF_A_RANGE.search(name)
    return "" if share is None else share[0]


def time_unit(written: str) -> str:
    """Return the unit of time for a word in a file; empty for other words."""
    word = written.lower().replace("µ", "u").replace("sec", "s")
    return word if word in NANOSECONDS else ""


def known_unit(written: str) -> tuple[Unit, float] | None:
    """Return the unit for a word in a file, and the factor between both; None for unknown words."""
    return _WRITTEN.get("".join(written.split()).lower())


class Strict(BaseModel):
    """A model that refuses unknown fields, so that a misspelt field is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ChannelScale(Strict):
    """How a recorded number is converted to SI units at the harmonic-drive output."""

    # of the recorded number; `Nm_motor` is a torque at the motor shaft, `A` a motor current.
    # Lengths and forces are those of a prismatic joint.
    unit: Unit | None = None
    offset: Number = (
        0.0  # added to the recorded number, in its own unit: less what it reads at zero
    )
    factor: Number = 1.0  # factor, sign: multiply the number
    sign: Sign = 1
    torque_constant: Annotated[Number, Field(gt=0)] | None = (
        None  # nm/A at the motor shaft; for currents
    )
    # motor turns per turn at the harmonic-drive output: what is measured at the motor shaft is
    # reduced by it. Of a prismatic joint rad of the motor per m.
    ratio: Annotated[Number, Field(gt=0)] | None = None
    full_scale: Annotated[Number, Field(gt=0)] | None = None  # recorded number of full duty; of pwm

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.factor == 0 or not math.isfinite(self.factor):
            raise ValueError("factor must be a finite number other than 0")
        if not math.isfinite(self.offset):
            raise ValueError("offset must be a finite number")
        if self.unit == "A" and (self.torque_constant is None or self.ratio is None):
            raise ValueError("unit A needs torque_constant (Nm/A at the motor shaft) and ratio")
        if self.unit == "Nm_motor" and self.ratio is None:
            raise ValueError("unit Nm_motor (torque at the motor shaft) needs ratio")
        if self.unit in ("Nm", "N") and self.ratio is not None:
            raise ValueError(
                "a torque with a ratio is measured at the motor shaft: set unit Nm_motor"
            )
        if self.torque_constant is not None and self.unit != "A":
            raise ValueError("torque_constant requires unit A")
        return self

    def check_unit(self, channel: ChannelName) -> None:
        """Raise a ValueError if the unit, or the scale in its place, does not fit the channel."""
        if channel == "pwm":
            self._check_duty()
            return
        if self.full_scale is not None:
            raise ValueError(f"full_scale is the number of full duty: {channel} has none, only pwm")
        if channel == "supply" and self.ratio is not None:
            raise ValueError("supply is a voltage and has no ratio")
        if self.unit is not None and self.unit not in TO_SI[channel]:
            raise ValueError(
                f"{channel} cannot have unit {self.unit}; choose one of {', '.join(TO_SI[channel])}"
            )

    def _check_duty(self) -> None:
        for name in ("unit", "torque_constant", "ratio"):
            if getattr(self, name) is not None:
                raise ValueError(
                    f"pwm is a share of the full duty and has no {name}, but full_scale"
                )
        if self.full_scale is None:
            raise ValueError(
                "pwm needs full_scale: the number that stands for full duty, such as 885 of a"
                " Dynamixel XL330, 1000 of a Feetech, 100 of per cent"
            )

    def scale(self, channel: ChannelName) -> float:
        """Return the factor that turns the recorded number into rad, rad/s or Nm (m, m/s or N) at
        the output; of pwm into a share of full duty."""
        if channel == "pwm":
            return self.factor * self.sign / (self.full_scale or 1.0)
        si = TO_SI[channel][self.unit or DEFAULT_UNIT[channel]] * self.factor * self.sign
        ratio = self.ratio or 1.0
        return si * (self.torque_constant or 1.0) * ratio if channel == "effort" else si / ratio

    def applied(self, recorded: Array, channel: ChannelName) -> Array:
        """Return recorded numbers in rad, rad/s or Nm at the harmonic-drive output, or as a share
        of full duty.

        Raises a RecordingError if a duty exceeds the full one.
        """
        found = (recorded + self.offset if self.offset else recorded) * self.scale(channel)
        if channel == "pwm":
            most = float(np.nanmax(np.abs(found), initial=0.0))
            if most > MOST_DUTY:
                raise RecordingError(
                    f"pwm reaches {most * (self.full_scale or 1.0):.6g}, {most:.3g} times its"
                    f" full_scale of {self.full_scale:g}",
                    "State in full_scale the number that stands for full duty. If the sign is a bit"
                    " of its own, convert the numbers first.",
                )
        return found


class Channel(ChannelScale):
    """The source of one channel of one joint."""

    topic: str  # topic in the bag
    # path of the field in the message: `position`, `wrench.torque.z`, `data`; the channel's own
    # name by default
    field: str = ""
    # place in the field; by default the place of `name` in the message's list of names
    index: Annotated[WholeNumber, Field(ge=0)] | None = None
    name: str = ""  # the joint's name in the message; the joint's own name by default


class Present(Strict):
    """A group of channels of which some are given."""

    def present(self) -> dict[ChannelName, Any]:
        """Return the channels that are there."""
        return {
            name: own
            for name in get_args(ChannelName)
            if (own := getattr(self, name, None)) is not None
        }


class SideChannels(Present):
    """The channels of one side of a joint; None where not recorded."""

    position: Channel | None = None
    velocity: Channel | None = None
    effort: Channel | None = None
    # duty that a servo applied, and voltage of its supply, of the motor side alone
    pwm: Channel | None = None
    supply: Channel | None = None

    @model_validator(mode="after")
    def _units(self) -> Self:
        for name, channel in self.present().items():
            channel.check_unit(name)
        return self


def from_currents(link: Sequence[str | None], motor: Sequence[str | None]) -> tuple[str, ...]:
    """Return which torque channels, by their names in a recording, have the unit of a current at
    any joint."""
    return tuple(
        name for name, units in zip(TORQUE_CHANNELS, (link, motor), strict=True) if "A" in units
    )


def check_sides(present: Mapping[str, Mapping[ChannelName, Any]]) -> None:
    """Raise a ValueError if sides other than the motor's have a channel of motors."""
    for side, channels in present.items():
        for name in OF_MOTOR:
            if name in channels:
                raise ValueError(NOT_OF_MOTOR.format(name, side))


class JointChannels(Strict):
    """The sides of a joint and its command; `name` is the joint's name in the bag, for channels
    without a name of their own."""

    name: str = ""
    link: SideChannels = SideChannels()
    motor: SideChannels = SideChannels()
    command: SideChannels = SideChannels()

    @model_validator(mode="after")
    def _duty(self) -> Self:
        check_sides({side: getattr(self, side).present() for side in ("link", "command")})
        if self.motor.pwm is not None and self.motor.effort is not None:
            raise ValueError(DUTY_AND_TORQUE)
        return self

    def sides(self) -> tuple[SideChannels, ...]:
        """Return all sides."""
        return self.link, self.motor, self.command


class ChannelMap(Strict):
    """A channel map."""

    # by the name in the robot description, in its order
    joints: Annotated[dict[str, JointChannels], Field(min_length=1, max_length=MOST_JOINTS)]
    # a sample's time: the message's `header` stamp, or its `arrival` where there is no header
    time: Literal["header", "arrival"] = "header"
    # of motors that move several joints: joint -> motor -> factor
    coupling: Coupling = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _written_out(cls, data: Any) -> Any:
        """Fill in the defaults of all joints and the omitted entries of channels."""
        if not isinstance(data, dict):
            return data
        defaults = data.get("defaults") or {}
        rest = {key: value for key, value in data.items() if key != "defaults"}
        if isinstance(joints := rest.get("joints"), dict):
            rest["joints"] = {
                name: _filled(str(name), _merged(defaults, own or {}))
                for name, own in joints.items()
            }
        return rest

    @model_validator(mode="after")
    def _usable(self) -> Self:
        for name, joint in self.joints.items():
            if not any(side.present() for side in joint.sides()):
                raise ValueError(f"{name} has no channel")
            if joint.motor.pwm is not None and self.coupling:
                raise ValueError(DUTY_OF_COUPLED)
        coupling_matrix(self.coupling, list(self.joints))
        return self

    def fields(self) -> dict[str, set[str]]:
        """Return all fields that are needed, by topic."""
        found: dict[str, set[str]] = {}
        for side in (side for joint in self.joints.values() for side in joint.sides()):
            for channel in side.present().values():
                found.setdefault(channel.topic, set()).add(channel.field)
        return found

    def topics(self) -> set[str]:
        """Return all topics that are needed."""
        return set(self.fields())

    def currents(self) -> tuple[str, ...]:
        """Return which torque channels, by their names in a recording, are currents at any
        joint."""
        link = [joint.link.effort for joint in self.joints.values()]
        motor = [joint.motor.effort for joint in self.joints.values()]
        return from_currents(_units_of(link), _units_of(motor))


def _units_of(channels: Sequence[Channel | None]) -> list[str | None]:
    return [None if channel is None else channel.unit for channel in channels]


def load_channels(path: str | Path) -> ChannelMap:
    """Read a channel map (YAML).

    Raises a RecordingError if it cannot be read, or a field is missing, unknown, of the wrong type
    or at odds with another.
    """
    return load_model(ChannelMap, path, "channel map")


M = TypeVar("M", bound=BaseModel)

# Words of the trade for the fields of a channel, and what these are called here.
CALLED = {
    "scale": "factor",
    "gain": "factor",
    "zero": "offset",
    "bias": "offset",
    "units": "unit",
    "column": "columns",
    "gear_ratio": "ratio",
    "kt": "torque_constant",
    "full_duty": "full_scale",
    "duty": "pwm",
    "load": "pwm",
}


def load_model(model: type[M], path: str | Path, what: str) -> M:
    """Read a YAML file as a model."""
    try:
        return model.model_validate(read_fields(path, RecordingError, REMEDY))
    except RecordingError as error:
        raise RecordingError(f"{what} {error.problem}", error.remedy) from None
    except ValidationError as error:
        problem, remedy = explain(error, REFERENCE, CALLED)
        if (other := _other_kind(path, what)) is not None:
            raise RecordingError(*other) from None
        raise RecordingError(f"{path}: {problem}", remedy) from None


def _other_kind(path: str | Path, what: str) -> tuple[str, str] | None:
    """Return problem and remedy if a file is an array mapping instead of a channel map, or the
    other way round; None otherwise."""
    content = read_fields(path, RecordingError, REMEDY)
    if what == "mapping" and "defaults" in content:
        problem = f"{path} is a channel map, for a bag, and not a mapping of arrays"
        return problem, "Give it with --channels to the command that reads the bag; do not import."
    if what != "mapping" and "times" in content:
        problem = f"{path} is a mapping of arrays and not a channel map"
        return problem, "Convert the arrays with it: elastic-arm bag import ARRAYS --map FILE."
    return None


def _merged(defaults: Any, own: Any) -> Any:
    """Merge `own` into `defaults`, mapping by mapping."""
    if not (isinstance(defaults, dict) and isinstance(own, dict)):
        return own
    return {**defaults, **{key: _merged(defaults.get(key), value) for key, value in own.items()}}


def _filled(joint_name: str, joint: Any) -> Any:
    """Fill in omitted entries of a channel: the joint's name in the bag, and the field with the
    name of the channel.

    Anything but a mapping is returned unchanged, so that the validation reports it.
    """
    if not isinstance(joint, dict):
        return joint
    name = joint.get("name") or joint_name
    fields = dict.fromkeys(OF_MOTOR, "effort")  # where a JointState has room for it

    def side(channels: Any) -> Any:
        if not isinstance(channels, dict):
            return channels
        return {
            channel: (
                {"name": name, "field": fields.get(channel, channel), **source}
                if isinstance(source, dict)
                else source
            )
            for channel, source in channels.items()
        }

    return {key: side(value) if key in SIDE_NAMES else value for key, value in joint.items()}


def coupling_matrix(coupling: Mapping[str, Mapping[str, float]], joints: Sequence[str]) -> Array:
    """Return the matrix C (n, n) of theta = C theta_motors; joints without an entry depend only on
    their own motor."""
    matrix = np.eye(len(joints))
    for joint, motors in coupling.items():
        for name in (joint, *motors):
            if name not in joints:
                raise ValueError(
                    f"coupling: unknown joint {name}; the joints are {', '.join(joints)}"
                )
        matrix[joints.index(joint)] = [motors.get(name, 0.0) for name in joints]
    if not np.isfinite(matrix).all():
        raise ValueError("coupling: a factor is not finite")
    sizes = np.linalg.svd(matrix, compute_uv=False)
    if (
        sizes[-1] < 1e-9 * sizes[0]
    ):  # relative singular value below which motors cannot move the joints apart
        raise ValueError(
            "coupling: the motors cannot move these joints independently; each row also"
            " has to name the joint's own motor"
        )
    return matrix


def coupled(side: Side | None, matrix: Array) -> Side | None:
    """Return the motor side of joints: theta = C theta_motors, C' tau = tau_motors, so that power
    is kept."""
    if side is None or np.array_equal(matrix, np.eye(len(matrix))):
        return side
    inverse = np.linalg.inv(matrix)
    moved = {
        name: values @ inverse if name == "effort" else values @ matrix.T
        for name, values in side.channels().items()
    }
    return Side(side.stamp_ns, **moved)
