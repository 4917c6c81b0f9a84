"""The gap of every joint and side by itself.

A sum of Nm² is decided by the largest joints: causes that explain an arm's shoulder may leave its wrist as it was. So
each residual is judged by the share of its own excess that is gone, and by its own noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.inference.excess import ResidualStatistics, statistics_in_bands
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlaceGap:
    """What one residual holds beyond its noise, before and after.

    Parameters
    ----------
    row
        Number of the residual: side times joints plus joint.
    band
        Hz, upper edge of the band in which it is measured.
    before, after
        Its excess, Nm².
    significant_before, significant_after
        Whether it is more than noise.
    """

    row: int
    band: float
    before: float
    after: float
    significant_before: bool
    significant_after: bool

    @property
    def shrink(self) -> float | None:
        """Share of its own excess that is gone; None where there was none. Below zero, it has grown."""
        if not self.significant_before or not self.before:
            return None
        return 1.0 - self.after / self.before

    def is_open(self, left: float) -> bool:
        """Whether more than a share of its own excess is left and is more than noise.

        Parameters
        ----------
        left
            Largest share that may be left.
        """
        return self.significant_after and (self.shrink is None or self.shrink < 1.0 - left)


def place_gaps(
    data: WhitenedData, before: Sequence[Array], after: Sequence[Array], settings: DiagnosisSettings
) -> list[PlaceGap]:
    """Measure every residual by itself, in the widest band in which its own excess is clear, else the clearest.

    Parameters
    ----------
    data
        The validation data.
    before, after
        Residuals (N', R) of each stretch without and with the causes, Nm.
    settings
        Thresholds of significance, bands and seeds.
    """
    pairs = list(
        zip(statistics_in_bands(data, before, settings), statistics_in_bands(data, after, settings), strict=True)
    )
    return [_place_gap(row, pairs, settings) for row in range(data.layout.rows)]


def shares_of_causes(prepared: PreparedData, hypothesis: Hypothesis, places: Sequence[PlaceGap]) -> dict[Key, float]:
    """Return by key how much of the gap is gone at the joints and sides at which each cause acts, where there is any.

    An incomplete hypothesis may owe a cause to what it lacks there. Friction of a wrist is not in doubt because a
    shoulder lacks something.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        The causes.
    places
        The gap of every residual; none where no residual shows it.
    """
    found: dict[Key, float] = {}
    before = np.array([place.before if place.significant_before else 0.0 for place in places])
    after = np.array([place.after for place in places])
    coefficients = prepared.library.coefficients(hypothesis.selected)
    for k in hypothesis.causes if places else ():
        candidate = hypothesis.selected[k]
        columns = prepared.validation.plain(candidate.feature, candidate.searched or ())
        power = np.sum([np.sum((part @ coefficients[k]) ** 2, axis=0) for part in columns], axis=0)
        rows = power > prepared.settings.judgement.main_share * power.sum()
        if before[rows].any():
            found[candidate.feature.key] = max(0.0, 1.0 - float(after[rows].sum() / before[rows].sum()))
    return found


def _place_gap(
    row: int, pairs: Sequence[tuple[ResidualStatistics, ResidualStatistics]], settings: DiagnosisSettings
) -> PlaceGap:
    guard, clear = settings.significance.noise_guard, settings.significance.clear
    own = np.arange(len(pairs[0][0].rmse)) == row

    def clarity(pair: tuple[ResidualStatistics, ResidualStatistics]) -> float:
        return pair[0].of(own & pair[0].significant).clarity(guard)

    was, now = next((pair for pair in pairs if clarity(pair) > clear), max(pairs, key=clarity))
    return PlaceGap(
        row,
        was.band,
        float(was.excess[row]),
        float(now.excess[row]),
        bool(was.significant[row]),
        bool(now.significant[row]),
    )
