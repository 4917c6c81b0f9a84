"""What the gap is measured by: residuals that stand out of their noise, or, where none does, likelihood."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.bootstrap import lower_bound
from elastic_arm.diagnosis.inference import excess
from elastic_arm.diagnosis.inference.excess import ResidualStatistics
from elastic_arm.diagnosis.inference.faults import LargeImperfection, with_faults
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFitTest
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings

Array = NDArray[np.float64]
Share = tuple[float, tuple[float, float]]


def gap_measure(
    prepared: PreparedData,
    hypothesis: Hypothesis,
    test: LackOfFitTest,
    faults: Sequence[LargeImperfection] = (),
    refuted: Sequence[LargeImperfection] = (),
    *,
    mounted: bool = False,
) -> GapMeasure:
    """Return what the gap is measured by: residuals where any stands out by its size, else likelihood.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        The best hypothesis of the search.
    test
        Finds what the hypothesis leaves.
    faults
        Of sensors: part of the gap.
    refuted
        Those of them that are no causes: what they take stays.
    mounted
        Whether it is that of the arm as its torques show it mounted, else as described.
    """
    settings, library = prepared.settings, prepared.library
    residuals_of = library.validation_residuals if mounted else prepared.described_residuals
    residuals = with_faults(residuals_of(hypothesis.baseline), faults)
    tried = excess.statistics_in_bands(prepared.validation, residuals, settings)
    shown = _residuals_of_causes(prepared, hypothesis)
    if excess.select_band(tried, settings.significance) is not None:
        marked = _marked(prepared, hypothesis, tried, shown)
        before = excess.select_band(marked, settings.significance, shown)
        assert before is not None  # marking takes nothing away
        return ExcessMeasure(library, before, marked, settings, refuted)
    unexplained = test(hypothesis.baseline)
    before = excess.band_of_largest_excess(tried, unexplained[0].row) if unexplained else tried[0]
    left = max((found.gain for found in test(hypothesis.selected)), default=0.0)
    left += sum(fault.gain for fault in refuted)
    explaining = [fault for fault in faults if fault not in refuted]
    return LikelihoodMeasure(library, before, hypothesis.baseline, hypothesis.selected, left, settings, explaining)


def _residuals_of_causes(prepared: PreparedData, hypothesis: Hypothesis) -> list[NDArray[np.bool_]]:
    """Return the residuals (R,) that each cause changes most."""
    library, found = prepared.library, []
    left = library.validation_residuals(hypothesis.selected)
    for k in hypothesis.causes:
        without = library.validation_residuals(hypothesis.without(k))
        power = sum(np.sum((a - b) ** 2, axis=0) for a, b in zip(without, left, strict=True))
        found.append(power > prepared.settings.judgement.main_share * np.sum(power))
    return found


def _marked(
    prepared: PreparedData,
    hypothesis: Hypothesis,
    tried: Sequence[ResidualStatistics],
    shown: Sequence[NDArray[np.bool_]],
) -> list[ResidualStatistics]:
    """Count residuals that causes change and make smaller as significant, even if they are not by size alone."""
    library, settings = prepared.library, prepared.settings
    gained = library.held_out(hypothesis.selected) - library.held_out(hypothesis.baseline)
    if not shown or gained < settings.significance.detected:
        return list(tried)
    residuals = library.validation_residuals(hypothesis.selected)
    after = excess.statistics_in_bands(prepared.validation, residuals, settings)
    anywhere = np.any(shown, axis=0)
    return [b.of(b.significant | (anywhere & excess.improved(b, a))) for b, a in zip(tried, after, strict=True)]


class GapMeasure(Protocol):
    """How much of the gap causes take away.

    Parameters
    ----------
    name
        "excess" or "likelihood".
    before
        Sizes of the residuals that the model leaves, in the band in which they are shown.
    """

    name: str
    before: ResidualStatistics

    def stands_out(self, selected: Sequence[Candidate]) -> bool:
        """Whether any residual that candidates leave is more than noise by its size."""

    def share(self, selected: Sequence[Candidate]) -> Share:
        """Return the share of the gap that candidates take away, and its 95 % interval over blocks."""

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap."""

    def place_contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as the largest share of a residual's own gap."""

    def share_of_fault(self, fault: LargeImperfection, alone: Sequence[Array]) -> float:
        """Return the share of the gap that a fault takes away, where `alone` (N', R) are the residuals without it."""

    def share_left(self, left: Sequence[Array]) -> float:
        """Return the share of the gap that is gone where these residuals (N', R) are left."""


