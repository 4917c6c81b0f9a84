"""The causes of a gap: effects that are more probable than not, with sizes and alternatives.

    confidence(c) = P(c | y) s / (s + u)

P(c | y) is the probability of the cause (:mod:`.beliefs`), s the share of the gap that returns
without it, and u the share that an unknown effect leaves at its joint; without an unknown effect
the second factor is 1. A confirmed effect is a cause if it and its alternatives together are more
probable than not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.beliefs import Beliefs
from elastic_arm.diagnosis.confirmed_set import Confirmed
from elastic_arm.diagnosis.decomposition import Decomposition, without_parts
from elastic_arm.diagnosis.estimates import ParameterEstimate, averaged, estimated
from elastic_arm.diagnosis.far_numbers import Name
from elastic_arm.diagnosis.gap import shrink
from elastic_arm.diagnosis.result import Alternative, Cause, UnconfirmedCause
from elastic_arm.diagnosis.unknown_effects import UnknownEffects
from elastic_arm.diagnosis.words import no_separation
from elastic_arm.effects.library.base_tilt import TILT, tilt
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.priors import LISTED
from elastic_arm.evidence.terms.known import KnownTerm, StatedTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.identification.batch.mounting import CHANCE, STEP

# rad, standard deviation of a mounting if no additional tilt is found
MOUNTED = float(np.radians(STEP))
SHOWN = 0.05  # smallest share of a cause's probability at which its sides are listed

SetWithCause = tuple[
    float, Fit, Term
]  # probability of a set with a cause, the set, and the term of the cause


@dataclass(frozen=True)
class Causes:
    """The causes of a gap."""

    confirmed: Confirmed
    unknown: UnknownEffects

    @property
    def parts(self) -> Decomposition:
        """The residuals, divided by the terms of the most probable set."""
        return self.confirmed.parts

    @property
    def beliefs(self) -> Beliefs:
        """The probabilities over all sets."""
        return self.confirmed.beliefs

    @cached_property
    def found(self) -> list[tuple[Cause, list[Array]]]:
        """The causes, most important first, each with the residuals (N', R) that remain if it
        alone is added."""
        probabilities = self.beliefs.probabilities.items()
        found = [self._cause(name, p) for name, p in probabilities if self._is_cause(name)]
        found.sort(key=lambda one: -one[0].shrink)
        if self.parts.prepared.mounting is None:
            return found
        mounted = self._mounted(found)
        return [mounted, *found]

    def not_confirmed(self) -> tuple[UnconfirmedCause, ...]:
        """Return the probable effects that are not causes.

        Such an effect gains nothing on the validation recordings, its size is zero within two
        standard deviations, it could be ordinary, or it may be part of an unknown effect.
        """
        refused = self.confirmed.refused
        shares = {name: share for name, share in refused if not self._is_cause(name)}
        for name, p in self.beliefs.probabilities.items():
            is_listed = name in shares or name in self.beliefs.given
            if p > 0.5 and not is_listed and not self._is_cause(name):
                shares[name] = self._share_without(name)
        return tuple(
            UnconfirmedCause(*name, self._confidence(name, self.beliefs.probability(name)), share)
            for name, share in shares.items()
        )

    def _is_cause(self, name: Name) -> bool:
        """Whether an effect is a cause: it and its alternatives are more probable than not."""
        if name in self.beliefs.given or not self.confirmed.accepts(name):
            return False
        p = self.beliefs.probability(name)
        if name in self.beliefs.likely_in_best:
            p += sum(p for p, _ in self._sets_without(name))
        return self._confidence(name, p) > 0.5

    def _confidence(self, name: Name, probability: float) -> float:
        """Return the probability that an effect acts and is not part of an unknown effect at its
        joint: an unknown effect is as likely to hide in a cause as elsewhere."""
        left = self.unknown.share_left.get(name[1])
        if left is None:
            return probability
        share = max(self._share_without(name) or 0.0, 0.0)
        return probability * (share / (share + left)) if share else 0.0

    def _share_without(self, name: Name) -> float | None:
        """Return the share of the gap that returns without a cause; None without a gap."""
        confirmation = self.confirmed.of(name)
        return None if confirmation is None else confirmation.share

    # -- alternatives

    def _sets_without(self, name: Name) -> Iterator[tuple[float, set[Name]]]:
        """Yield the probability of each set without a cause, and its effects that the most probable
        set lacks.

        Effects that the validation recordings do not confirm are no alternatives.
        """
        best = self.beliefs.likely_in_best
        for p, fit in self.beliefs.sets:
            own = self.beliefs.likely_in(fit)
            others = {other for other in own - best if self.confirmed.accepts(other)}
            if name not in own and others:
                yield p, others

    def _alternatives(self, name: Name, term: Term) -> Iterator[Alternative]:
        """Yield the effects that replace a cause in sets without it, the most probable first."""
        found: dict[Name, float] = {}
        for p, others in self._sets_without(name):
            for other in others:
                found[other] = found.get(other, 0.0) + p
        effect = term.feature.effect
        words = {c.effect: c.separated_by for c in effect.confusions}
        for other, p in sorted(found.items(), key=lambda one: -one[1]):
            if p >= LISTED:
                separated_by = words.get(other[0], no_separation(effect.id, other[0]))
                yield Alternative(*other, p, separated_by)

    # -- a cause

    def _cause(self, name: Name, probability: float) -> tuple[Cause, list[Array]]:
        """Return a cause, with the residuals (N', R) that remain if it alone is added."""
        problem = self.parts.problem
        beliefs = self.beliefs
        confidence = self._confidence(name, probability)
        best = self.parts.explanation.best
        holding = [(p, fit, t) for p, fit in beliefs.sets for t in beliefs.terms_of(fit, name)]
        # The search may not have scored the best set without the unconfirmed causes.
        holding = holding or [(confidence, best, t) for t in beliefs.terms_of(best, name)]
        likeliest, fit, term = holding[0]
        values = self.parts.explanation.linear.values
        _, instance = estimated(fit.model.of_fitted(fit), term, problem.numbers, values)
        shown = [t for p, _, t in holding if p > SHOWN * likeliest]
        sides = dict.fromkeys(side for t in shown for side in t.feature.sides)
        here = beliefs.term_of_best(name)
        alone = self.parts.before
        if here is not None:
            alone = without_parts(alone, [self.parts.added_alone(here)])
        share = shrink(self.parts.gaps[0], self.parts.gap(alone)).share
        effect = term.feature.effect
        cause = Cause(
            effect=name[0],
            joint=name[1],
            sides=tuple(sides),
            regime=effect.regime,
            parameters=self._sizes(holding),
            shrink=0.0 if share is None else share,
            shrink_without=self._share_without(name),
            confidence=confidence,
            alternatives=tuple(self._alternatives(name, term)),
            instance=replace(instance, joint=name[1]),
            stated=self._stated(name, term),
            is_number=isinstance(term, NumberTerm) and effect.model_parameter,
        )
        return cause, alone

    def _sizes(self, holding: list[SetWithCause]) -> dict[str, ParameterEstimate]:
        """Return the parameters of a cause, averaged over the sets in which its term has the same
        kind as in the first."""
        numbers = self.parts.problem.numbers
        values = self.parts.explanation.linear.values
        likeliest, _, first = holding[0]
        each: list[tuple[float, dict[str, ParameterEstimate]]] = []
        for p, fit, term in holding:
            is_alike = (type(term), term.key, term.count) == (type(first), first.key, first.count)
            if is_alike and p >= LISTED * likeliest:
                sized = fit.model.of_fitted(fit)
                each.append((p, estimated(sized, term, numbers, values)[0]))
        return averaged(each)

    def _stated(self, name: Name, term: Term) -> dict[str, Any] | None:
        """Return the sizes of an effect in the description; None if it states none."""
        if not isinstance(term, KnownTerm | StatedTerm):
            return None
        for _, instance in self.parts.problem.known:
            if (instance.effect.id, instance.joint) == name:
                return dict(instance.numbers)
        return None

    def _mounted(self, found: list[tuple[Cause, list[Array]]]) -> tuple[Cause, list[Array]]:
        """Return the tilt of an arm with another mounting than described, including the tilt that
        was found relative to it."""
        mounting = self.parts.prepared.mounting
        assert mounting is not None
        rest = next((one for one in found if one[0].effect == TILT), None)
        small = {axis: ParameterEstimate(0.0, MOUNTED, "rad") for axis in "xy"}
        if rest is not None:
            found.remove(rest)
            small = dict(rest[0].parameters)
        further = float(small["x"].value), float(small["y"].value)
        x, y = mounting.tilted(*further)
        own = [MOUNTED if small[axis].std is None else float(small[axis].std) for axis in "xy"]
        x_std, y_std = mounting.tilted_by((own[0], own[1]), *further)
        alone = without_parts(self.parts.before, [self.parts.mounting_added])
        share = shrink(self.parts.gaps[0], self.parts.gap(alone)).share
        instance = tilt(x, y)
        cause = Cause(
            effect=TILT,
            joint=None,
            sides=instance.effect.sides,
            regime=instance.effect.regime,
            parameters={
                "x": ParameterEstimate(x, x_std, "rad"),
                "y": ParameterEstimate(y, y_std, "rad"),
            },
            shrink=0.0 if share is None else share,
            confidence=1.0 - CHANCE,
            alternatives=(),
            instance=instance,
            is_number=True,
        )
        return cause, alone
