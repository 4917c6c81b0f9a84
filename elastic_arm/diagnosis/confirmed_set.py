"""The causes that the validation recordings confirm.

    repeat: remove each cause in turn, refit the others, and compare (:mod:`.confirmation`)
            drop the unconfirmed cause that loses most likelihood
    until all remaining causes are confirmed

A dropped cause is removed from all sets that share the probability, and the most probable of the
sets that remain is the next one to be confirmed. A parameter that can replace the cause would
otherwise keep the low probability that it has beside it. The comparison of a cause is reused if the
dropped cause hardly correlates with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.beliefs import Beliefs, name_of
from elastic_arm.diagnosis.confirmation import (
    Confirmation,
    NumberConfirmation,
    Share,
    has_size,
    held_out,
    numbers_have_size,
    share_alone,
    share_without,
    taking_over,
)
from elastic_arm.diagnosis.decomposition import Decomposition, is_friction, without_parts
from elastic_arm.diagnosis.far_numbers import Name, bounds_of, gain_beyond, gain_beyond_together
from elastic_arm.evidence.explanation import weighted
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.priors import ORDINARY, RELATED
from elastic_arm.evidence.search import without
from elastic_arm.evidence.terms.dry_friction import DryFrictionTerm
from elastic_arm.evidence.terms.known import StatedTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term


@dataclass(frozen=True)
class Confirmed:
    """The most probable set, and the terms of it that the validation recordings confirm."""

    parts: Decomposition
    # probable causes that the validation recordings do not confirm, with their shares there
    refused: tuple[tuple[Name, float | None], ...] = ()
    of_terms: Mapping[Key, Confirmation] = field(default_factory=dict)

    @cached_property
    def beliefs(self) -> Beliefs:
        """The probabilities over all sets."""
        return Beliefs(self.parts.problem, self.parts.explanation)

    def of(self, name: Name) -> Confirmation | NumberConfirmation | None:
        """Return the confirmation of a cause, by its term in the best set or by its numbers."""
        term = self.beliefs.term_of_best(name)
        own = None if term is None else self.of_terms.get(term.key)
        return own or self._of_numbers.get(name)

    def accepts(self, name: Name) -> bool:
        """Whether a cause is confirmed.

        Terms were confirmed one by one (:func:`confirmed`); numbers without a term are confirmed
        here.
        """
        if name in {other for other, _ in self.refused} - self.beliefs.likely_in_best:
            return False
        found = self._of_numbers.get(name)
        return found is None or found.confirms

    @cached_property
    def _of_numbers(self) -> dict[Name, NumberConfirmation]:
        """The confirmation of far-off numbers without a term."""
        explanation = self.parts.explanation
        beliefs = self.beliefs
        with_term = {name_of(term.key) for term in explanation.best.optional}
        values = explanation.linear.values
        numbers = self.parts.problem.numbers
        nats = gain_beyond(explanation.best, explanation.sized, values, numbers)
        found = {}
        for name, own in beliefs.named.items():
            if name not in with_term and beliefs.probability(name) > 0.5:
                share = _share_of_numbers(self.parts, beliefs.named[name])
                found[name] = NumberConfirmation(float(nats[own].max()), share)
        return found


def confirmed(parts: Decomposition) -> Confirmed:
    """Return the set without the causes that the validation recordings do not confirm."""
    now = Confirmed(parts)
    while True:
        best = now.parts.explanation.best
        found = dict(now.of_terms)
        for term in best.optional:
            if term.key not in found and now.beliefs.is_cause(term):
                found[term.key] = _confirmation(now.parts, term)
        doubtful = [t for t in best.optional if t.key in found and not found[t.key].confirms]
        if not doubtful:
            return replace(now, of_terms=found)
        worst = min(doubtful, key=lambda t: found[t.key].nats)
        refused = (*now.refused, (name_of(worst.key), found[worst.key].share))
        # Keep the confirmations of all terms that are not correlated with the removed one.
        alike = {t.key for t in best.optional if best.correlation(worst, t) >= RELATED}
        kept = {key: one for key, one in found.items() if key not in alike}
        parts = _taken_out(now.parts, worst)
        # Terms that another set has in its place change the confirmations of all others.
        rest = parts.explanation.best
        is_rest = rest.keys <= best.keys and rest.model.assumed == best.model.assumed
        now = Confirmed(parts, refused, kept if is_rest else {})


def _less(parts: Decomposition, term: Term) -> Decomposition:
    """Return the decomposition without a term of the best set; the other terms are refitted."""
    best = parts.explanation.best
    return parts.with_best(best.model.fit(without(best, term), best))


def _taken_out(parts: Decomposition, term: Term) -> Decomposition:
    """Return the decomposition by the most probable set after a term was removed from all sets that
    share the probability.

    A set that contains another term in its place may be more probable than the rest of the best
    one; that term then has to be confirmed as well. A refitted set keeps the correction of its
    score.
    """
    fits: dict[object, Fit] = {}
    # Sets without the term come first: they have been scored, perhaps at their own linearisation.
    for _, fit in sorted(parts.explanation.sets, key=lambda one: term.key in one[1].keys):
        own = [other for other in fit.optional if other.key == term.key]
        less = fit.model.fit(without(fit, *own), fit) if own else fit
        less = replace(less, correction=fit.correction)
        fits.setdefault((less.keys, less.model.assumed), less)
    sets = weighted(list(fits.values()))
    explanation = replace(parts.explanation, best=sets[0][1], sets=sets)
    return replace(parts, explanation=explanation)


def _confirmation(parts: Decomposition, term: Term) -> Confirmation:
    """Compare the best set with and without a term."""
    less = _less(parts, term)
    best = parts.explanation.best
    other = less.explanation.best
    curves = _friction_curves(best, other, term)
    is_bent = len(taking_over(*curves, np.full(len(curves[0]), ORDINARY))) > 0
    nats = held_out(best) - held_out(other)
    numbers = parts.problem.numbers
    bounds = bounds_of(numbers, best.model.assumed.zeros)
    over = taking_over(parts.ordinary_numbers, less.ordinary_numbers, bounds).tolist()
    if over:
        explanation = less.explanation
        values = explanation.linear.values
        held = gain_beyond_together(other, explanation.sized, values, numbers, over)
        # Numbers that only the fitted recordings put far off predict worse than ordinary ones.
        nats += max(held, 0.0)
        less = _at_bounds(less, over)
    return Confirmation(
        float(nats),
        _share_without(parts, term, less),
        _share_alone(parts, term),
        _has_size(parts, term),
        bool(over),
        best.score - best.correction - other.score if is_bent else None,
    )


def _friction_curves(beside: Fit, without: Fit, cause: Term) -> tuple[Array, Array]:
    """Return the coefficients of the friction curves that correlate with a cause, with and without
    it, (k,) in their ordinary deviations."""
    found: list[list[Array]] = [[], []]
    for term in without.optional:
        is_curve = isinstance(term, DryFrictionTerm) and term in beside.optional
        if is_curve and beside.correlation(cause, term) >= RELATED:
            for own, fit in zip(found, (beside, without), strict=True):
                own.append(fit.beta(term) / term.std)
    first, second = (np.concatenate([np.zeros(0), *own]) for own in found)
    return first, second


def _at_bounds(parts: Decomposition, which: list[int]) -> Decomposition:
    """Return the decomposition with some numbers at their nearest ordinary values and the others
    refitted to the fitted recordings."""
    sized = parts.explanation.sized
    values = parts.explanation.linear.values[which]
    bounds = bounds_of(parts.problem.numbers, sized.model.assumed.zeros)[which]
    at = np.clip(values + sized.numbers[which], -bounds, bounds) - values
    return replace(parts.with_best(sized.held(which, at)), by_all=True)


def _has_size(parts: Decomposition, term: Term) -> bool:
    """Whether the size of a term in the fitted recordings is possible and more than two standard
    deviations from zero.

    A stated effect that is a cause is always beyond its ordinary deviations.
    """
    sized = parts.explanation.sized
    if isinstance(term, NumberTerm):
        values = parts.explanation.linear.values
        return numbers_have_size(sized, term, values, parts.problem.numbers)
    return isinstance(term, StatedTerm) or has_size(sized, term)


def _share_without(parts: Decomposition, term: Term, less: Decomposition) -> Share | None:
    """Return the share of the gap at the places of a term that returns without it."""
    own = parts.gap(parts.added[term.ident])
    between = parts.gap(without_parts(less.after, [parts.after]))
    before, after = parts.gaps
    return share_without(before, after, less.gaps[1], own, between)


def _share_alone(parts: Decomposition, term: Term) -> Share | None:
    """Return the share of the gap that one cause removes beside what every drive has.

    Where the description states neither friction nor armatures, these are most of the gap and would
    hide what a cause removes.
    """
    own = parts.added_alone(term)
    beside = without_parts(parts.before, [parts.usual_added])
    if is_friction(term):
        beside = [left + more for left, more in zip(beside, own, strict=True)]
    left = without_parts(beside, [own])
    return share_alone(parts.gap(beside), parts.gap(left), parts.gap(own))


def _share_of_numbers(parts: Decomposition, which: list[int]) -> float | None:
    """Return the share of a gap that returns if some numbers are ordinary.

    Each is set to its nearest ordinary value, and the others are refitted. The gap is that of the
    present numbers without any term, or the remaining one if it is larger.
    """
    sized = parts.explanation.sized
    held = _at_bounds(parts, which)
    beyond = np.zeros(len(parts.problem.numbers))
    beyond[which] = sized.numbers[which] - held.fit.numbers[which]
    own = parts.gap(parts.moved_by(beyond))
    between = parts.gap(without_parts(held.after, [parts.after]))
    found = share_without(parts.gap_without_terms, parts.gaps[1], held.gaps[1], own, between)
    return None if found is None else found.share
