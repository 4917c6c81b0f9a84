"""The draft of an array mapping as a file: the guess for each array, with the reasons as
comments."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import yaml

from elastic_arm.recording.foreign.channels import SIDE_NAMES, ChannelName, SideName
from elastic_arm.recording.foreign.tables import TIME_NAME, JointTable, TimeArray

_FAULTY_TIMES = (
    "# Sort the rows by time, remove repeated ones, or export the times in double precision; or",
    "# give {rate: HZ} in place of the key, if the rows are in order and none is repeated.",
)


@dataclass(frozen=True)
class Guess:
    """One channel of the draft."""

    side: SideName  # side, channel: where it goes
    channel: ChannelName
    table: JointTable  # its arrays
    unit: str  # of its numbers; empty if nothing shows it
    reasons: tuple[str, ...]  # why, in words
    # further keys of the mapping: sign, ratio
    scales: Mapping[str, list[float]] = field(default_factory=dict)
    # keys that the mapping needs and no array can show, with what they are
    missing: Mapping[str, str] = field(default_factory=dict)
    units: tuple[
        str, ...
    ] = ()  # one a joint, where some of them slide; empty where `unit` is that of all
    places: tuple[int, ...] | None = None  # which joints have the channel; None for all

    def because(self, why: str, instead_of: str = "", **changes: Any) -> Guess:
        """Return the guess with changes and their reason; reasons that contain `instead_of` are
        removed."""
        kept = [reason for reason in self.reasons if not instead_of or instead_of not in reason]
        return replace(self, reasons=(*kept, why), **changes)


@dataclass(frozen=True)
class Draft:
    """A draft of a mapping."""

    joints: tuple[str, ...]  # names
    times: TimeArray | None  # none where no array looks like times
    channels: tuple[Guess, ...]  # what was recognised
    ignored: tuple[tuple[str, str], ...]  # arrays left out, and why
    runs: tuple[str, int] | None = None  # array that numbers several runs, and how many there are
    decimal: str = "."
    calibration: str | None = None  # file that states the ranges of positions in per cent

    @property
    def missing(self) -> list[str]:
        """The entries that have to be filled in before the mapping can be used."""
        words = [] if self.times is not None else ["times.rate"]
        if not any(
            guess.channel == "position" and guess.side != "command" for guess in self.channels
        ):
            words.append("a position of link or motor; no array resembles one")
        return words + [f"{g.side}.{g.channel}.{key}" for g in self.channels for key in g.missing]

    def to_yaml(self) -> str:
        """Return the text of the mapping file, with the reasons as comments."""
        lines = [
            (
                "# Draft of an array mapping, guessed from the numbers and names of the"
                " arrays. Check every line and"
            )
        ]
        lines += [
            "# correct it (docs/channel_maps.md). Signs and zeros of the joints cannot be guessed."
        ]
        lines += self._times_lines()
        if self.runs is not None:
            key, count = self.runs
            comment = f"# {count} runs, one bag each; value: N selects one"
            lines += [f"rows: {_inline({'key': key})}          {comment}"]
        if self.decimal != ".":
            lines += [f"decimal: {_inline(self.decimal)}"]
        lines += [f"joints: {_inline(list(self.joints))}"]
        if self.calibration is not None:
            lines += [f"calibration: {_inline(self.calibration)}"]
        for side in SIDE_NAMES:
            if chosen := [guess for guess in self.channels if guess.side == side]:
                lines.append(f"{side}:")
                for guess in chosen:
                    lines += _channel_lines(guess, self.joints)
        lines.append("ignore:" if self.ignored else "ignore: []")
        lines += [
            f"  - {_inline(key)}    # {_comment(reason)}"
            for key, reason in self._ignored_patterns()
        ]
        return "\n".join(lines) + "\n"

    def _times_lines(self) -> list[str]:
        if self.times is None:
            named = [
                f"# {_comment(key)} is named like times, but {_comment(reason)}."
                for key, reason in self.ignored
                if TIME_NAME.search(key)
            ]
            asked = "# No array resembles times: give the sample rate, Hz."
            return [*named, asked, "times: {rate: }"]
        times = _inline({"key": self.times.key, "unit": self.times.unit})
        if self.times.fault:
            fault = f"# {_comment(self.times.fault)}: bag import refuses these times."
            return [fault, *_FAULTY_TIMES, f"times: {times}"]
        return [f"times: {times}          # {self.times.rate:.6g} Hz"]

    def _ignored_patterns(self) -> list[tuple[str, str]]:
        """Return the arrays left out; counted names, and structs without a used array, become one
        pattern."""
        left_out = {key for key, _ in self.ignored}
        used = [key for guess in self.channels for key in guess.table.keys if key not in left_out]
        used += [] if self.times is None else [self.times.key]
        patterns: dict[str, list[str]] = {}
        for key, reason in self.ignored:
            stem = f"{key.rpartition('.')[0]}." if "." in key else re.sub(r"\d+\D*$", "", key)
            whole = not stem or stem == key or any(name.startswith(stem) for name in used)
            patterns.setdefault(key if whole else f"{stem}*", []).append(reason)
        return [
            (pattern, "; ".join(dict.fromkeys(reasons))) for pattern, reasons in patterns.items()
        ]


def _channel_lines(guess: Guess, joints: Sequence[str]) -> list[str]:
    table = guess.table
    places = range(len(joints)) if guess.places is None else guess.places
    keys: dict[str, object] = {}
    if len(table.keys) > 1:
        keys["key"] = [table.keys[k] for k in places]
    else:
        keys["key"] = table.keys[0]
    if guess.places is not None:
        keys["joints"] = [joints[k] for k in places]
    if len(table.keys) == 1 and (table.columns is not None or guess.places is not None):
        columns = range(len(joints)) if table.columns is None else table.columns
        keys["columns"] = [columns[k] for k in places]
    if table.flat:
        keys["flat"] = True
    if guess.units or guess.unit:
        keys["unit"] = [guess.units[k] for k in places] if guess.units else guess.unit
    for name, values in guess.scales.items():
        number = int if name == "sign" else float
        keys[name] = [number(values[k]) for k in places]
    lines = [f"  # {_comment(reason)}" for reason in guess.reasons]
    lines.append(f"  {guess.channel}:")
    lines += [f"    {key}: {_inline(value)}" for key, value in keys.items()]
    lines += [f"    {key}:    # fill in: {what}" for key, what in guess.missing.items()]
    return lines


def _comment(text: str) -> str:
    """Return text on one line, because names of arrays may contain line breaks."""
    return " ".join(text.split())


def _inline(value: object) -> str:
    """Return YAML on one line."""
    return (
        yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
        .removesuffix("...\n")
        .strip()
    )