class ExcessMeasure:
    """What significant residuals hold beyond their noise in one band of the validation data (docs/contract.md).

    Parameters
    ----------
    library
        Of all columns.
    before
        The residuals that the model leaves, and which of them are significant.
    tried
        The same in all bands.
    settings
        Thresholds and seeds.
    refuted
        Faults that are no causes: what they take stays.
    """

    name = "excess"

    def __init__(
        self,
        library: RegressorLibrary,
        before: ResidualStatistics,
        tried: Sequence[ResidualStatistics],
        settings: DiagnosisSettings,
        refuted: Sequence[LargeImperfection] = (),
    ) -> None:
        self.library, self.before, self._settings, self._refuted = library, before, settings, refuted
        self._after: dict[tuple[tuple[Candidate, ...], float], ResidualStatistics] = {}
        guard, clear = settings.significance.noise_guard, settings.significance.clear
        self._clear = [before, *(s for s in tried if s is not before and s.clarity(guard) > clear)]

    def after(self, selected: Sequence[Candidate], band: float | None = None) -> ResidualStatistics:
        """Return what candidates leave, in the same band if none is named."""
        key = (tuple(selected), band or self.before.band)
        if key not in self._after:
            left = with_faults(self.library.validation_residuals(selected), self._refuted)
            seed = self._settings.resampling.significance_seed
            statistics = excess.residual_statistics(self.library.sets[1], left, key[1], self._settings, seed)
            self._after[key] = statistics
        return self._after[key]

    def stands_out(self, selected: Sequence[Candidate]) -> bool:
        """Whether any residual that candidates leave is more than noise by its size."""
        return bool(self.after(selected).significant.any())

    def share(self, selected: Sequence[Candidate]) -> Share:
        """Return the share of the gap that candidates take away, and its 95 % interval over blocks."""
        resampling = self._settings.resampling
        return excess.shrink(self.before, self.after(selected), resampling, resampling.shrink_seed)

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap.

        What is fast may be nothing in a low band, and what is slow nothing in a wide one: the band in which it is most.
        """
        return max(excess.contribution(*statistics) for statistics in self._beside(selected, k))

    def place_contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as the largest share of a residual's own gap."""
        return max(excess.place_contribution(*statistics) for statistics in self._beside(selected, k))

    def _beside(
        self, selected: Sequence[Candidate], k: int
    ) -> Iterator[tuple[ResidualStatistics, ResidualStatistics, ResidualStatistics]]:
        """Yield what is left without any cause, without candidate k, and with all, in every clear band."""
        without = [*selected[:k], *selected[k + 1 :]]
        for before in self._clear:
            yield before, self.after(without, before.band), self.after(selected, before.band)

    def share_of_fault(self, fault: LargeImperfection, alone: Sequence[Array]) -> float:
        """Return the share of the gap that a fault takes away, where `alone` (N', R) are the residuals without it."""
        return self.share_left(alone)

    def share_left(self, left: Sequence[Array]) -> float:
        """Return the share of the gap that is gone where these residuals (N', R) are left."""
        settings, before = self._settings, self.before
        seed = settings.resampling.significance_seed
        after = excess.residual_statistics(self.library.sets[1], left, before.band, settings, seed)
        return excess.shrink(before, after, settings.resampling, settings.resampling.shrink_seed)[0]


class LikelihoodMeasure:
    """What all equations together show, where each residual is too noisy to show it.

    An effect may show in a combination of equations alone: the noise of a torque sensor is common to three of them. And
    a faint excess is known far worse than the fall that a cause brings, as the noise's size is an estimate. So the gap
    is the held-out log-likelihood of the best hypothesis, and of the structure that it leaves.

    Parameters
    ----------
    library
        Of all columns.
    before
        The residuals that the model leaves, to be shown.
    baseline
        What counts as part of the model.
    best
        The best hypothesis, the baseline first.
    left
        Held-out log-likelihood of what `best` leaves.
    settings
        Thresholds and seeds.
    faults
        Nuisance parameters beyond ordinary: part of the gap, and explained in every hypothesis.
    """

    name = "likelihood"

    def __init__(
        self,
        library: RegressorLibrary,
        before: ResidualStatistics,
        baseline: Sequence[Candidate],
        best: Sequence[Candidate],
        left: float,
        settings: DiagnosisSettings,
        faults: Sequence[LargeImperfection] = (),
    ) -> None:
        self.library, self.before, self.baseline, self._settings = library, before, list(baseline), settings
        self._of_faults = sum(fault.gain for fault in faults)
        self.whole = max(self.gain(best) + self._of_faults, settings.significance.detected) + max(left, 0.0)

    def stands_out(self, selected: Sequence[Candidate]) -> bool:
        """Return that no residual does."""
        return False

    def gain(self, selected: Sequence[Candidate]) -> float:
        """Return the held-out log-likelihood that candidates gain over the baseline."""
        return self.library.held_out(selected) - self.library.held_out(self.baseline)

    def share(self, selected: Sequence[Candidate]) -> Share:
        """Return the share of the gap that candidates take away, and its 95 % interval over blocks.

        At its lower end, something as large as what just stays undetected may be left.
        """
        if len(selected) == len(self.baseline) and not self._of_faults:
            return 0.0, (0.0, 0.0)
        falls = 0.5 * np.concatenate(self.library.falls(self.baseline, selected))
        gain = self.gain(selected) + self._of_faults
        whole = max(self.whole, gain)
        resampling, detected = self._settings.resampling, self._settings.significance.detected
        low = lower_bound(falls, resampling, resampling.fall_seed) * len(falls) + self._of_faults
        high = -lower_bound(-falls, resampling, resampling.fall_seed) * len(falls) + self._of_faults
        share = gain / whole
        return share, (min(low / (whole + detected), share), max(min(high / whole, 1.0), share))

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap."""
        return (self.gain(selected) - self.gain([*selected[:k], *selected[k + 1 :]])) / self.whole

    def place_contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return 0: no residual shows a gap by itself."""
        return 0.0

    def share_of_fault(self, fault: LargeImperfection, alone: Sequence[Array]) -> float:
        """Return the share of the gap that a fault takes away; its residuals show nothing."""
        return fault.gain / self.whole

    def share_left(self, left: Sequence[Array]) -> float:
        """Return 0: no residual shows a gap by itself."""
        return 0.0


def cumulative_shrink(
    measure: GapMeasure, baseline: Sequence[Candidate], causes: Sequence[Candidate]
) -> tuple[float, ...]:
    """Return how far the gap shrinks with the first cause, the first two, and so on.

    Parameters
    ----------
    measure
        What the gap is measured by.
    baseline
        What counts as part of the model.
    causes
        Most important first.
    """
    new = [[c for c in causes[: k + 1] if c not in baseline] for k in range(len(causes))]
    return tuple(measure.share([*baseline, *some])[0] for some in new)
