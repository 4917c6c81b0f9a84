"""A hypothesis: a set of candidates that explains the gap, and what could stand in the place of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary

# What distinguishes a feature: effect, joint, choices.
Key = tuple[str, str | None, tuple[Any, ...]]


def misfit(library: RegressorLibrary, selected: Sequence[Candidate]) -> float:
    """Mean square of what is left, whitened, over both data sets: 1 for a complete hypothesis, more for others."""
    left = library.squares_left(selected) / sum(e.freedom for e in library.sets)
    return max(1.0, left) if np.isfinite(left) else np.inf


@dataclass(frozen=True)
class Rival:
    """A candidate that could stand in a cause's place, and its odds against it."""

    candidate: Candidate
    odds: float


@dataclass(frozen=True)
class Hypothesis:
    """A set of candidates with the coefficients that the identification data give.

    Parameters
    ----------
    selected
        The candidates, those that count as part of the model first.
    given
        How many of them count as part of the model.
    rivals
        Alternatives of each cause, by position in `selected`, most probable first.
    beyond
        Keys of the causes that nuisance parameters far from their priors could hold as well.
    """

    selected: Sequence[Candidate]
    given: int = 0
    rivals: Mapping[int, Sequence[Rival]] = field(default_factory=dict)
    beyond: frozenset[Key] = frozenset()

    @property
    def baseline(self) -> list[Candidate]:
        """The candidates that count as part of the model."""
        return list(self.selected[: self.given])

    @property
    def causes(self) -> range:
        """Positions of the causes in `selected`."""
        return range(self.given, len(self.selected))

    def without(self, k: int) -> list[Candidate]:
        """Return the candidates but the one at position k."""
        return [*self.selected[:k], *self.selected[k + 1 :]]

    def drop(self, k: int) -> Hypothesis:
        """Return the hypothesis without the cause at position k."""
        rivals = {i - (i > k): found for i, found in self.rivals.items() if i != k}
        return Hypothesis(self.without(k), self.given, rivals, self.beyond)

    def only(self, keys: Iterable[Key]) -> Hypothesis:
        """Return the hypothesis with those of its causes alone that have one of these keys."""
        wanted, found = set(keys), self
        for k in reversed(self.causes):
            if self.selected[k].feature.key not in wanted:
                found = found.drop(k)
        return found
