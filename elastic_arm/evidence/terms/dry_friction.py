"""Dry friction of a real joint beside that of its law.

It turns over within a distance, and its curve bends by some percent
(:mod:`elastic_arm.equations.dry_friction`). The friction of most drives does both. Many simulated
arms have neither, and some have one alone: each has a term of its own.

    P(a set of k out of n joints) = 1 / (n + 1) / C(n, k)

Every number k = 0..n of joints is equally likely, because the joints of an arm are alike: mostly
all of them differ from the laws, or none.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import comb, log

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.equations.dry_friction import (
    SHAPES,
    Curve,
    curve_columns,
    curve_over,
    places_of_friction,
    turnover_columns,
)
from elastic_arm.estimation.turnover import DISTANCES, FrictionPlace
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import CURVE, TURNOVER
from elastic_arm.evidence.terms.term import Coefficients, Term

SHARES = len(DISTANCES)


@dataclass(frozen=True, eq=False)
class DryFrictionTerm(Term):
    """How the dry friction at a side of a joint differs from its law; no cause, and nothing
    unknown."""

    place: FrictionPlace = None  # type: ignore[assignment]
    joints: int = 0  # of the arm

    says_cause = False

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of its prior odds alone; those of a set are :func:`choices`."""
        return 0.0

    def scaled(self, scale: float) -> "DryFrictionTerm":
        """Return it as it is: a share of the friction has one scale."""
        return self


@dataclass(frozen=True, eq=False)
class TurnoverTerm(DryFrictionTerm):
    """The shares of the dry friction that turn over within each distance."""

    kind = "turnover of friction"

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, none where no dry friction acts there."""
        return _turnover_at(linear, self.place)

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, SHARES) of each stretch, Nm."""
        return turnover_columns(linear.data, linear.model.robot, linear.acting, self.place)


@dataclass(frozen=True, eq=False)
class CurveTerm(DryFrictionTerm):
    """The bends of the curve of the dry friction."""

    # (SHARES,) of it that turn over within each distance
    turned: Array = None  # type: ignore[assignment]
    curve: Curve = None  # type: ignore[assignment]  # of all recordings

    kind = "curve of friction"

    @property
    def _details(self) -> tuple[float, ...]:
        """Its columns are those of friction of which so much turns over."""
        return tuple(self.turned.tolist())

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, none where no dry friction acts there."""
        turned = np.zeros(SHARES)
        for term in fit.terms:
            if isinstance(term, TurnoverTerm) and term.place == self.place:
                turned = fit.beta(term)
        return _curve_at(linear, self.place, turned)

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, SHAPES) of each stretch, Nm."""
        each = _curve_columns(linear, self.place, self.turned, self.curve)
        return [self.curve.less(columns) for columns in each]


def choices(terms: Sequence[Term]) -> float:
    """Return ln of the numbers of ways to choose the joints at which the friction of a set of terms
    turns over, and those at which it bends."""
    found = 0.0
    for kind in (TurnoverTerm, CurveTerm):
        own = [term for term in terms if isinstance(term, kind)]
        if own:
            k = len({term.place.joint for term in own})
            found += log(comb(own[0].joints, k))
    return found


def dry_friction_terms(linear: Linearisation) -> Iterator[DryFrictionTerm]:
    """Yield the terms of all places at which dry friction acts, made once; the curves are those of
    friction that turns over at once."""
    made: dict[FrictionPlace, list[DryFrictionTerm]] = linear.cache.setdefault("dry friction", {})
    for place in places_of_friction(linear.acting):
        if place not in made:
            at_once = np.zeros(SHARES)
            made[place] = [*_turnover_at(linear, place), *_curve_at(linear, place, at_once)]
        yield from made[place]


def _turnover_at(linear: Linearisation, place: FrictionPlace) -> list[DryFrictionTerm]:
    """Return the turnover at a place, none where no dry friction acts."""
    each = turnover_columns(linear.data, linear.model.robot, linear.acting, place)
    if not each:
        return []
    term = TurnoverTerm(
        _key("friction_turnover", place),
        linear.data.whiten(each),
        np.full(SHARES, TURNOVER),
        low=np.zeros(SHARES),
        place=place,
        joints=linear.model.robot.n,
    )
    return [term]


def _curve_at(linear: Linearisation, place: FrictionPlace, turned: Array) -> list[DryFrictionTerm]:
    """Return the curve at a place, none where no dry friction acts."""
    over = curve_over(linear.data, linear.model.robot, place)
    each = _curve_columns(linear, place, turned, over)
    if not each:
        return []
    white = linear.data.whiten(each)
    curve = over.of_rows(white)
    term = CurveTerm(
        _key("friction_curve", place),
        curve.less(white),
        np.full(SHAPES, CURVE),
        place=place,
        joints=linear.model.robot.n,
        turned=turned,
        curve=curve,
    )
    return [term]


def _key(what: str, place: FrictionPlace) -> Key:
    return (what, place.joint, (("side", place.side),))


def _curve_columns(
    linear: Linearisation, place: FrictionPlace, turned: Array, curve: Curve
) -> list[Array]:
    """Return the columns (N', R, SHAPES + LAWS) of each stretch, Nm."""
    return curve_columns(linear.data, linear.model.robot, linear.acting, place, turned, curve)
