"""Draft an array mapping: guess what each array contains, and give the reason, for a person to
check and correct."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from elastic_arm.errors import RecordingError
from elastic_arm.recording.foreign.array_files import FILE_INDEX
from elastic_arm.recording.foreign.channels import (
    CHANNEL_NAMES,
    DEFAULT_UNIT,
    SIDE_NAMES,
    TO_SI,
    ChannelName,
    SideName,
    known_unit,
)
from elastic_arm.recording.foreign.draft import Draft, Guess
from elastic_arm.recording.foreign.tables import (
    TIME_NAME,
    Contents,
    JointTable,
    TimeArray,
    find_tables,
)
from elastic_arm.recording.foreign.text_tables import Arrays
from elastic_arm.recording.inspection.commands import COPIED, DIGITS, SHIFTED
from elastic_arm.recording.inspection.percent import ranges_by_steps

# Above this correlation one array counts as the derivative of another.
ALIKE = 0.9
# Seconds over which differences and velocities are averaged before they are compared.
AVERAGED = 0.05
# Within this factor of a unit's size a slope shows the unit.
CLOSE = 0.15
# Angles of an arm in radians stay below this.
LARGEST_ANGLE = 4 * np.pi
# Travels in metres, and speeds in metres a second, stay below this.
LARGEST_TRAVEL = 20.0
# The unit of a quantity that no channel has, at the end of a name or in brackets.
_OTHER_UNIT = re.compile(r"(?:_|\[|\()(?:m?V|°?C|degC|K|m?W|Hz|Pa|bar)[\])]?$")
# What a servo's firmware puts on its motor is a voltage; the torque falls with the speed.
_OF_DUTY = (
    "a share of the supply voltage and no torque: the `motor:` of a `controller:` in the arm file"
    " computes the torque; otherwise leave it out"
)
_FULL_DUTY = (
    "the number that stands for full duty, by the data sheet; the largest one here is {:.6g}"
)
_COMMANDED_DUTY = "a commanded duty: only the applied one makes a torque"
_BESIDE_TORQUE = "a duty beside the motor torque {}: map one of the two"
_LOAD = (
    "if this register is the duty, as that of a Feetech servo, map it as pwm instead, with its"
    " full_scale (1000)"
)
# Unit and words of a channel in counts of a register, by which its number has to be multiplied.
COUNTED = {"position": ("turns", "turns (1/4096 of a 12-bit encoder)"), "effort": ("Nm", "Nm")}
CONSTANT = "column"  # begin of a reason
DEAD = "constant while its joint moves: no sensor, not mapped"
# What a motor has, whether its joint turns or slides.
_AT_SHAFT = ("A", "Nm_motor")
_OF_SLIDES = ("m", "mm", "m/s", "mm/s", "N")  # by a unit that is stated
# A rotor's angle over the joint's is at least this.
SMALLEST_RATIO = 5.0

_ANGLES = {unit: TO_SI["position"][unit] for unit in ("rad", "deg", "turns")}
_ANGLE_WORDS = r"deg|rad|turn|rev"
_SPEEDS = {unit: TO_SI["velocity"][unit] for unit in ("rad/s", "deg/s", "turns/s", "rpm")}
_WORDS = {
    "other": (
        r"temp|volt|supply|batter|cmpt|error|status|mode(?!l?led)|noise|friction|grav|model|predict|simul|init"
        r"|(?<!e)ff(?=_|\d|$)|feed_?forward|external|(?<![a-z])ext(?=_|\d|$)|tcp|wrench|cartesian"
    ),
    "acceleration": r"acc|ddq|qdd|d2",
    "velocity": r"vel|drehzahl|dq|qd|omega|speed|rpm|dtheta",
    "pwm": r"pwm|duty",
    "effort": (
        r"torq|strom|tau|force|eff(?!ect)|cur(?!v|rent_?(?:pos|ang|vel|q|state|joint))|load|moment"
        r"|(?<![a-z])iq?(?=_|\d|$)"
    ),
    "position": (
        r"pos|winkel|ang|theta|enc(?=_|\d|$)|encoder|(?<![a-z])q(?=_|\.|\d|$)"
        r"|joint_state|(?<![a-z])state(?=[^a-z\d]*$)"
    ),
}
# What the arm was told; without a further word its positions, as a dataset's `action`.
_COMMAND = (
    r"target|goal|demand|soll|desired|des(?=_|\d|$)|ref(?!l)|cmd|command(ed)?|set_?point"
    r"|(?<![a-z])action(?![a-z])|(?<![a-z])ctrl(?![a-z])"
    r"|(?:(?<=q)|(?<=tau)|(?<=tau_j))_d(?=_|\d|$)"
)
_EITHER = re.compile(r"(?<![a-z])ctrl(?![a-z])", re.I)  # MuJoCo's commands, of angles or torques
# Read in this order: a sensor of a motor's torque is rarer than a torque sensor.
_SIDE_WORDS: dict[SideName, str] = {
    "command": _COMMAND,
    "link": (
        r"link|(?<![a-z])se(?=_|\d|$)|second|output|load|sensor|torq\w*s(m|ens)|tau_?j|arm_side"
    ),
    "motor": (
        r"mot|strom|rotor|theta|drive|actuat|cur(?!v|rent_?(?:pos|ang|vel|q|state|joint))"
        r"|tau_?m|(?<![a-z])iq?(?=_|\d|$)"
    ),
}
Place = tuple[SideName, ChannelName]
Chosen = dict[Place, Guess]
LeftOut = tuple[JointTable, str]  # with the reason
# Of several arrays for one channel the one with more of these in its name is taken.
_MEASURED = r"act(?=_|ual)|meas|rec|sens|raw|abs"


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def guess_mapping(
    arrays: Mapping[str, np.ndarray],
    joints: Sequence[str],
    prismatic: Collection[str] = (),
    calibration: str | None = None,
) -> Draft:
    """Return a draft of the mapping from arrays to a recording.

    Units follow from names, ranges and slopes of derivatives; sides and kinds of torque from names.

    calibration: file of LeRobot's calibration, as the mapping is to state it: positions without a
    unit in their names are per cent of its ranges.
    """
    arrays = arrays if isinstance(arrays, Arrays) else Arrays(arrays)
    contents = find_tables(arrays, joints, arrays.units, arrays.columns)
    slides = np.array([joint in prismatic for joint in joints])
    whole = {table.keys: table for table in contents.tables}
    if not slides.all():
        # What is in the columns is told by those of joints that turn.
        turning = [replace(table, values=table.values[:, ~slides]) for table in contents.tables]
        contents = replace(contents, tables=tuple(turning))
    texts = {
        key: values.ravel()[0]
        for key, values in arrays.items()
        if values.dtype.kind == "U" and values.size
    }
    faults = texts | arrays.faults
    numbers = [
        key for key in contents.rest if arrays[key].dtype.kind in "iufc" and key != FILE_INDEX
    ]
    ignored = [(key, "not a table of all joints") for key in numbers]
    chosen, left_out = _chosen(_Reader(contents).guesses())
    ignored += left_out
    duty = chosen.get(("motor", "pwm"))
    torque = chosen.get(("motor", "effort"))
    if duty is not None and torque is not None:
        del chosen["motor", "pwm"]
        ignored += [(key, _BESIDE_TORQUE.format(torque.table.name)) for key in duty.table.keys]
    if not chosen:
        stated = {key: f"{key} ({fault})" for key, fault in faults.items()}
        listed = ", ".join(stated.get(key, key) for key in arrays)
        raise RecordingError(
            f"no array contains positions or torques of {len(joints)} joints; the arrays"
            f" are {listed[:300]}",
            "Check --robot: its number of joints has to equal the number of columns; or"
            " write the mapping by hand.",
        )
    chosen = {
        place: replace(guess, table=whole[guess.table.keys]) for place, guess in chosen.items()
    }
    _compare_commands(chosen)
    chosen = _with_ratio(chosen)
    found = {place: _with_lengths(guess, slides.tolist()) for place, guess in chosen.items()}
    found = {place: _without_dead(guess, found) for place, guess in found.items()}
    for guess in found.values():
        if guess.places is not None and len(guess.table.keys) > 1:  # an array a column
            dead = [key for k, key in enumerate(guess.table.keys) if k not in guess.places]
            ignored += [(key, DEAD) for key in dead]
    ordered = [found[place] for place in product(SIDE_NAMES, CHANNEL_NAMES) if place in found]
    ignored += [(key, f"not numbers: {fault}") for key, fault in faults.items()]
    if calibration is not None:
        ordered = [_by_calibration(guess) for guess in ordered]
    return Draft(
        tuple(joints),
        contents.times,
        tuple(ordered),
        tuple(ignored),
        contents.runs,
        arrays.decimal,
        calibration,
    )


def _by_calibration(guess: Guess) -> Guess:
    """Return a position without a unit in its name as per cent of calibrated ranges."""
    if guess.channel != "position" or known_unit(guess.table.stated) is not None:
        return guess
    *others, _ = guess.reasons
    why = "per cent of each joint's range, by the calibration"
    return replace(guess, reasons=(*others, why), unit="", units=(), scales={}, missing={})


def _chosen(guesses: Sequence[Guess | LeftOut]) -> tuple[Chosen, list[tuple[str, str]]]:
    """Return the first guess of each channel, and the arrays left out with the reasons."""
    chosen: Chosen = {}
    ignored: list[tuple[str, str]] = []
    for guess in guesses:
        if isinstance(guess, tuple):
            table, reason = guess
        else:
            table = guess.table
            place = (guess.side, guess.channel)
            first = chosen.setdefault(place, guess)
            if first is guess:
                continue
            if np.array_equal(table.values, first.table.values):
                reason = f"the same numbers as {first.table.name}"
            else:
                channel = f"{guess.side} {guess.channel}"
                reason = f"also a candidate for {channel}; {first.table.name} was chosen"
                chosen[place] = first.because(f"{table.name} is another candidate")
        ignored += [(key, reason) for key in table.keys]
    return chosen, ignored


def _compare_commands(chosen: Chosen) -> None:
    """State in the guess of the commands how far the positions follow them."""
    command = chosen.get(("command", "position"))
    followed = chosen.get(("link", "position")) or chosen.get(("motor", "position"))
    if command is None or followed is None:
        return
    far = np.median(np.std(followed.table.values, axis=0))
    asked = np.median(np.std(command.table.values, axis=0))
    why = f"the positions, {followed.table.name}, swing {far / asked:.3g} times as far"
    chosen["command", "position"] = _alike(command, followed).because(why)


def _alike(command: Guess, followed: Guess) -> Guess:
    """Return the commands in the unit of the positions, if the positions follow them number for
    number."""
    apart = np.abs(command.table.values - followed.table.values).mean(axis=0)
    near = np.all(apart < followed.table.values.std(axis=0) + 1e-12)
    if not followed.missing or command.missing or command.table.stated or not near:
        return command
    why = f"in the unit of {followed.table.name}"
    return command.because(why, "largest", unit=followed.unit, missing=followed.missing)


def _without_dead(guess: Guess, chosen: Mapping[Place, Guess]) -> Guess:
    """Return a guess without the columns that are constant although another position shows that
    their joints move."""
    positions = [
        other
        for (_, channel), other in chosen.items()
        if channel == "position" and other is not guess
    ]
    moving = np.any([np.ptp(other.table.values, axis=0) > 0.0 for other in positions], axis=0)
    dead = (np.ptp(guess.table.values, axis=0) == 0.0) & moving
    if not dead.any() or dead.all():
        return guess
    columns = ", ".join(str(k) for k in np.flatnonzero(dead))
    places = tuple(np.flatnonzero(~dead).tolist())
    return guess.because(f"column {columns} is {DEAD}", CONSTANT, places=places)


def _with_lengths(guess: Guess, slides: Sequence[bool]) -> Guess:
    """Return a guess with the units of a length or force for joints that slide."""
    if not any(slides) or guess.channel == "pwm" or guess.unit in (*_AT_SHAFT, *_OF_SLIDES):
        return guess
    largest = float(np.abs(guess.table.values[:, np.flatnonzero(slides)]).max())
    length = "mm" if largest > LARGEST_TRAVEL else "m"
    own = {"position": length, "velocity": f"{length}/s", "effort": "N"}[guess.channel]
    why = f"prismatic joints have {own}: the largest number is {largest:.3g}"
    if all(slides):
        return guess.because(why, guess.unit, unit=own)
    return guess.because(why, units=tuple(own if slide else guess.unit for slide in slides))


class _Reader:
    """Interprets tables by their names and units, and by which table is the derivative of which."""

    def __init__(self, contents: Contents) -> None:
        self.tables = contents.tables
        times = contents.times
        self.times = times if times is not None and not times.fault else None
        named = [(table, *_quantity(table)) for table in self.tables]
        measured = [(table, quantity) for table, quantity, _ in named if not _is_command(table)]
        self.positions = [table for table, quantity in measured if quantity == "position"]
        self.speeds = [table for table, quantity in measured if quantity == "velocity"]
        nameless = [table for table, quantity in measured if quantity is None]
        # Wherever they stand in the file: angles without a name are those of which a rate is the
        # derivative, and which are the derivative of none of themselves.
        rates = [*self.speeds, *nameless]
        sources = [table for table in nameless if self._has_rate(table, rates)]
        self.angles = [table for table in sources if not self.sources(table, sources)]
        self.positions += self.angles

    def guesses(self) -> list[Guess | LeftOut]:
        """Return each table as a guess, or with the reason why it is left out; tables recognised by
        name come first."""
        read = [
            (_quantity(table)[0] is not None or _is_command(table), self._read(table))
            for table in self.tables
        ]
        named = [guess for by_name, guess in read if by_name and isinstance(guess, Guess)]
        return [*sorted(named, key=_rank), *(guess for _, guess in read if guess not in named)]

    def _has_rate(self, table: JointTable, rates: Sequence[JointTable]) -> bool:
        return any(self.sources(rate, [table]) for rate in rates if rate is not table)

    def sources(
        self, rate: JointTable, among: Sequence[JointTable]
    ) -> list[tuple[float, float, JointTable]]:
        """Return the tables whose derivative a rate follows, as correlation, slope and table, the
        best first."""
        if self.times is None:
            return []
        slopes = [
            (*_slope(source, rate, self.times), source) for source in among if source is not rate
        ]
        return sorted((found for found in slopes if found[0] > ALIKE), key=lambda found: -found[0])

    def _read(self, table: JointTable) -> Guess | LeftOut:
        quantity, word = _quantity(table)
        reason = self._no_channel(table, quantity)
        if reason:
            return table, reason
        by_name = [f"called {word}"] if word else []
        if _is_command(table):
            if quantity is None and _EITHER.search(table.name) and self.positions:
                quantity = "effort" if self._commanded(table) is None else "position"
            return self._guess(table, quantity or "position", by_name)
        if quantity is not None:
            return self._guess(table, quantity, by_name)
        return self._by_numbers(table)

    def _no_channel(self, table: JointTable, quantity: str | None) -> str:
        """Return why a table is not a channel of a recording; empty if it may be one."""
        if quantity == "other" or _OTHER_UNIT.search(table.keys[0]):
            return "neither position, velocity nor torque according to its name"
        if quantity == "acceleration":
            return "derived, not a measurement"
        for other in self.tables:
            whole = len(other.keys) == 1 < len(table.keys)
            if whole and np.array_equal(other.values, table.values):
                return f"the same numbers as {other.name}"
        if np.ptp(table.values, axis=0).max() == 0:
            return "constant throughout"
        if quantity == "pwm" and _is_command(table):
            return _COMMANDED_DUTY
        if _is_command(table):
            return self._made(table)
        # The velocity of a rotor follows the joint's angle, by the ratio.
        known = self.times is not None and bool(self.positions)
        if quantity == "velocity" and known and not self.sources(table, self.positions):
            derivative = "the derivative of any position in the file"
            return f"named a velocity, but not {derivative}: map it by hand"
        return ""

    def _by_numbers(self, table: JointTable) -> Guess | LeftOut:
        """Return what a table without a telling name may be, by the derivatives of the others."""
        if table in self.angles:
            return self._guess(table, "position", ["another array is its derivative"])
        if self._speed_by_slope(table) is not None:
            return self._guess(table, "velocity", [])
        if self.sources(table, self.speeds):
            return table, "the derivative of a velocity: derived, not a measurement"
        followed = self._commanded(table)
        if followed is not None:
            reason = f"belongs to {followed.name}, but its name gives no quantity"
            return self._guess(table, "position", [reason], "command")
        reason = "neither an angle nor a velocity according to its name or its derivatives"
        return self._guess(table, "effort", [reason])

    def _made(self, table: JointTable) -> str:
        """Return in words from which positions a command was computed; empty for commands that were
        sent."""
        # Computed torque follows as closely as its model is right.
        torques = any(_quantity(one)[0] == "effort" for one in self.tables)
        least = DIGITS if torques else COPIED
        for position in self.positions:
            spread = np.maximum(position.values.std(axis=0), 1e-300)
            for later in range(SHIFTED + 1):
                count = len(position.values) - later
                apart = np.abs(table.values[:count] - position.values[later:])
                if np.all(apart.mean(axis=0) < least * spread):
                    samples = "sample" if later == 1 else "samples"
                    when = f" {later} {samples} later" if later else ""
                    return f"the numbers of {position.name}{when}: not commands that were sent"
        return ""

    def _commanded(self, table: JointTable) -> JointTable | None:
        """Return the position that follows a table without a telling name number for number, as
        positions follow commands."""
        for position in self.positions:
            apart = np.abs(table.values - position.values).mean(axis=0)
            spread = position.values.std(axis=0)
            if np.all(apart < 0.3 * spread + 1e-12) and spread.any():
                return position
        return None

    def _guess(
        self,
        table: JointTable,
        channel: ChannelName,
        reasons: list[str],
        of: SideName | None = None,
    ) -> Guess:
        """Return a table as a channel, with side and unit."""
        side, word = (of, "") if of is not None else _side_by_name(table.name)
        n = table.values.shape[1]
        unit, why, scales, missing = self._unit(table, channel)
        reasons = list(reasons)
        if channel == "effort":
            # A servo's register of its load is the motor's; a sensor has other units.
            of_servo = side == "link" and word.lower() == "load" and "factor" in missing
            side, word = ("motor", "") if of_servo or side is None else (side, word)
            if of_servo:
                reasons.append(_LOAD)
            if not word:
                why += (
                    "; a motor torque, unless the arm has joint torque sensors: then move it"
                    " under link"
                )
            if unit == "A":
                missing |= {
                    "torque_constant": "Nm/A at the motor shaft",
                    "ratio": "motor turns per output turn",
                }
        if channel == "pwm":
            side = "motor"
        elif word:
            reasons.append(f"{side} side according to {word!r} in its name")
        elif channel != "effort":
            reasons.append("link side, as its name does not indicate the motor")
        if table.called:
            reasons.append("the columns of the joints, by their names in meta/info.json")
        elif not table.pattern and n > 1:
            reasons.append("in the order of the arm's joints, which is an assumption: check it")
        if table.flat:
            reasons.append(f"numbers one after the other, {n} per sample")
        if still := [str(k) for k in np.flatnonzero(np.ptp(table.values, axis=0) == 0)]:
            reasons.append(
                f"{CONSTANT} {', '.join(still)} is constant: no sensor, or a joint at rest"
            )
        if table.available > n:
            reasons.append(
                f"the first {n} of {table.available} columns: check that these are the arm's joints"
            )
        return Guess(side or "link", channel, table, unit, (*reasons, why), scales, missing)

    def _unit(
        self, table: JointTable, channel: ChannelName
    ) -> tuple[str, str, dict[str, list[float]], dict[str, str]]:
        """Return the unit of a channel, the reason, its factors, and the missing entries."""
        if channel == "pwm":
            most = float(np.abs(table.values).max())
            return "", _OF_DUTY, {}, {"full_scale": _FULL_DUTY.format(most)}
        stated = known_unit(table.stated)
        if stated is not None and stated[0] in TO_SI[channel]:
            unit, size = stated
            scales = {} if size == 1.0 else {"factor": [size] * table.values.shape[1]}
            return unit, f"in {table.stated} according to its name", scales, {}
        if table.stated:
            unit = DEFAULT_UNIT[channel]
            why = f"in {table.stated} according to its name, which is not a unit of {channel}"
            return unit, why, {}, {"factor": f"number of {unit} per {table.stated}"}
        if _counts(table) and channel in COUNTED:
            called, what = COUNTED[channel]
            largest = f"{np.abs(table.values).max():.0f}"
            why = f"integers up to {largest}: counts of a register, not {called}"
            return called, why, {}, {"factor": f"{what} per count"}
        ranges = ranges_by_steps(table.values) if channel == "position" else None
        if ranges is not None:
            factors = ", ".join(f"{size / 200.0:.3g}" for size in ranges)
            factor = f"range / 200 of the calibration file; from steps of 12 bits [{factors}]"
            why = "per cent of each joint's range, according to the different steps of the encoders"
            return "deg", why, {}, {"factor": factor}
        by_numbers = {
            "position": _angle_unit,
            "velocity": self._speed_unit,
            "effort": _torque_unit,
        }
        return *by_numbers[channel](table), {}, {}

    def _speed_unit(self, table: JointTable) -> tuple[str, str]:
        """Return the unit of velocities: by the slope between them and the derivatives of the
        positions, otherwise by the name."""
        if (found := self._speed_by_slope(table)) is not None:
            return found
        if (word := re.search(r"deg|rpm|rad", table.name, re.I)) is not None:
            unit = {"deg": "deg/s", "rpm": "rpm"}.get(word[0].lower(), "rad/s")
            return (
                unit,
                (
                    f"unit according to {word[0]!r} in its name; it is not the derivative of any"
                    " position in the file"
                ),
            )
        return "rad/s", "the unit is a guess: it is not the derivative of any position in the file"

    def _speed_by_slope(self, table: JointTable) -> tuple[str, str] | None:
        """Return the unit in which a table is the derivative of a position, and the reason; None if
        it is not a derivative.

        Correlation with a velocity is not sufficient: a torque that consists mostly of friction
        correlates as well.
        """
        for alike, steep, source in self.sources(table, self.positions):
            for unit, size in _SPEEDS.items():
                ratio = steep * _ANGLES[_angle_unit(source)[0]] / size
                if abs(ratio - 1) < CLOSE:
                    return (
                        unit,
                        f"derivative of {source.name} (correlation {alike:.3f}, slope {ratio:.3f})",
                    )
        return None


def _slope(source: JointTable, rate: JointTable, times: TimeArray) -> tuple[float, float]:
    """Return correlation and slope between the derivative of one table and another table: medians
    over the moving joints."""
    width = max(round(AVERAGED * times.rate), 3)
    dt = np.maximum(np.gradient(times.seconds), 1e-9)[:, None]
    derivative = np.gradient(source.values, axis=0) / dt
    # Where angles wrap, the difference is no velocity.
    derivative[np.abs(derivative) > 50 * np.median(np.abs(derivative), axis=0) + 1e-12] = 0.0
    sums = [
        np.cumsum(np.vstack([np.zeros(v.shape[1]), v]), axis=0) for v in (derivative, rate.values)
    ]
    d, v = ((total[width:] - total[:-width]) / width for total in sums)
    power = np.sqrt((d * d).sum(axis=0) * (v * v).sum(axis=0))
    moving = power > 0
    if not moving.any():
        return 0.0, 0.0
    both = (d * v).sum(axis=0)[moving]
    return float(np.median(both / power[moving])), float(
        np.median(both / (v * v).sum(axis=0)[moving])
    )


def _is_command(table: JointTable) -> bool:
    return re.search(_COMMAND, table.stem, re.I) is not None


def _rank(guess: Guess) -> tuple[int, bool]:
    """Return the order of guesses for one channel: names of measurements first, then torques whose
    name states the side.

    Next to a torque computed from the motor's current, an array that is only called a torque may be
    the model of the controller.
    """
    sided = (
        guess.channel == "effort"
        and guess.unit == "Nm"
        and bool(_side_by_name(guess.table.name)[1])
    )
    return -len(re.findall(_MEASURED, guess.table.name, re.I)), not sided


def _quantity(table: JointTable) -> tuple[Any, str]:
    """Return the quantity that the name of a table, or otherwise its unit, indicates; and the name
    if it was decisive."""
    stem = re.sub(_COMMAND, "", table.stem, flags=re.I)
    if TIME_NAME.search(table.name):
        return "other", table.name
    for quantity, pattern in _WORDS.items():
        if re.search(pattern, stem, re.I) is not None:
            return quantity, table.name
    unit = known_unit(table.stated)
    of_unit = [name for name in CHANNEL_NAMES if unit is not None and unit[0] in TO_SI[name]]
    if of_unit:
        return of_unit[0], table.name
    return None, "" if stem == table.stem else table.name


def _side_by_name(name: str) -> tuple[SideName | None, str]:
    for side, pattern in _SIDE_WORDS.items():
        if (match := re.search(pattern, name, re.I)) is not None:
            return side, match[0]
    return None, ""


def _angle_unit(table: JointTable) -> tuple[str, str]:
    stated = known_unit(table.stated)
    if stated is not None and stated[0] in _ANGLES:
        return stated[0], ""
    word = re.search(_ANGLE_WORDS, table.name, re.I)
    if word is not None:
        unit = {"deg": "deg", "rad": "rad"}.get(word[0].lower(), "turns")
        return unit, f"unit according to {word[0]!r} in its name"
    largest = float(np.abs(table.values).max())
    unit = "rad" if largest < LARGEST_ANGLE else "deg"
    # Neither numbers nor a robot's limits tell degrees of a joint from a rotor's radians.
    instead = "" if unit == "rad" else ", or rad of a rotor: then move it under motor, with ratio"
    # Where columns end at 100 it is the end of a calibrated range.
    full = 99.5 < largest <= 100.0
    instead += (
        ", or per cent of each joint's range (default of LeRobot): then set factor to"
        " range in degrees / 100" * full
    )
    return unit, f"largest angle {largest:.3g}: {unit}{instead}"


def _counts(table: JointTable) -> bool:
    """Return whether numbers are counts of a register: integers larger than an arm has in any unit
    of the quantity."""
    whole = bool((table.values == np.round(table.values)).all())
    return whole and float(np.abs(table.values).max()) > 20.0 and len(np.unique(table.values)) > 20


def _torque_unit(table: JointTable) -> tuple[str, str]:
    current = re.search(r"cur(?!v)|strom|(?<!st)amp(?!l)|(?<![a-z])iq?(?=_|\d|$)", table.name, re.I)
    if current is not None and "torq" not in table.name.lower():
        return "A", "a current according to its name"
    largest = float(np.abs(table.values).max())
    return (
        "Nm",
        (
            f"largest {largest:.3g}: assumed to be Nm at the joint (at the motor shaft:"
            " unit Nm_motor, with ratio)"
        ),
    )


def _with_ratio(chosen: Chosen) -> Chosen:
    """Add the gear ratio to the channels of the motor side, if the positions of both sides show
    it."""
    motor = chosen.get(("motor", "position"))
    link = chosen.get(("link", "position"))
    if motor is None or link is None or not {motor.unit, link.unit} <= set(_ANGLES):
        return chosen
    # Without a unit in its name, a rotor's angle is far beyond a joint's range in any unit: it has
    # that of the link.
    unit = motor.unit if re.search(_ANGLE_WORDS, motor.table.name, re.I) else link.unit
    of_rotor = motor.table.values * _ANGLES[unit]
    of_rotor = of_rotor - of_rotor.mean(axis=0)
    of_link = link.table.values * _ANGLES[link.unit]
    of_link = of_link - of_link.mean(axis=0)
    slope = (of_rotor * of_link).sum(axis=0) / np.maximum((of_link**2).sum(axis=0), 1e-300)
    if np.abs(slope).min() < SMALLEST_RATIO:
        return chosen
    scales: dict[str, list[float]] = {
        "ratio": [round(float(s), 4) for s in np.abs(slope)],
        "sign": [float(np.sign(s)) for s in slope],
    }
    why = f"slope relative to the link angle: turns of the rotor, in {unit}"
    for guess in (motor, chosen.get(("motor", "velocity"))):
        if guess is not None:
            of_angle = guess.unit.replace(motor.unit, unit)
            both = {**guess.scales, **scales}
            chosen["motor", guess.channel] = guess.because(
                why, "largest", unit=of_angle, scales=both
            )
    return chosen
