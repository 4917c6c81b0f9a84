"""What the gap is measured by: residuals that stand out of their noise, or, where none does, likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from elastic_arm.diagnosis.inference import excess as shrinking
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary

DETECTED = 20.0  # held-out log-likelihood from which something shows although no residual stands out of the noise

Share = tuple[float, tuple[float, float]]


class Measure(Protocol):
    """How much of the gap causes take away.

    Parameters
    ----------
    name
        "excess" or "likelihood".
    before
        Sizes of the residuals that the model leaves, in the band in which they are shown.
    """

    name: str
    before: shrinking.ResidualStatistics

    def stands_out(self, selected: Sequence[Candidate]) -> bool:
        """Whether any residual that candidates leave is more than noise by its size."""

    def share(self, selected: Sequence[Candidate]) -> Share:
        """Return the share of the gap that candidates take away, and its 95 % interval over blocks."""

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap."""


class Excess:
    """What significant residuals hold beyond their noise in one band of the validation data: the contract's measure.

    Parameters
    ----------
    library
        Of all columns.
    before
        The residuals that the model leaves, and which of them are significant.
    tried
        The same in all bands.
    """

    name = "excess"

    def __init__(
        self,
        library: RegressorLibrary,
        before: shrinking.ResidualStatistics,
        tried: Sequence[shrinking.ResidualStatistics],
    ) -> None:
        self.library, self.before = library, before
        self._after: dict[tuple[tuple[Candidate, ...], float], shrinking.ResidualStatistics] = {}
        self._clear = [before, *(f for f in tried if f is not before and f.clarity > shrinking.CLEAR)]

    def after(self, selected: Sequence[Candidate], band: float | None = None) -> shrinking.ResidualStatistics:
        """Return what candidates leave, in the same band if none is named."""
        key = (tuple(selected), band or self.before.band)
        if key not in self._after:
            judge = self.library.sets[1]
            left = shrinking.remaining(judge, selected, self.library.fit(0, selected))
            self._after[key] = shrinking.figures(judge, left, key[1])
        return self._after[key]

    def stands_out(self, selected: Sequence[Candidate]) -> bool:
        """Whether any residual that candidates leave is more than noise by its size."""
        return bool(self.after(selected).significant.any())

    def share(self, selected: Sequence[Candidate]) -> Share:
        """Return the share of the gap that candidates take away, and its 95 % interval over blocks."""
        return shrinking.shrink(self.before, self.after(selected))

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap.

        What is fast may be nothing in a low band, and what is slow nothing in a wide one: the band in which it is most.
        """
        without = [*selected[:k], *selected[k + 1 :]]
        return max(
            shrinking.contribution(before, self.after(without, before.band), self.after(selected, before.band))
            for before in self._clear
        )


class Likelihood:
    """What all equations together say, be each residual too noisy to show it.

    An effect may show in a combination of equations alone: the noise of a torque sensor is common to three of them. And
    a faint excess is known far worse than the fall that a cause brings, as the noise's size is an estimate. So the gap
    is the held-out log-likelihood of the best explanation, and of the structure that it leaves.

    Parameters
    ----------
    library
        Of all columns.
    before
        The residuals that the model leaves, to be shown.
    baseline
        What counts as part of the model.
    best
        The best explanation, the baseline first.
    left
        Held-out log-likelihood of what `best` leaves.
    """

    name = "likelihood"

    def __init__(
        self,
        library: RegressorLibrary,
        before: shrinking.ResidualStatistics,
        baseline: Sequence[Candidate],
        best: Sequence[Candidate],
        left: float,
    ) -> None:
        self.library, self.before, self.baseline = library, before, list(baseline)
        self.whole = max(self.gain(best), DETECTED) + max(left, 0.0)

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
        if len(selected) == len(self.baseline):
            return 0.0, (0.0, 0.0)
        falls = 0.5 * np.concatenate(self.library.falls(self.baseline, selected))
        gain = self.gain(selected)
        whole = max(self.whole, gain)
        low, high = shrinking.lowest(falls) * len(falls), -shrinking.lowest(-falls) * len(falls)
        share = gain / whole
        return share, (min(low / (whole + DETECTED), share), max(min(high / whole, 1.0), share))

    def contribution(self, selected: Sequence[Candidate], k: int) -> float:
        """Return what candidate k takes away beside the others, as a share of the whole gap."""
        return (self.gain(selected) - self.gain([*selected[:k], *selected[k + 1 :]])) / self.whole
