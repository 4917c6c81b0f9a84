"""A hypothesis: a set of candidates that explains the gap, and what could stand in the place of each.

Several choices may span the same columns, as springs of any rest angle do beside a wrong zero of their joint. Then
their log-likelihoods differ by rounding alone, which must decide nothing: the one that comes first in the order of the
library is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary

# What distinguishes a feature: effect, joint, choices.
Key = tuple[str, str | None, tuple[Any, ...]]
Choice = TypeVar("Choice")

ROUNDING = 1e-9  # of a log-likelihood, relative to the squares of the residual, with ill-conditioned sets; numerical


def misfit(library: RegressorLibrary, selected: Sequence[Candidate]) -> float:
    """Mean square of what is left, whitened, over both data sets: 1 for a complete hypothesis, more for others."""
    left = library.squares_left(selected) / sum(e.freedom for e in library.sets)
    return max(1.0, left) if np.isfinite(left) else np.inf


def tie_of(library: RegressorLibrary) -> float:
    """Return by how many nats hypotheses of a library may differ that explain equally much."""
    return ROUNDING * library.squares_left(())


def best_first(scores: NDArray[np.float64], tie: float) -> NDArray[np.intp]:
    """Return the numbers (M,) of choices, the best first and equal ones in their order.

    Parameters
    ----------
    scores
        (M,) nats.
    tie
        Nats up to which two choices that follow each other are equal.
    """
    order = np.argsort(-scores, kind="stable")
    worse = np.diff(scores[order], prepend=scores[order[:1]]) < -tie
    return order[np.lexsort((order, np.cumsum(worse)))]


def first_best(choices: Iterable[Choice], score: Callable[[Choice], float], tie: float) -> Choice:
    """Return the first of the choices that none is better than.

    Parameters
    ----------
    choices
        At least one.
    score
        Of a choice, nats.
    tie
        Nats up to which two choices are equal.
    """
    found = list(choices)
    return found[best_first(np.array([score(one) for one in found]), tie)[0]]


@dataclass(frozen=True)
class Rival:
    """A candidate that could stand in a cause's place, and its odds against it."""

    candidate: Candidate
    odds: float


class Rivals(Sequence[Rival]):
    """What could stand in a cause's place, looked for when it is first asked for: of most causes it never is.

    Parameters
    ----------
    look
        Finds them, the most probable first.
    """

    def __init__(self, look: Callable[[], Sequence[Rival]]) -> None:
        self._look = look

    @cached_property
    def _found(self) -> Sequence[Rival]:
        return self._look()

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, k: Any) -> Any:
        return self._found[k]


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
