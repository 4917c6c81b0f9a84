"""Dry friction that turns over within a distance: the shares of it, by distance.

The friction of most drives does so, that of a simulated arm may not: the odds are even.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.presliding import DISTANCES, places_of_friction, turnover_columns
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import TURNOVER
from elastic_arm.evidence.terms.term import Coefficients, Term


@dataclass(frozen=True, eq=False)
class TurnoverTerm(Term):
    """How the dry friction at a side of a joint turns over; no cause, and nothing unknown."""

    joint: str = ""
    side: str = ""

    kind = "turnover"
    says_cause = False

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds."""
        return 0.0

    def scaled(self, scale: float) -> "TurnoverTerm":
        """Return it as it is: a share of the friction has one scale."""
        return self

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, none where no dry friction acts there."""
        return _at(linear, self.joint, self.side)

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        robot = linear.model.robot
        return turnover_columns(linear.data, robot, linear.acting, self.joint, self.side)


def turnover_terms(linear: Linearisation) -> Iterator[TurnoverTerm]:
    """Yield the terms of all places at which dry friction acts."""
    for joint, side in places_of_friction(linear.acting):
        yield from _at(linear, joint, side)


def _at(linear: Linearisation, joint: str, side: str) -> list[TurnoverTerm]:
    """Return the term of a joint and side, none where no dry friction acts; made once."""
    made: dict[tuple[str, str], list[TurnoverTerm]] = linear.cache.setdefault("turnover", {})
    if (joint, side) not in made:
        made[joint, side] = _made(linear, joint, side)
    return made[joint, side]


def _made(linear: Linearisation, joint: str, side: str) -> list[TurnoverTerm]:
    """Return the same, made anew."""
    plain = turnover_columns(linear.data, linear.model.robot, linear.acting, joint, side)
    if not plain:
        return []
    count = len(DISTANCES)
    term = TurnoverTerm(
        ("turnover", joint, (("side", side),)),
        linear.data.whiten(plain),
        np.full(count, TURNOVER),
        low=np.zeros(count),
        joint=joint,
        side=side,
    )
    return [term]
