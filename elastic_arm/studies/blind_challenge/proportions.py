"""Shares with their binomial intervals, smallest detected sizes, and the calibration of confidences."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

Array = NDArray[np.float64]

DETECTED = 0.9  # share of cases
# Where a detection curve may have its middle (multiples of the bound) and how steep it may be (a factor e in size).
MIDDLES = np.linspace(np.log(0.3), np.log(1000.0), 240)
SLOPES = np.geomspace(1.0, 30.0, 60)
BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Proportion:
    """Successes of trials."""

    hits: int
    trials: int

    @staticmethod
    def of(outcomes: Sequence[Any]) -> Proportion:
        """Count outcomes that hold."""
        return Proportion(sum(bool(o) for o in outcomes), len(outcomes))

    @property
    def value(self) -> float | None:
        """Share of successes, None without trials."""
        return self.hits / self.trials if self.trials else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % (Clopper-Pearson)."""
        if not self.trials:
            return None
        found = binomtest(self.hits, self.trials).proportion_ci(0.95, "exact")
        return float(found.low), float(found.high)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"hits": self.hits, "trials": self.trials, "share": self.value, "interval": self.interval}


@dataclass(frozen=True)
class DetectionCurve:
    """Probability of detection over the size in multiples of the bound: a logistic function of its logarithm."""

    # middle, slope: The most probable
    middle: float
    slope: float
    # smallest, low, high: Size detected in 90 % of cases: median and 95 % interval of what the cases leave possible
    smallest: float
    low: float
    high: float

    def __call__(self, multiple: Array) -> Array:
        """Return the probability at these sizes."""
        return 1.0 / (1.0 + np.exp(-self.slope * (np.log(multiple) - self.middle)))


def detection(multiples: Sequence[float], detected: Sequence[bool]) -> DetectionCurve | None:
    """Fit the curve of detection; None without cases.

    Middle and slope are weighed on a grid by their likelihood, with no preference (in their logarithms), so that cases
    that were all detected, or parted by a sharp edge, give bounds instead of failing.
    """
    if not multiples:
        return None
    x = np.log(np.maximum(multiples, 1e-3))
    argument = SLOPES[:, None, None] * (x - MIDDLES[:, None])
    sign = np.where(np.asarray(detected, dtype=bool), -1.0, 1.0)
    likelihood = -np.logaddexp(0.0, sign * argument).sum(axis=2)
    weight = np.exp(likelihood - likelihood.max())
    smallest = (MIDDLES + np.log(DETECTED / (1.0 - DETECTED)) / SLOPES[:, None]).ravel()
    order = np.argsort(smallest)
    below = np.cumsum(weight.ravel()[order])
    low, median, high = np.interp([0.025, 0.5, 0.975], below / below[-1], smallest[order])
    best = np.unravel_index(np.argmax(likelihood), likelihood.shape)
    return DetectionCurve(
        float(MIDDLES[best[1]]), float(SLOPES[best[0]]), *(float(np.exp(v)) for v in (median, low, high))
    )


def calibration(confidences: Sequence[float], right: Sequence[bool]) -> list[dict[str, Any]]:
    """Compare confidences with how often causes that had them were right, bin by bin."""
    given, held = np.asarray(confidences, dtype=float), np.asarray(right, dtype=bool)
    rows = []
    for low, high in itertools.pairwise(BINS):
        inside = (given >= low) & ((given < high) | (high == BINS[-1]))
        if inside.any():
            share = Proportion(int(held[inside].sum()), int(inside.sum()))
            rows.append({"from": low, "to": high, "mean_confidence": float(given[inside].mean()), **share.to_dict()})
    return rows
