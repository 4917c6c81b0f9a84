"""Numbers of the arm and its sensors that are far off, by their ordinary columns."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.effects.effect import Scope
from elastic_arm.equations.numbers import RATIO, SCALE, Number
from elastic_arm.evidence.body import Body
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import WIDE
from elastic_arm.evidence.terms.share import ShareTerm
from elastic_arm.evidence.terms.term import Coefficients, Term


@dataclass(frozen=True, eq=False)
class NumberTerm(Term):
    """Numbers that are far off: their prior is wide along some directions."""

    along: Array = None  # type: ignore[assignment]  # (K, k) how nu moves with the coefficients
    body: Body | None = None  # the link whose ten numbers it moves; None where it moves others

    kind = "number"

    @classmethod
    def of(
        cls, parameter: Number, N: Array, key: Key, along: Array, body: Body | None = None
    ) -> Self:
        """Return the term of numbers that move by (K, k) for each coefficient.

        parameter: the first of them; N: (rows, K) whitened columns for one standard deviation each;
        body: the link whose numbers they are.
        """
        low = np.full(along.shape[1], -np.inf)
        least = parameter.cause.linear[0].above if parameter.cause is not None else -np.inf
        if not parameter.is_logarithmic:
            # Ratios are positive, channels late.
            low[0] = 0.98 * (least - parameter.neutral) / parameter.prior_std
        std = np.full(along.shape[1], WIDE)
        return cls(
            key, _along(N, along), std, low=low, feature=parameter.cause, along=along, body=body
        )

    @property
    def moved(self) -> Array:
        """Which numbers (K,) it moves."""
        return np.asarray(self.along.any(axis=1))

    def log_existing(self, fit: Coefficients) -> float:
        """Return ln of the probability that the link is a body, where its ten numbers move."""
        if self.body is None:
            return 0.0
        own = np.flatnonzero(self.moved)
        covariance = fit.number_covariance[np.ix_(own, own)]
        return self.body.log_probability(fit.deviations[own], covariance)

    def shared(self, shares: Sequence[ShareTerm]) -> list[ShareTerm]:
        """Return those of some shares that are parts of its columns."""
        return [share for share in shares if self.along[share.moved].any()]

    def without(self, shares: Sequence[ShareTerm]) -> Self:
        """Return it without some shares of its columns."""
        X = self.columns - sum(share.columns @ self.along[share.moved] for share in shares)
        along = np.array(self.along)
        along[sorted({k for share in shares for k in share.moved})] = 0.0
        ident = (self.ident, *(share.ident for share in shares))
        return replace(self, columns=X, ident=ident, along=along)

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation."""
        return [replace(self, columns=_along(linear.numbers, self.along))]

    def plain(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return its columns (N', R, k) of each stretch, Nm."""
        return [N @ (along[:, None] * self.along) for N in linear.plain_numbers]


def number_terms(
    parameters: Sequence[Number], N: Array, far: Set[str], bodies: Mapping[str, Body]
) -> list[NumberTerm]:
    """Return the terms of numbers of the arm and its sensors that are far off.

    N: (rows, k) whitened columns for one standard deviation each; bodies: the links, by joint.
    """
    found = []
    together: dict[Key, list[int]] = {}
    unit = np.eye(len(parameters))
    for k, parameter in enumerate(parameters):
        if parameter.cause is None or parameter.cause.effect.id not in far:
            continue
        key = parameter.cause.key
        moves = unit[:, [k]].copy()
        if parameter.what == SCALE and parameter.cause.effect.number == SCALE:
            # A gain of angles that is off leaves that of speeds where it is.
            for i, other in enumerate(parameters):
                if (other.what, other.joint) == (RATIO, parameter.joint):
                    moves[i] = -parameter.prior_std / other.prior_std
        found.append(NumberTerm.of(parameter, N, key, moves))
        if parameter.is_of_link:
            of_joint = enumerate(parameters)
            own = [i for i, p in of_joint if p.is_of_link and p.joint == parameter.joint]
            body = bodies.get(parameter.joint)
            found.append(NumberTerm.of(parameter, N, key, unit[:, own], body))
        if parameter.cause.effect.scope is Scope.EACH_OR_ARM:
            together.setdefault((key[0], None, key[2]), []).append(k)
    for key, own in together.items():
        if len(own) > 1:
            first = parameters[own[0]]
            moves = np.zeros((len(parameters), 1))
            moves[own, 0] = [first.prior_std / parameters[k].prior_std for k in own]
            found.append(NumberTerm.of(first, N, key, moves))
    return found


def _along(N: Array, along: Array) -> Array:
    """Return N @ along of the few numbers that move: all others are a large part of memory."""
    own = np.flatnonzero(along.any(axis=1))
    return N[:, own] @ along[own]
