"""Estimates as text: no more digits than their standard deviations warrant."""

from __future__ import annotations

import math

MOST_DIGITS = 7  # significant, however small the deviation
LARGEST_PLAIN = 1e7  # from here on with a power of ten


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return a value and its standard deviation as text: the deviation with two digits, the value to the same place.

    Where no deviation is known (zero or not finite), the value has four digits.
    """
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:.4g}", f"{std:.2g}"
    place, plain = _place(float(f"{std:.1e}")) - 1, max(abs(value), std) < LARGEST_PLAIN
    return _to_place(value, place, plain), _to_place(std, place, plain)


def _place(value: float) -> int:
    """Return the power of ten of the first digit."""
    return math.floor(math.log10(abs(value)))


def _to_place(value: float, place: int, plain: bool) -> str:
    near = round(value, -place)
    if near == 0.0:
        return "0"
    digits = min(_place(near) - place + 1, MOST_DIGITS)
    text = f"{near:#.{digits}g}".removesuffix(".")  # "#" keeps the zeros at the end, which are digits too
    return f"{near:.0f}" if "e+" in text and plain else text
