"""The loss on the validation recordings if a cause is removed and the other terms are refitted.

    nats = ln p(y' | y, S) - ln p(y' | y, S without it)
    share = sum over its places of (e(S without it) - e(S)) / max(e(S without it), e(described))

y are the fitted rows, y' the validation rows, and e is the power over the noise of the sensors, in
units of that noise, that a residual keeps on the validation recordings with the sizes of the fitted
ones. A cause without a gain of likelihood is refused: its law fits one recording only.

Ordinary numbers may take over at the price of their priors and leave as small a gap. A share of
zero is therefore decisive only if the cause alone does not reduce the gap either; such a cause
explains residuals by chance. Numbers beyond their ordinary deviations predict as well as the cause:
the description is wrong in either case, and the prior has weighed both. The cause is then also
compared with these numbers at their bounds, the others refitted, and stays unless it loses to both.
If a friction curve takes over with more than ordinary bends, the scores by all recordings decide,
because they include the price of these bends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, norm

from elastic_arm.arrays import Array, Indices, Mask
from elastic_arm.diagnosis.gap import Gap, shrink
from elastic_arm.equations.numbers import Number
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.priors import LEFT, WORTH
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term

TWO = 2.0  # deviations within which a size is none (contract)


class Share(NamedTuple):
    """A share of a gap, and its deviation."""

    share: float
    std: float

    @property
    def is_something(self) -> bool:
        """Whether it is more than nothing, beyond two deviations."""
        return self.share > TWO * self.std


@dataclass(frozen=True)
class Confirmation:
    """The gain of a cause on the validation recordings."""

    nats: float  # of log-likelihood
    # of the gap at its places, that comes back without it; None where no place has a gap
    returning: Share | None
    alone: Share | None = None  # of the gap beside what every drive has, that goes when it is added
    has_size: bool = True  # whether its size is beyond two deviations of none
    taken_over: bool = (
        False  # whether numbers beyond their ordinary deviations stand for it where it is taken out
    )
    # by how many nats the set is more probable than without it, by all recordings and priors, where
    # a friction curve beyond its ordinary deviations stands for it then; None where none does
    lead: float | None = None

    @property
    def confirms(self) -> bool:
        """Whether it has a size, removes some of the gap, and gains likelihood, or loses none where
        numbers that are far off stand for it.

        Where a friction curve stands for it, it has to be more probable than that.
        """
        if self.lead is not None:
            return self.has_size and self.lead > WORTH
        gains = self.nats > (-WORTH if self.taken_over else 0.0)
        return self.has_size and gains and self._removes

    @property
    def share(self) -> float | None:
        """The share of the gap at its places that comes back without it."""
        return None if self.returning is None else self.returning.share

    @property
    def _removes(self) -> bool:
        """Whether it removes some of the gap where there is one, beside the others or alone.

        Both beyond two deviations; nor is the gap smaller without it.
        """
        if self.returning is None:
            return True
        if self.returning.share < -TWO * self.returning.std and not self.taken_over:
            return False
        return self.returning.is_something or (self.alone is not None and self.alone.is_something)


@dataclass(frozen=True)
class NumberConfirmation:
    """The gain of a number without a term that is beyond its ordinary deviations."""

    nats: float  # of log-likelihood on the validation recordings
    share: float | None  # of the gap that comes back where it is ordinary; None without a gap

    @property
    def confirms(self) -> bool:
        """Whether it gains likelihood, and removes more of the gap than may be left.

        Under a rough trust many numbers move together, and each could be ordinary as well.
        """
        return self.nats > 0.0 and (self.share is None or self.share > LEFT)


def has_size(fit: Fit, term: Term) -> bool:
    """Whether the size of a term of a fit is physically possible, and beyond two deviations of
    none, all its coefficients together."""
    if not term.linear:
        return True  # its size is known
    own = slice(term.linear)
    size = fit.beta(term)[own]
    is_possible = np.all((term.low[own] <= size) & (size <= term.high[own]))
    return bool(is_possible) and _is_beyond(size, fit.covariance(term)[own, own])


def numbers_have_size(fit: Fit, term: NumberTerm, values: Array, numbers: Sequence[Number]) -> bool:
    """Return whether the numbers that a term of a fit moves are physically possible, and beyond two
    deviations of what the description states, all together.

    values: (K,) of the numbers at the linearisation, in deviations of their priors.
    """
    own = np.flatnonzero(term.moved)
    found = values + fit.numbers
    for k in own.tolist():
        cause = numbers[k].cause
        if cause is not None and numbers[k].value(found[k]) <= cause.linear[0].above:
            return False
    covariance = fit.number_covariance[np.ix_(own, own)]
    return _is_beyond(found[own], covariance)


def _is_beyond(size: Array, covariance: Array) -> bool:
    distance = float(size @ np.linalg.pinv(covariance) @ size)
    return bool(distance > chi2.isf(2.0 * norm.sf(TWO), len(size)))


def taking_over(ordinary: Array, without: Array, bounds: Array) -> Indices:
    """Return which numbers (K,) are beyond their ordinary bounds (K,) without a cause, and within
    them beside it."""
    return np.flatnonzero((np.abs(without) > bounds) & (np.abs(ordinary) <= bounds))


def held_out(fit: Fit) -> float:
    """Return ln p(y' | y, S) of a fit to all recordings, up to a constant of the data."""
    return fit.found.evidence - fit.model.of_fitted(fit).found.evidence


def share_without(before: Gap, after: Gap, without: Gap, own: Gap, between: Gap) -> Share | None:
    """Return the share of the gap that comes back where a cause is taken out.

    before, after, without: gaps as described, of the set, and of the set without the cause; own:
    what the cause adds to the residuals; between: the difference of the residuals of both sets. The
    places of the cause are those at which it adds more than the noise, or where it adds most.
    """
    noise = before.of_sensors
    size = own.power.sum(axis=1) / noise
    places: Mask = size >= min(1.0, float(size.max(initial=0.0)))
    where = (before.significant | without.significant) & places[:, None]
    first = before.place(where) / noise
    left = after.place(where) / noise
    again = without.place(where) / noise
    whole = float(np.maximum(first, again).sum())
    if whole == 0.0:
        return None
    error = after.error_of_change(between, where) / noise
    return Share(float((again - left).sum()) / whole, float(np.linalg.norm(error)) / whole)


def share_alone(before: Gap, alone: Gap, own: Gap) -> Share | None:
    """Return the share of a gap that goes where one cause alone is added; None without a gap.

    before, alone: gaps without and with it; own: what it adds to the residuals.
    """
    share = shrink(before, alone).share
    if share is None:
        return None
    where = before.significant
    error = alone.error_of_change(own, where)
    return Share(share, float(np.linalg.norm(error) / before.place(where).sum()))
