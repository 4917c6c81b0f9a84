"""Residuals of the description and of the corrected arm, and the contribution of each term.

    y(nu)  = y - N nu
    before = y(nu_described) - known effects at their stated sizes + m
    after  = before - m - N d - sum over the terms of the set of X_t b_t

y are the residuals (N', R) of a stretch at the linearisation, N their columns by the numbers nu of
arm and sensors, m the contribution of a mounting that differs from the described one, d the
differences of the numbers from the description, and X_t b_t the contribution of a term, Nm. R
counts the residuals: one for each joint and side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.far_numbers import bounds_of
from elastic_arm.diagnosis.gap import Gap, Shrink, shrink
from elastic_arm.diagnosis.preparation import Prepared
from elastic_arm.diagnosis.question import Question
from elastic_arm.estimation.equation_sets import Place
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.problem import JUDGING, Problem
from elastic_arm.evidence.terms.dry_friction import DryFrictionTerm
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.known import KnownTerm
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.evidence.terms.unnamed import UnnamedTerm

Unknown = LawTerm | UnnamedTerm


@dataclass(frozen=True)
class Decomposition:
    """The residuals of one part of the recordings, by the terms of the most probable set."""

    prepared: Prepared
    explanation: Explanation  # the sets with their posteriors
    question: Question
    which: int = JUDGING  # the part of the recordings
    by_all: bool = False  # whether sizes are fitted to all recordings, not only to the fitted ones

    @property
    def problem(self) -> Problem:
        """The problem that was explained."""
        return self.prepared.problem

    @property
    def fit(self) -> Fit:
        """The most probable set, with its sizes."""
        return self.explanation.best if self.by_all else self.explanation.sized

    def with_best(self, fit: Fit) -> Decomposition:
        """Return the decomposition by the terms of another set."""
        return replace(self, explanation=replace(self.explanation, best=fit))

    @cached_property
    def linear(self) -> Linearisation:
        """The last linearisation of this part of the recordings."""
        linear = self.explanation.linear
        problem = self.problem
        if self.which == linear.which:
            return linear
        if self.which == JUDGING and problem is linear.problem:
            return linear.judging
        return linear.part(self.which, problem)

    @property
    def places(self) -> list[Place]:
        """Joint and side of each residual."""
        names = self.problem.robot.joint_names
        return [(joint, side) for side in self.problem.layout.sides for joint in names]

    def by_place(self, values: Array) -> dict[Place, float]:
        """Return the values (R,) of the recorded residuals, by joint and side."""
        rows = zip(self.places, values, self.problem.layout.live, strict=True)
        return {place: float(value) for place, value, is_live in rows if is_live}

    def gap(self, residuals: Sequence[Array]) -> Gap:
        """Measure residuals (N', R) of each stretch."""
        return Gap.of(self.linear.data, residuals)

    # -- numbers of arm and sensors

    @cached_property
    def _numbers(self) -> tuple[Array, Array]:
        """All numbers and their ordinary parts, (K,)."""
        total = self.explanation.linear.values + self.fit.numbers
        ordinary = total - self.fit.far_off
        own = self._numbers_of_judging_recordings()
        if own:
            change = self._fitted_numbers(own, total)
            total[own] += change
            ordinary[own] += change
        return total, ordinary

    @property
    def numbers(self) -> Array:
        """The numbers (K,), in standard deviations of their priors."""
        return self._numbers[0]

    @property
    def ordinary_numbers(self) -> Array:
        """The numbers (K,) without the deviations that the terms of the set describe."""
        return self._numbers[1]

    def _numbers_of_judging_recordings(self) -> list[int]:
        """Return the numbers of single validation recordings, such as zeros of their encoders."""
        fitted = set(self.problem.indices[0])
        return [
            k
            for k, number in enumerate(self.problem.numbers)
            if number.recording is not None and number.recording not in fitted
        ]

    def _fitted_numbers(self, own: list[int], total: Array) -> Array:
        """Return the change (k,) of some numbers that fits this part of the recordings.

            (N'N / p + I) z = N'r / p

        r are the whitened residuals without all other contributions, N the columns of these
        numbers, and p is the mean square of r, at least that of the sensors' noise.
        """
        data = self.linear.data
        plain = self.linear.plain_numbers
        difference = total - self.explanation.linear.values
        moved = [(N @ difference)[:, :, None] for N in plain]
        left = data.white - data.whiten(moved)[:, 0] - self._white_causes()
        N = data.whiten([N[:, :, own] for N in plain])
        power = max(float(np.mean(left**2)), 1.0)
        change = np.linalg.solve(N.T @ N / power + np.eye(len(own)), N.T @ left / power)
        return np.asarray(change, dtype=float)

    def _white_causes(self) -> Array:
        """Return the contribution of the effects of the set to the whitened residuals (rows,)."""
        data = self.linear.data
        each = [self._added(t) for t in self.fit.terms if isinstance(t, EffectTerm)]
        if not each:
            return np.zeros(len(data.white))
        together = [sum(parts) for parts in zip(*each, strict=True)]
        return data.whiten([total[:, :, None] for total in together])[:, 0]

    @cached_property
    def _described(self) -> Array:
        """The difference (K,) of the description from the linearisation, in units of the columns:
        residuals are linear in ratios."""
        numbers = zip(self.problem.numbers, self.explanation.linear.values, strict=True)
        return np.array([(p.neutral - p.value(x)) / p.slope(x) for p, x in numbers])

    @cached_property
    def _shares(self) -> Array:
        """The change (K,) by a standard deviation, in units of the columns, between the description
        and the present numbers."""
        total = self.numbers
        way = total - self.explanation.linear.values - self._described
        return np.where(total == 0.0, 1.0, way / np.where(total == 0.0, 1.0, total))

    @cached_property
    def _excess(self) -> Array:
        """The distance (K,) of numbers without a term from their ordinary deviations."""
        ordinary = self.ordinary_numbers
        bounds = bounds_of(self.problem.numbers, self.fit.model.assumed.zeros)
        return ordinary - np.clip(ordinary, -bounds, bounds)

    @cached_property
    def _numbers_before(self) -> Array:
        """The numbers (K,) of the description in the comparison: ordinary ones after a refit,
        otherwise those of single recordings."""
        ordinary = self.ordinary_numbers - self._excess
        if self.question.refit:
            return ordinary
        numbers = self.problem.numbers
        is_of_one = np.array([p.recording is not None for p in numbers], dtype=bool)
        return np.where(is_of_one, ordinary, 0.0)

    def moved_by(self, numbers: Array) -> list[Array]:
        """Return the contribution of a change of the numbers (K,) to each stretch, Nm."""
        return [N @ (self._shares * numbers) for N in self.linear.plain_numbers]

    @cached_property
    def numbers_added(self) -> list[Array]:
        """The contribution of ordinary deviations of the numbers, relative to :attr:`before`."""
        more = self.ordinary_numbers - self._excess - self._numbers_before
        return self.moved_by(more)

    # -- terms

    @property
    def known_terms(self) -> list[KnownTerm]:
        """The known effects."""
        return [t for t in self.fit.terms if isinstance(t, KnownTerm)]

    def _added(self, term: Term) -> list[Array]:
        """Return the contribution of a term to the residuals (N', R) of each stretch, Nm."""
        along = np.zeros(0) if isinstance(term, EffectTerm) else self._shares
        return term.added(self.linear, self.fit, along)

    def _as_stated(self, term: KnownTerm) -> list[Array]:
        """Return the same for a known effect at its stated size."""
        return term.added_as_stated(self.linear, self.fit, np.zeros(0))

    @cached_property
    def added(self) -> dict[Any, list[Array]]:
        """The contribution of each term of the set to the residuals of each stretch, Nm."""
        return {t.ident: self._added(t) for t in self.fit.terms if not isinstance(t, Unknown)}

    @property
    def causes_added(self) -> list[list[Array]]:
        """The contribution of each optional term of the set, except nonparametric laws."""
        return [self.added[t.ident] for t in self.fit.optional if t.ident in self.added]

    @property
    def friction_added(self) -> list[Array]:
        """The contribution of friction to the residuals (N', R) of each stretch, Nm."""
        return self._sum([self.added[t.ident] for t in self.fit.terms if is_friction(t)])

    @cached_property
    def usual_added(self) -> list[Array]:
        """The contribution of what every drive has, relative to :attr:`before`: of friction beyond
        the stated one, and of armatures that the description does not state."""
        unstated = [
            number.what == "rotor_inertia" and number.neutral == 0.0
            for number in self.problem.numbers
        ]
        armatures = self.moved_by(np.where(unstated, self.numbers - self._numbers_before, 0.0))
        friction = [self._beyond_stated(t) for t in self.fit.terms if is_friction(t)]
        return self._sum([armatures, *friction])

    @cached_property
    def mounting_added(self) -> list[Array]:
        """The contribution of a mounting that differs from the described one."""
        if self.prepared.mounting is None:
            return [np.zeros_like(y) for y in self.linear.data.y]
        neutral = np.zeros(len(self.problem.numbers))
        at = replace(self.linear, values=neutral)
        described = replace(at, problem=replace(self.problem, robot=self.question.robot))
        return without_parts(described.data.y, [at.data.y])

    def _beyond_stated(self, term: Term) -> list[Array]:
        """Return the contribution of a term, relative to :attr:`before`."""
        if isinstance(term, KnownTerm):
            return without_parts(self.added[term.ident], [self._as_stated(term)])
        return self.added[term.ident]

    def _sum(self, added: Sequence[Sequence[Array]]) -> list[Array]:
        """Return the sum of some contributions to the residuals (N', R) of each stretch, Nm."""
        total = [np.zeros_like(y) for y in self.linear.data.y]
        for own in added:
            for y, more in zip(total, own, strict=True):
                y += more
        return total

    def added_alone(self, term: Term) -> list[Array]:
        """Return the contribution of a cause alone to the residuals of each stretch, Nm."""
        if isinstance(term, KnownTerm) and term.stated is not None:
            return self._beyond_stated(term)
        if not isinstance(term, NumberTerm):
            return self.added[term.ident]
        step = np.where(term.moved, self.numbers - self._numbers_before, 0.0)
        return self.moved_by(step)

    # -- residuals and gaps

    @cached_property
    def before(self) -> list[Array]:
        """Residuals (N', R) of each stretch of the description with known effects, refitted if
        `refit` is set."""
        step = self._described + self._shares * self._numbers_before
        stretches = zip(self.linear.data.y, self.linear.plain_numbers, strict=True)
        left = [y - N @ step for y, N in stretches]
        described = without_parts(left, [self._as_stated(t) for t in self.known_terms])
        mounted = zip(described, self.mounting_added, strict=True)
        return [y + more for y, more in mounted]

    @cached_property
    def after(self) -> list[Array]:
        """Residuals (N', R) of each stretch with the causes and ordinary deviations."""
        known = [self._beyond_stated(t) for t in self.known_terms]
        numbers = [self.numbers_added, self.moved_by(self._excess)]
        added = [self.mounting_added, *numbers, *known, *self.causes_added]
        return without_parts(self.before, added)

    @cached_property
    def gaps(self) -> tuple[Gap, Gap]:
        """The gap before and after."""
        return self.gap(self.before), self.gap(self.after)

    @cached_property
    def shrink(self) -> Shrink:
        """The reduction of the gap."""
        return shrink(*self.gaps)

    @cached_property
    def gap_without_terms(self) -> Gap:
        """The gap with the present numbers and without any term."""
        each = zip(self.after, *self.causes_added, strict=True)
        return self.gap([sum(parts) for parts in each])


def is_friction(term: Term) -> bool:
    """Whether a term is a law of friction, or how dry friction differs from its law."""
    is_law = isinstance(term, EffectTerm) and bool(term.feature.effect.friction)
    return is_law or isinstance(term, DryFrictionTerm)


def without_parts(first: Sequence[Array], added: Sequence[Sequence[Array]]) -> list[Array]:
    """Return residuals (N', R) of each stretch without the contributions of some terms."""
    left = [y.copy() for y in first]
    for own in added:
        for y, more in zip(left, own, strict=True):
            y -= more
    return left
