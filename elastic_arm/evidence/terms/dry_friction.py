"""Dry friction of a real joint beside that of its law.

It turns over within a distance, and its curve bends by some percent
(:mod:`elastic_arm.equations.dry_friction`). The friction of most drives does so, that of a
simulated arm may not: the odds are even.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.dry_friction import (
    DISTANCES,
    SHAPES,
    Curve,
    FrictionPlace,
    curve_over,
    dry_friction_columns,
    places_of_friction,
)
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import CURVE, TURNOVER
from elastic_arm.evidence.terms.term import Coefficients, Term

SHARES = len(DISTANCES)


@dataclass(frozen=True, eq=False)
class DryFrictionTerm(Term):
    """How the dry friction at a side of a joint differs from its law; no cause, and nothing
    unknown."""

    place: FrictionPlace = None  # type: ignore[assignment]
    # (SHARES,) of it that turn over within each distance, where its curve is linearised
    turned: Array = None  # type: ignore[assignment]
    curve: Curve = None  # type: ignore[assignment]  # of all recordings

    kind = "dry friction"
    says_cause = False

    @property
    def _details(self) -> tuple[float, ...]:
        """Its columns are those of a curve linearised where so much of it turns over."""
        return tuple(self.turned.tolist())

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds."""
        return 0.0

    def scaled(self, scale: float) -> "DryFrictionTerm":
        """Return it as it is: a share of the friction has one scale."""
        return self

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, none where no dry friction acts there."""
        return _at(linear, self.place, fit.beta(self)[:SHARES])

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        each = _columns(linear, self.place, self.turned, self.curve)
        return [self.curve.less(columns) for columns in each]


def dry_friction_terms(linear: Linearisation) -> Iterator[DryFrictionTerm]:
    """Yield the terms of all places at which dry friction acts, made once; their curves are
    linearised where it turns over at once."""
    made: dict[FrictionPlace, list[DryFrictionTerm]] = linear.cache.setdefault("dry friction", {})
    for place in places_of_friction(linear.acting):
        if place not in made:
            made[place] = _at(linear, place, np.zeros(SHARES))
        yield from made[place]


def _at(linear: Linearisation, place: FrictionPlace, turned: Array) -> list[DryFrictionTerm]:
    """Return the term of a place, none where no dry friction acts."""
    over = curve_over(linear.data, linear.model.robot, place)
    each = _columns(linear, place, turned, over)
    if not each:
        return []
    white = linear.data.whiten(each)
    curve = over.of_rows(white)
    unbounded = np.full(SHAPES, -np.inf)
    term = DryFrictionTerm(
        ("dry_friction", place.joint, (("side", place.side),)),
        curve.less(white),
        np.append(np.full(SHARES, TURNOVER), np.full(SHAPES, CURVE)),
        low=np.append(np.zeros(SHARES), unbounded),
        place=place,
        turned=turned,
        curve=curve,
    )
    return [term]


def _columns(
    linear: Linearisation, place: FrictionPlace, turned: Array, curve: Curve
) -> list[Array]:
    """Return the columns (N', R, SHARES + SHAPES + LAWS) of each stretch, Nm."""
    return dry_friction_columns(
        linear.data, linear.model.robot, linear.acting, place, turned, curve
    )
