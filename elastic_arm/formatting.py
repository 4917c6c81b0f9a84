"""Estimates as text, with as many digits as their standard deviations warrant."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

MOST_DIGITS = 7  # significant, however small the deviation
LARGEST_PLAIN = 1e7  # from here on with a power of ten


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return a value and its standard deviation as text.

    The deviation with two digits, the value to the same place.

    Where no deviation is known (zero or not finite), the value has four digits.
    """
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:.4g}", f"{std:.2g}"
    place = _place(float(f"{std:.1e}")) - 1
    plain = max(abs(value), std) < LARGEST_PLAIN
    return _to_place(value, place, plain), _to_place(std, place, plain)


def counted(count: int, what: str) -> str:
    """Return a number of things in words, such as "1 event" or "2 events"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def short_numbers(values: Iterable[float]) -> str:
    """Return numbers with three digits each, in a row."""
    return " ".join(f"{value:.3g}" for value in values)


def linear_unit(unit: str) -> str:
    """Return the unit at a prismatic joint for `unit` at a revolute one.

    N for Nm, m for rad.
    """
    return unit.replace("Nm", "N").replace("rad", "m")


@dataclass(frozen=True)
class JointUnits:
    """Units of quantities at the joints of an arm, of which some may be prismatic."""

    joints: Sequence[str]  # names of all
    prismatic: Collection[str] = ()  # names of those that slide

    def at(self, joint: str | None, unit: str) -> str:
        """Return the unit at one joint, from that at a revolute one.

        Unchanged for the whole arm.
        """
        return linear_unit(unit) if joint in self.prismatic else unit

    def over(self, unit: str) -> str:
        """Return the unit of a table over all joints, from that at a revolute one."""
        sliding = [joint for joint in self.joints if joint in self.prismatic]
        if not sliding:
            return unit
        if len(sliding) == len(self.joints):
            return linear_unit(unit)
        return f"{unit} ({linear_unit(unit)} at {', '.join(sliding)})"


def _place(value: float) -> int:
    """Return the power of ten of the first digit."""
    return math.floor(math.log10(abs(value)))


def _to_place(value: float, place: int, plain: bool) -> str:
    near = round(value, -place)
    if near == 0.0:
        return "0"
    digits = min(_place(near) - place + 1, MOST_DIGITS)
    text = f"{near:#.{digits}g}".removesuffix(".").replace(
        ".e", "e"
    )  # "#" keeps zeros at the end: digits, too
    return f"{near:.0f}" if "e+" in text and plain else text
