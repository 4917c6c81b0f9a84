"""What effects that act, but need not be there, add to the columns of some numbers."""

from dataclasses import dataclass

import numpy as np

from elastic_arm.equations.number_columns import shared_columns
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.terms.term import Term


@dataclass(frozen=True, eq=False)
class ShareTerm(Term):
    """The share of an effect in the columns of numbers: gone where the effect is not there."""

    numbers: tuple[int, ...] = ()  # of whose columns it is a part

    kind = "share"
    says_cause = False

    @property
    def moved(self) -> list[int]:
        """The numbers, as an index."""
        return list(self.numbers)


def shares_of(linear: Linearisation) -> tuple[ShareTerm, ...]:
    """Return the shares of all effects that act at a linearisation and need not be there."""
    found = []
    for e, effect in enumerate(linear.acting):
        if effect.known:
            continue
        numbers, plain = shared_columns(linear.data, linear.problem.numbers, linear.features, e)
        if numbers:
            X = linear.data.whiten(plain)
            std = np.zeros(len(numbers))
            found.append(ShareTerm(effect.feature.key, X, std, numbers=tuple(numbers)))
    return tuple(found)
