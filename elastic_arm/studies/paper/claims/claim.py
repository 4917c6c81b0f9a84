"""A claim of the paper and its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

HOLDS, IN_PART, FAILS, UNDECIDED = "holds", "holds in part", "does not hold", "undecided"
# A difference counts from this number of its standard deviations on.
DECIDED = 2.0


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, and the verdict of the study on it.

    `by_choice` states which number of the arm file was chosen so that the claim holds; empty where none was.
    """

    key: str
    section: str
    claim: str
    finding: str
    verdict: str
    by_choice: str = ""


def verdict(parts: Sequence[bool | None]) -> str:
    """Holds if all parts do, in part if some do and others do not; undecided where that hangs on undecided ones."""
    known = {bool(part) for part in parts if part is not None}
    if len(known) == 2:
        return IN_PART
    if any(part is None for part in parts):
        return UNDECIDED
    return HOLDS if known == {True} else FAILS


def beyond_noise(difference: float, noise: float) -> bool | None:
    """Return whether a difference is above zero, or None where its noise (standard deviation) leaves that open."""
    return None if abs(difference) <= DECIDED * noise else difference > 0.0


def listed(values: np.ndarray | Sequence[float], digits: int = 2) -> str:
    """Write numbers, one a joint, in a row."""
    return ", ".join(f"{value:.{digits}g}" for value in np.atleast_1d(values))
