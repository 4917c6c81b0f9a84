"""A claim of the paper and its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

HOLDS, IN_PART, FAILS = "holds", "holds in part", "does not hold"


@dataclass(frozen=True)
class Claim:
    """A statement of the paper, and the verdict of the study on it."""

    key: str
    section: str
    claim: str
    finding: str
    verdict: str


def verdict(parts: Sequence[bool]) -> str:
    """Holds if all parts do, in part if some do."""
    return HOLDS if all(parts) else IN_PART if any(parts) else FAILS


def listed(values: np.ndarray | Sequence[float], digits: int = 2) -> str:
    """Write numbers, one a joint, in a row."""
    return ", ".join(f"{value:.{digits}g}" for value in np.atleast_1d(values))
