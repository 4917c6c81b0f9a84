"""The result of a search: sets of terms with their probabilities.

P(S | y) = exp(score(S)) / sum over all sets S' of exp(score(S'))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.gauss_newton import is_far, moved
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.search import Search


@dataclass(frozen=True, eq=False)
class Explanation:
    """The most probable set of terms, and all other sets, at one linearisation."""

    linear: Linearisation
    search: Search  # contains all scored sets
    best: Fit  # the most probable set
    path: Sequence[Fit]  # better and better sets on the way to the best one
    # Sets with their probabilities, each under every trust in the description; the most probable
    # first.
    sets: Sequence[tuple[float, Fit]] = ()
    log: tuple[str, ...] = ()  # steps of the search, one line each
    is_whole: bool = True  # whether all moves were tried

    @cached_property
    def trust(self) -> dict[str, float]:
        """The probability of each trust in the description."""
        found: dict[str, float] = {}
        for p, fit in self.sets:
            trust = fit.model.assumed.trust
            found[trust] = found.get(trust, 0.0) + p
        return found

    def without_screens(self) -> Explanation:
        """Discard the screens of candidates, which take most of the memory, and return self."""
        for name in ("pool", "laws", "refined"):
            self.linear.cache.pop(name, None)
        return self

    def probability(self, held: Callable[[Key], bool]) -> float:
        """Return the probability of the sets with a term whose key fulfils a condition."""
        found = 0.0
        for p, fit in self.sets:
            if any(held(key) for key in fit.keys):
                found += p
        return found

    @cached_property
    def sized(self) -> Fit:
        """The most probable set with sizes from the fitted recordings only."""
        return self.best.model.of_fitted(self.best)

    @cached_property
    def settled(self) -> Linearisation:
        """The linearisation at the numbers of the most probable set, which may have been scored at
        another one."""
        return moved(self.linear, self.sized) if is_far(self.sized) else self.linear


def weighted(fits: Sequence[Fit]) -> list[tuple[float, Fit]]:
    """Return fits with their probabilities, the most probable first."""
    scores = np.array([fit.score for fit in fits])
    p = np.exp(scores - logsumexp(scores))
    return sorted(zip(p.tolist(), fits, strict=True), key=lambda one: -one[0])
