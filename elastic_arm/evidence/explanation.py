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
    """What is most probably there, at the linearisation beside it."""

    linear: Linearisation  # where
    search: Search  # all sets met
    best: Fit  # the most probable one
    path: Sequence[Fit]  # better and better sets on the way to it
    # The sets that share the probability, each under every trust in the description; most probable
    # first.
    sets: Sequence[tuple[float, Fit]] = ()
    log: tuple[str, ...] = ()  # what was done, a line a step
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
        """Let go of what may be added at its linearisation, which takes most of the memory, and
        return it."""
        for name in ("pool", "laws", "refined"):
            self.linear.cache.pop(name, None)
        return self

    def probability(self, held: Callable[[Key], bool]) -> float:
        """Return the probability of the sets that hold a term whose key is one of those."""
        found = 0.0
        for p, fit in self.sets:
            if any(held(key) for key in fit.keys):
                found += p
        return found

    @cached_property
    def sized(self) -> Fit:
        """The most probable set with its sizes by the recordings that are fitted."""
        return self.best.model.of_fitted(self.best)

    @cached_property
    def settled(self) -> Linearisation:
        """The linearisation at the numbers of the most probable set, which may have been met beside
        another."""
        return moved(self.linear, self.sized) if is_far(self.sized) else self.linear


def weighted(fits: Sequence[Fit]) -> list[tuple[float, Fit]]:
    """Return fits with their probabilities, the most probable first."""
    scores = np.array([fit.score for fit in fits])
    p = np.exp(scores - logsumexp(scores))
    return sorted(zip(p.tolist(), fits, strict=True), key=lambda one: -one[0])
