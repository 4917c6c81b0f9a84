"""The probability of each effect and of each far-off number, summed over the sets of terms.

    P(c | y) = sum over sets S of P(S | y) P(c | y, S)

For an effect, P(c | y, S) is 1 if the set contains a term of the effect. For a number, it is the
probability that the number is beyond its ordinary deviations (:mod:`.far_numbers`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from elastic_arm.diagnosis.far_numbers import Name, named_numbers, probabilities, stated_beyond
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.terms.known import KnownTerm, StatedTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term

BY_SIZE = (NumberTerm, StatedTerm)  # terms whose effect is a cause only if its size is far off


@dataclass(frozen=True)
class Beliefs:
    """The probability of each effect and number over the sets of terms."""

    problem: Problem
    explanation: Explanation  # sets and their posteriors

    @property
    def sets(self) -> Sequence[tuple[float, Fit]]:
        """The sets with their probabilities, the most probable first."""
        return self.explanation.sets

    @cached_property
    def given(self) -> set[Name]:
        """The effects that the user declared as known, on either side of a drive."""
        return {(i.effect.id, i.joint) for i in self.problem.given}

    @cached_property
    def named(self) -> dict[Name, list[int]]:
        """The numbers that are reported as each effect and joint."""
        return named_numbers(self.problem.numbers, self.problem.far)

    def probability(self, name: Name) -> float:
        """Return the probability that an effect acts, on either side, or a number is far off."""
        return self.probabilities.get(name, 0.0)

    @cached_property
    def probabilities(self) -> dict[Name, float]:
        """The probability of each effect in the sets, and of each number that may be far off."""
        found: dict[Name, float] = {}
        for p, fit in self.sets:
            for name, there in self._in_set(fit).items():
                found[name] = found.get(name, 0.0) + p * there
        return found

    @cached_property
    def _known_in_sets(self) -> dict[Fit, dict[Name, float]]:
        """The results of :meth:`_in_set`, by set."""
        return {}

    def _in_set(self, fit: Fit) -> dict[Name, float]:
        """Return the probability of each effect and of each number that may be far off in a set;
        computed once per fit."""
        if fit not in self._known_in_sets:
            values = self.explanation.linear.values
            of_numbers = probabilities(fit, values, self.problem.numbers, self.named)
            effects = [t for t in fit.optional if t.says_cause and not isinstance(t, BY_SIZE)]
            of_effects = {name_of(t.key): 1.0 for t in effects}
            self._known_in_sets[fit] = of_numbers | stated_beyond(fit) | of_effects
        return self._known_in_sets[fit]

    def likely_in(self, fit: Fit) -> set[Name]:
        """Return the effects of a set, and the numbers that are probably far off in it."""
        return {name for name, p in self._in_set(fit).items() if p > 0.5}

    @property
    def likely_in_best(self) -> set[Name]:
        """The same for the most probable set."""
        return self.likely_in(self.explanation.best)

    def is_cause(self, term: Term) -> bool:
        """Whether a term of the most probable set is a cause, and not a nonparametric law, a number
        with an ordinary deviation, or a known effect."""
        name = name_of(term.key)
        if not term.says_cause or name in self.given:
            return False
        return not isinstance(term, BY_SIZE) or name in self.likely_in_best

    def terms_of(self, fit: Fit, name: Name) -> list[Term]:
        """Return the terms of an effect in a fit; for a number without a term, a substitute."""
        terms = [t for t in fit.optional if t.says_cause and name_of(t.key) == name]
        if terms or name not in self.likely_in(fit):
            return terms
        for t in fit.terms:
            if isinstance(t, KnownTerm) and t.stated is not None and name_of(t.key) == name:
                return [t]
        numbers = self.problem.numbers
        own = self.named[name]
        first = numbers[own[0]]
        assert first.cause is not None
        moves = np.eye(len(numbers))[:, own]
        return [NumberTerm.of(first, fit.model.N, first.cause.key, moves)]

    def term_of_best(self, name: Name) -> Term | None:
        """Return the term of an effect in the most probable set, if any."""
        return next(iter(self.terms_of(self.explanation.best, name)), None)


def name_of(key: Key) -> Name:
    """Return the effect and joint of a term."""
    return key[0], key[1]
