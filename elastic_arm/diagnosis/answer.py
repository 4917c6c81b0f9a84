"""The diagnosis from recordings to result: where, which, how far."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.changes import changes_between
from elastic_arm.diagnosis.confirmation import (
    Confirmation,
    NumberConfirmation,
    Share,
    has_size,
    held_out,
    numbers_have_size,
    share_alone,
    share_without,
    takes_over,
)
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.estimates import ParameterEstimate, averaged, estimated
from elastic_arm.diagnosis.events import Event, blocks_of, events_of
from elastic_arm.diagnosis.far_numbers import (
    Name,
    beyond,
    bounds_of,
    gain_beyond,
    named_numbers,
    probabilities,
    stated_beyond,
)
from elastic_arm.diagnosis.gap import Gap, Shrink, shrink
from elastic_arm.diagnosis.preparation import Prepared, prepare
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.regimes import regime, shares
from elastic_arm.diagnosis.result import (
    Alternative,
    Cause,
    Diagnosis,
    Imperfection,
    ResidualSizes,
    UnconfirmedCause,
    UnexplainedResidual,
    plain_parameters,
)
from elastic_arm.diagnosis.words import (
    REPEATED_MOTION,
    UNFINISHED,
    event_notes,
    law_note,
    no_separation,
    ringing_notes,
    shape_note,
    unnamed_note,
)
from elastic_arm.effects import EFFECTS, EffectInstance
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.errors import DiagnosisError, require_kind
from elastic_arm.evidence.grams import OCTAVES, Bands
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import Fit
from elastic_arm.evidence.priors import LEFT, LISTED, MOTION, NOISY, RELATED
from elastic_arm.evidence.problem import FITTED, JUDGING
from elastic_arm.evidence.relinearise import Explanation, explain
from elastic_arm.evidence.search import without
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.known import KnownTerm, StatedTerm
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.number import NumberTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.evidence.terms.unnamed import UnnamedTerm
from elastic_arm.evidence.watch import Watch
from elastic_arm.identification.batch.identify import resonances
from elastic_arm.identification.batch.mounting import CHANCE, STEP
from elastic_arm.identification.verdict import SURE
from elastic_arm.recording import Recording
from elastic_arm.recording.made_torque import at_common_gain
from elastic_arm.recording.recording import recordings_of

Unknown = LawTerm | UnnamedTerm
AGAIN = 3  # times that recordings are explained anew without the events that are found
# rad, to which a mounting is known where no tilt is found beside it
MOUNTED = float(np.radians(STEP))


# More threads wait for each other, and take thirty times as long.
@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    recordings: Sequence[Recording],
    question: Question,
    validate: Sequence[Recording] = (),
    *,
    watch: Watch | None = None,
) -> Diagnosis:
    """Find where recordings and model differ, which effects cause it, and by how much the gap
    shrinks with them.

    Parameters
    ----------
    recordings
        Recordings on which causes are fitted.
    question
        Arm, model, known effects, catalogue and priors.
    validate
        Recordings for validation; by default the last third of each recording.
    watch
        Receives the stages and can end the search, which then returns the best answer so far.

    Raises
    ------
    DiagnosisError
        If the recordings allow no diagnosis: no torque, no motion, too short, validation equal to
        identification data.
    RecordingError
        If a recording lacks a joint, has another type, or contains implausible numbers.
    """
    recordings, validate = recordings_of(recordings), recordings_of(validate, "validate")
    require_kind(question, Question, "question", DiagnosisError, "Give Question(robot).")
    robot = at_common_gain(question.robot, [*recordings, *validate])
    question = replace(question, robot=robot)
    watch = watch or Watch()
    prepared = prepare(recordings, validate, question)
    watch.say(f"diagnosed: {len(prepared.problem.sources)} recordings")
    answer = Answer.of(prepared, question, watch)
    for _ in range(AGAIN):
        events = answer.events()
        if events == answer.prepared.events or watch.is_over():
            break
        watch.say(f"{len(events)} events excluded")
        answer = Answer.of(answer.prepared.without(events), question, watch)
    watch.say("confirmation on the judging recordings")
    return answer.confirmed().result()


@dataclass(frozen=True)
class Answer:
    """What is said of recordings by the posterior of the sets of terms that were met."""

    prepared: Prepared  # what was to be explained
    explanation: Explanation  # sets and their posteriors
    question: Question  # what was asked
    which: int = JUDGING  # the part of the recordings that is looked at
    by_all: bool = False  # whether sizes are those by all recordings, not by the fitted ones alone
    # what was likely by the fit and gains nothing on the recordings that judge, with its share
    # there
    refused: tuple[tuple[Name, float | None], ...] = ()
    # of the terms of the best set
    confirmations: Mapping[Key, Confirmation] = field(default_factory=dict)

    @staticmethod
    def of(prepared: Prepared, question: Question, watch: Watch | None = None) -> Answer:
        """Explain what was prepared."""
        return Answer(
            prepared, explain(prepared.problem, refit=question.refit, watch=watch), question
        )

    @property
    def best(self) -> Fit:
        """The most probable set."""
        return self.explanation.best if self.by_all else self.explanation.sized

    @property
    def sets(self) -> Sequence[tuple[float, Fit]]:
        """The sets that share the probability, the most probable first."""
        return self.explanation.sets

    def probability(self, name: Name) -> float:
        """Return the probability that an effect is there, on whatever side, or a number is off."""
        return self._probabilities.get(name, 0.0)

    @cached_property
    def _probabilities(self) -> dict[Name, float]:
        """The probability of each effect that some set holds, and of each number that may be
        off."""
        found: dict[Name, float] = {}
        for p, fit in self.sets:
            for name, there in self._in_set(fit).items():
                found[name] = found.get(name, 0.0) + p * there
        return found

    @cached_property
    def _named(self) -> dict[Name, list[int]]:
        """Which numbers are reported as each effect and joint."""
        return named_numbers(self.prepared.problem.numbers, self.prepared.problem.far)

    @cached_property
    def _known_in_sets(self) -> dict[Fit, dict[Name, float]]:
        """What :meth:`_in_set` found, by set."""
        return {}

    def _in_set(self, fit: Fit) -> dict[Name, float]:
        """Return the probability of each effect and of each number that may be off, in a set; made
        once for each fit."""
        if fit not in self._known_in_sets:
            values, numbers = self.explanation.linear.values, self.prepared.problem.numbers
            beyond = (NumberTerm, StatedTerm)  # which are there where they are far off
            effects = [t for t in fit.optional if t.says_cause and not isinstance(t, beyond)]
            of_numbers = probabilities(fit, values, numbers, self._named)
            there = of_numbers | stated_beyond(fit) | {_name(t.key): 1.0 for t in effects}
            self._known_in_sets[fit] = there
        return self._known_in_sets[fit]

    # -- the recordings that judge

    @cached_property
    def judging(self) -> Linearisation:
        """The last linearisation, of the recordings that judge."""
        linear, problem = self.explanation.linear, self.prepared.problem
        if self.which == JUDGING and problem is linear.problem:
            return linear.judging
        return linear.part(self.which, problem)

    def events(self) -> tuple[Event, ...]:
        """Return the stretches of recordings that the rest of each contradicts, in what effects and
        numbers leave."""
        # What the recordings that judge tell of sizes is no event.
        whole = replace(self, by_all=True, prepared=self.prepared.without(()))
        looks = replace(whole, which=FITTED), whole
        problem, found = whole.prepared.problem, []
        for number, source in problem.sources.items():
            parts = [
                blocks
                for look, own in zip(looks, problem.indices, strict=True)
                if number in own
                for blocks in blocks_of(
                    look.judging.data,
                    look.after,
                    own.index(number),
                    whole.prepared.begins[look.which][source],
                )
            ]
            found += events_of(parts, source, self.places, problem.layout.live)
        return tuple(found)

    @cached_property
    def _numbers(self) -> tuple[Array, Array]:
        """All numbers and the ordinary part of them, (K,), zeros of the judging recordings fitted
        on these."""
        linear, fit = self.explanation.linear, self.best
        total = linear.values + fit.numbers
        ordinary = total - fit.far_off
        fitted = set(self.prepared.problem.indices[0])
        numbers = self.prepared.problem.numbers
        own = [
            k
            for k, p in enumerate(numbers)
            if p.recording is not None and p.recording not in fitted
        ]
        if own:
            data, plain = self.judging.data, self.judging.plain_numbers
            moved = [(N @ (total - linear.values))[:, :, None] for N in plain]
            left = data.white - data.whiten(moved)[:, 0] - self._white_causes(fit.terms)
            N = data.whiten([N[:, :, own] for N in plain])
            power = max(float(np.mean(left**2)), 1.0)
            z = np.linalg.solve(N.T @ N / power + np.eye(len(own)), N.T @ left / power)
            total[own] += z
            ordinary[own] += z
        return total, ordinary

    def _white_causes(self, terms: Sequence[Term]) -> Array:
        data = self.judging.data
        each = [self._added(t) for t in terms if isinstance(t, EffectTerm)]
        if not each:
            return np.zeros(len(data.white))
        return data.whiten([sum(parts)[:, :, None] for parts in zip(*each, strict=True)])[:, 0]

    def _added(self, term: Term) -> list[Array]:
        """Return what a term adds to the residuals (N', R) of each stretch that judges, Nm."""
        along = np.zeros(0) if isinstance(term, EffectTerm) else self._shares
        return term.added(self.judging, self.best, along)

    def _as_stated(self, term: KnownTerm) -> list[Array]:
        """Return the same of a known effect at its stated size."""
        return term.added_as_stated(self.judging, self.best, np.zeros(0))

    @cached_property
    def _described(self) -> Array:
        """How far the description is from where the residuals are made (K,), in columns: they are
        linear in ratios."""
        numbers = zip(self.prepared.problem.numbers, self.explanation.linear.values, strict=True)
        return np.array([(p.neutral - p.value(x)) / p.slope(x) for p, x in numbers])

    @cached_property
    def _shares(self) -> Array:
        """What a standard deviation changes (K,), in columns, between the description and where the
        numbers are."""
        total = self._numbers[0]
        way = total - self.explanation.linear.values - self._described
        return np.where(total == 0.0, 1.0, way / np.where(total == 0.0, 1.0, total))

    @cached_property
    def added(self) -> dict[Any, list[Array]]:
        """What each term of the best set adds to the residuals of each stretch, Nm."""
        return {t.ident: self._added(t) for t in self.best.terms if not isinstance(t, Unknown)}

    @property
    def _causes_added(self) -> list[list[Array]]:
        """What each optional term of the best set adds, but laws without a form."""
        return [self.added[t.ident] for t in self.best.optional if t.ident in self.added]

    @cached_property
    def before(self) -> list[Array]:
        """Residuals (N', R) of each stretch of the description, known effects in it; refitted where
        that was asked."""
        step = self._described + self._shares * self._numbers_before
        left = [
            y - N @ step
            for y, N in zip(self.judging.data.y, self.judging.plain_numbers, strict=True)
        ]
        described = _minus(left, [self._as_stated(t) for t in self._always])
        return [y + more for y, more in zip(described, self._mounting_added, strict=True)]

    @cached_property
    def _mounting_added(self) -> list[Array]:
        """What another mounting than the described one adds to the residuals of the description."""
        if self.prepared.mounting is None:
            return [np.zeros_like(y) for y in self.judging.data.y]
        problem = self.prepared.problem
        neutral = np.zeros(len(problem.numbers))
        at = replace(self.judging, values=neutral)
        described = replace(at, problem=replace(problem, robot=self.question.robot))
        return _minus(described.data.y, [at.data.y])

    @cached_property
    def _excess(self) -> Array:
        """How far numbers that no term makes wide are beyond their ordinary deviations (K,)."""
        ordinary = self._numbers[1]
        bounds = bounds_of(self.prepared.problem.numbers, self.best.model.assumed.zeros)
        return ordinary - np.clip(ordinary, -bounds, bounds)

    @cached_property
    def _numbers_before(self) -> Array:
        """The numbers (K,) beside which the description is compared: ordinary ones after a refit,
        else those of single recordings."""
        ordinary = self._numbers[1] - self._excess
        return ordinary if self.question.refit else np.where(self._of_one, ordinary, 0.0)

    @property
    def _always(self) -> list[KnownTerm]:
        """The known effects."""
        return [t for t in self.best.terms if isinstance(t, KnownTerm)]

    @property
    def _of_one(self) -> NDArray[np.bool_]:
        """Which numbers are of one recording."""
        return np.array(
            [p.recording is not None for p in self.prepared.problem.numbers], dtype=bool
        )

    @cached_property
    def numbers_added(self) -> list[Array]:
        """What the ordinary deviations of the numbers change beside :attr:`before`."""
        more = self._numbers[1] - self._excess - self._numbers_before
        return self._moved_by(more)

    def _moved_by(self, numbers: Array) -> list[Array]:
        """Return what a change of the numbers (K,) adds to the residuals of each stretch, Nm."""
        return [N @ (self._shares * numbers) for N in self.judging.plain_numbers]

    @cached_property
    def after(self) -> list[Array]:
        """Residuals of each stretch with the causes and what is ordinary."""
        known = [_minus(self.added[t.ident], [self._as_stated(t)]) for t in self._always]
        numbers = [self.numbers_added, self._moved_by(self._excess)]
        return _minus(self.before, [self._mounting_added, *numbers, *known, *self._causes_added])

    @cached_property
    def gaps(self) -> tuple[Gap, Gap]:
        """Before and after."""
        data = self.judging.data
        return Gap.of(data, self.before), Gap.of(data, self.after)

    @cached_property
    def shrink(self) -> Shrink:
        """By how much the gap shrinks."""
        return shrink(*self.gaps)

    # -- what the recordings that judge confirm

    def _with(self, fit: Fit) -> Answer:
        """Return what is said where a fit is that of the best set."""
        return replace(self, explanation=replace(self.explanation, best=fit))

    def _less(self, term: Term) -> Answer:
        """Return what is said without a term of the best set, the rest refitted."""
        best = self.explanation.best
        return self._with(best.model.fit(without(best, term), best))

    def confirmed(self) -> Answer:
        """Return the answer without the causes that gain nothing on the recordings that judge, the
        worst first."""
        answer = self
        while True:
            best = answer.explanation.best
            own = held_out(best)
            found = dict(answer.confirmations)
            for term in best.optional:
                if term.key not in found and answer._is_cause(term):
                    less = answer._less(term)
                    nats = own - held_out(less.explanation.best)
                    returning = answer._share_without(term, less)
                    sized = answer._has_size(term)
                    over = takes_over(answer._numbers[1], less._numbers[1])
                    alone = answer._share_alone(term)
                    found[term.key] = Confirmation(nats, returning, alone, sized, over)
            doubtful = [t for t in best.optional if t.key in found and not found[t.key].confirms]
            if not doubtful:
                return replace(answer, confirmations=found)
            worst = min(doubtful, key=lambda t: found[t.key].nats)
            refused = (*answer.refused, (_name(worst.key), found[worst.key].share))
            # Keep the confirmations of all terms that are not correlated with the removed one.
            alike = {t.key for t in best.optional if best.correlation(worst, t) >= RELATED}
            kept = {key: one for key, one in found.items() if key not in alike}
            answer = replace(answer._less(worst), refused=refused, confirmations=kept)

    @cached_property
    def _given(self) -> set[Name]:
        """What the user knows to be there, on whatever side of a drive."""
        return {(i.effect.id, i.joint) for i in self.prepared.problem.given}

    def _is_cause(self, term: Term) -> bool:
        """Whether a term of the best set is a cause: no law without a form, no ordinary number, not
        what is known."""
        if not term.says_cause or _name(term.key) in self._given:
            return False
        if isinstance(term, NumberTerm | StatedTerm):
            return _name(term.key) in self._there(self.explanation.best)
        return True

    def _has_size(self, term: Term) -> bool:
        """Whether the size of a term, by the fitted recordings, is possible and beyond two
        deviations of none.

        A stated effect is beyond its ordinary deviations where it is a cause.
        """
        sized = self.explanation.sized
        if isinstance(term, NumberTerm):
            values = self.explanation.linear.values
            return numbers_have_size(sized, term, values, self.prepared.problem.numbers)
        return isinstance(term, StatedTerm) or has_size(sized, term)

    def _share_without(self, term: Term, less: Answer) -> Share | None:
        """Return the share of the gap at the places of a term that comes back without it."""
        data = self.judging.data
        own = Gap.of(data, self.added[term.ident])
        between = Gap.of(data, _minus(less.after, [self.after]))
        return share_without(self.gaps[0], self.gaps[1], less.gaps[1], own, between)

    def _share_alone(self, term: Term) -> Share | None:
        """Return the share of the whole gap that goes when one cause alone is added."""
        data = self.judging.data
        own = self._added_alone(term)
        left = _minus(self.before, [own])
        return share_alone(self.gaps[0], Gap.of(data, left), Gap.of(data, own))

    # -- what is said

    def not_confirmed(self) -> tuple[UnconfirmedCause, ...]:
        """Return what is likely by the fit and no cause.

        It gains nothing on the recordings that judge, its size is nothing within two deviations, it
        could be ordinary, or it may be a part of an unknown effect.
        """
        shares = {name: share for name, share in self.refused if not self._is_said(name)}
        for name, p in self._probabilities.items():
            if p > 0.5 and name not in {*shares, *self._given} and not self._is_said(name):
                confirmation = self._confirmation(name, self._here(name))
                shares[name] = None if confirmation is None else confirmation.share
        return tuple(
            UnconfirmedCause(*name, self.probability(name) * self._known_share(name), share)
            for name, share in shares.items()
        )

    def _here(self, name: Name) -> Term | None:
        """Return a term of the best set that is an effect, if there is one."""
        return next(iter(self._terms_of(self.explanation.best, name)), None)

    @property
    def places(self) -> list[tuple[str, str]]:
        """Joint and side of each residual."""
        layout = self.prepared.problem.layout
        return [
            (joint, side)
            for side in layout.sides
            for joint in self.prepared.problem.robot.joint_names
        ]

    def causes(self) -> list[tuple[Cause, list[Array]]]:
        """Return the effects that are likelier there than not, most important first, each with what
        it leaves alone."""
        probabilities = self._probabilities.items()
        found = [
            self._cause(name, p * self._known_share(name))
            for name, p in probabilities
            if self._is_said(name)
        ]
        found.sort(key=lambda one: -one[0].shrink)
        if self.prepared.mounting is None:
            return found
        mounted = self._mounted(found)
        return [mounted, *found]

    def _is_said(self, name: Name) -> bool:
        """Whether something is a cause: it and its alternatives are likelier there than not."""
        best = self._there(self.explanation.best)
        refused = {other for other, _ in self.refused} - best
        if name in refused or name in self._given or not self._is_confirmed(name):
            return False
        p = self.probability(name)
        if name in best:
            p += sum(p for p, _ in self._sets_without(name))
        return p * self._known_share(name) > 0.5

    def _known_share(self, name: Name) -> float:
        """Return the probability that a cause is no part of an unknown effect at its joint.

            s / (s + u)

        with s the share of the gap that comes back without the cause, and u that which the unknown
        effect leaves at the joint: what is left is as likely to hide in a cause as elsewhere.
        """
        left = self._left_unknown.get(name[1])
        if left is None:
            return 1.0
        confirmation = self._confirmation(name, self._here(name))
        share = None if confirmation is None else confirmation.share
        share = max(share or 0.0, 0.0)
        return share / (share + left) if share else 0.0

    @cached_property
    def _left_unknown(self) -> dict[str | None, float]:
        """The share of its gap that each joint with an unknown effect keeps."""
        before, after = self.gaps
        noise = before.of_sensors
        where = before.significant | after.significant
        first, left = (gap.place(where) / noise for gap in (before, after))
        joints = {self.places[row][0] for row in self._unknown_rows}
        found: dict[str | None, float] = {}
        for joint in joints:
            own = [row for row, place in enumerate(self.places) if place[0] == joint]
            whole = float(np.maximum(first[own], left[own]).sum())
            found[joint] = float(left[own].sum()) / whole if whole else 0.0
        return found

    @cached_property
    def _unknown_rows(self) -> list[int]:
        """The residuals that an unknown effect leaves open: laws without a form, then power."""
        names = self.prepared.problem.robot.joint_names
        sides = self.prepared.problem.layout.sides
        of_laws = []
        for _, term in self.laws:
            joint, side = term.place
            place = names[joint], side if side in sides else sides[0]
            of_laws.append(self.places.index(place))
        return [*dict.fromkeys([*of_laws, *self.open_rows])]

    def _is_confirmed(self, name: Name) -> bool:
        """Whether a number that no term makes wide is confirmed by the recordings that judge.

        Terms were confirmed one by one (:meth:`confirmed`).
        """
        found = self._confirmed_numbers.get(name)
        return found is None or found.confirms

    @cached_property
    def _confirmed_numbers(self) -> dict[Name, NumberConfirmation]:
        """What the recordings that judge gain by the numbers that are beyond and have no term."""
        best = self.explanation.best
        with_term = {_name(term.key) for term in best.optional}
        values, numbers = self.explanation.linear.values, self.prepared.problem.numbers
        nats = gain_beyond(best, self.explanation.sized, values, numbers)
        found = {}
        for name, own in self._named.items():
            if name not in with_term and self.probability(name) > 0.5:
                share = self._share_of_numbers(name)
                found[name] = NumberConfirmation(float(nats[own].max()), share)
        return found

    def _share_of_numbers(self, name: Name) -> float | None:
        """Return the share of a gap that comes back where the numbers of a name are ordinary.

        Each is at its nearest ordinary value, and the rest is refitted. The gap is that of the
        numbers as they are, without any term, or what is left then, where that is larger.
        """
        problem, sized = self.prepared.problem, self.explanation.sized
        which = self._named[name]
        values = self.explanation.linear.values[which]
        bounds = bounds_of(problem.numbers, sized.model.assumed.zeros)[which]
        at = np.clip(values + sized.numbers[which], -bounds, bounds) - values
        held = replace(self._with(sized.held(which, at)), by_all=True)
        beyond = np.zeros(len(problem.numbers))
        beyond[which] = sized.numbers[which] - at
        own = Gap.of(self.judging.data, self._moved_by(beyond))
        between = Gap.of(self.judging.data, _minus(held.after, [self.after]))
        found = share_without(self._gap_without_terms, self.gaps[1], held.gaps[1], own, between)
        return None if found is None else found.share

    @cached_property
    def _gap_without_terms(self) -> Gap:
        """The gap of the numbers as they are, without any term."""
        each = zip(self.after, *self._causes_added, strict=True)
        return Gap.of(self.judging.data, [sum(parts) for parts in each])

    def _there(self, fit: Fit) -> set[Name]:
        """Return the effects of a set, and the numbers that are more likely than not off in it."""
        return {name for name, p in self._in_set(fit).items() if p > 0.5}

    def _mounted(self, found: list[tuple[Cause, list[Array]]]) -> tuple[Cause, list[Array]]:
        """Return the tilt of an arm that is mounted otherwise than described, with what was found
        beside it."""
        mounting, effect = self.prepared.mounting, EFFECTS[TILT]
        assert mounting is not None
        rest = next((one for one in found if one[0].effect == TILT), None)
        small = {
            "x": ParameterEstimate(0.0, MOUNTED, "rad"),
            "y": ParameterEstimate(0.0, MOUNTED, "rad"),
        }
        if rest is not None:
            found.remove(rest)
            small = dict(rest[0].parameters)
        x, y = mounting.tilted(small["x"].value, small["y"].value)
        values = {
            "x": ParameterEstimate(x, small["x"].std, "rad"),
            "y": ParameterEstimate(y, small["y"].std, "rad"),
        }
        instance = EffectInstance(effect, None, {"x": x, "y": y})
        alone = _minus(self.before, [self._mounting_added])
        share = shrink(self.gaps[0], Gap.of(self.judging.data, alone)).share
        cause = Cause(
            effect=TILT,
            joint=None,
            sides=effect.sides,
            regime=effect.regime,
            parameters=values,
            shrink=0.0 if share is None else share,
            confidence=1.0 - CHANCE,
            alternatives=(),
            instance=instance,
            is_number=True,
        )
        return cause, alone

    def _cause(self, name: Name, probability: float) -> tuple[Cause, list[Array]]:
        problem = self.prepared.problem
        best = self.explanation.best
        holding = [(p, fit, t) for p, fit in self.sets for t in self._terms_of(fit, name)]
        # The best set without what was not confirmed may be none of those met.
        holding = holding or [(probability, best, t) for t in self._terms_of(best, name)]
        _, fit, term = holding[0]
        values = self.explanation.linear.values
        each: list[tuple[float, dict[str, ParameterEstimate]]] = []
        _, instance = estimated(fit.model.of_fitted(fit), term, problem.numbers, values)
        for p, one, t in holding:
            if (
                p < LISTED * probability
                or t.key != term.key
                or (type(t), t.count) != (type(term), term.count)
            ):
                continue
            sized = one.model.of_fitted(one)
            each.append((p, estimated(sized, t, problem.numbers, values)[0]))
        sides = dict.fromkeys(
            side for p, _, t in holding if p > 0.05 * probability for side in t.feature.sides
        )
        stated = next(
            (
                i
                for _, i in problem.known
                if isinstance(term, KnownTerm | StatedTerm) and (i.effect.id, i.joint) == name
            ),
            None,
        )
        here = self._here(name)
        alone = self.before if here is None else _minus(self.before, [self._added_alone(here)])
        share = shrink(self.gaps[0], Gap.of(self.judging.data, alone)).share
        confirmation = self._confirmation(name, here)
        cause = Cause(
            effect=name[0],
            joint=name[1],
            sides=tuple(sides),
            regime=term.feature.effect.regime,
            parameters=averaged(each),
            shrink=0.0 if share is None else share,
            shrink_without=None if confirmation is None else confirmation.share,
            confidence=probability,
            alternatives=tuple(self._alternatives(name, term)),
            instance=replace(instance, joint=name[1]),
            stated=None if stated is None else dict(stated.numbers),
            is_number=isinstance(term, NumberTerm) and term.feature.effect.model_parameter,
        )
        return cause, alone

    def _confirmation(
        self, name: Name, here: Term | None
    ) -> Confirmation | NumberConfirmation | None:
        """Return what confirms a cause: its term in the best set, or its numbers."""
        own = None if here is None else self.confirmations.get(here.key)
        return own or self._confirmed_numbers.get(name)

    def _terms_of(self, fit: Fit, name: Name) -> list[Term]:
        """Return the terms of a fit that are an effect; of a number that no term makes wide, one
        that stands for it."""
        terms = [t for t in fit.optional if t.says_cause and _name(t.key) == name]
        if terms or name not in self._there(fit):
            return terms
        for t in fit.terms:
            if isinstance(t, KnownTerm) and t.stated is not None and _name(t.key) == name:
                return [t]
        numbers = self.prepared.problem.numbers
        own = self._named[name]
        first = numbers[own[0]]
        assert first.cause is not None
        moves = np.eye(len(numbers))[:, own]
        return [NumberTerm.of(first, fit.model.N, first.cause.key, moves)]

    def _added_alone(self, term: Term) -> list[Array]:
        """Return what a cause alone adds to the residuals of each stretch, Nm."""
        if isinstance(term, KnownTerm) and term.stated is not None:
            return _minus(self.added[term.ident], [self._as_stated(term)])
        if not isinstance(term, NumberTerm):
            return self.added[term.ident]
        step = np.where(term.moved, self._numbers[0] - self._numbers_before, 0.0)
        return self._moved_by(step)

    def _instead(self, name: Name) -> dict[Name, float]:
        """Return the probabilities of what is there in the sets without a cause and not in the most
        probable one."""
        found: dict[Name, float] = {}
        for p, others in self._sets_without(name):
            for other in others:
                found[other] = found.get(other, 0.0) + p
        return found

    def _sets_without(self, name: Name) -> Iterator[tuple[float, set[Name]]]:
        """Yield the probability of each set without a cause that holds what the most probable one
        does not, and what that is."""
        best = self._there(self.explanation.best)
        refused = {other for other, _ in self.refused}
        for p, fit in self.sets:
            own = self._there(fit)
            others = own - best - refused
            if name not in own and others:
                yield p, others

    def _alternatives(self, name: Name, term: Term) -> Iterator[Alternative]:
        """Yield what is there in the sets without a cause and not in the most probable one, most
        probable first."""
        found = self._instead(name)
        words = {c.effect: c.separated_by for c in term.feature.effect.confusions}
        for other, p in sorted(found.items(), key=lambda one: -one[1]):
            if p >= LISTED:
                yield Alternative(
                    *other, p, words.get(other[0], no_separation(term.feature.effect.id, other[0]))
                )

    @cached_property
    def laws(self) -> list[tuple[float, Unknown]]:
        """Return what no cause of the catalogue names and is likelier there than not."""
        found: dict[Key, tuple[float, Unknown]] = {}
        for p, fit in self.sets:
            for t in fit.optional:
                if isinstance(t, Unknown):
                    before, first = found.get(t.key, (0.0, t))
                    found[t.key] = before + p, first
        # One place has one law; which of several it follows may be open.
        at_place: dict[tuple[int, str], list[tuple[float, Unknown]]] = {}
        for p, t in found.values():
            at_place.setdefault(t.place, []).append((p, t))
        return [
            max(each, key=lambda one: one[0])
            for each in at_place.values()
            if sum(p for p, _ in each) > 0.5
        ]

    @cached_property
    def open_rows(self) -> list[int]:
        """Return the residuals that keep more power than their sensors may have as noise, and much
        of their own gap.

        Either in the recordings that were fitted, where what is left follows a motion; or in those
        that judge, where causes act and more is left than the noise that the fit has found.
        """
        model, data = self.best.model, self.judging.data
        fitted, judging = model.bands, Bands(data)
        acting = _minus([np.zeros_like(y) for y in self.before], self._causes_added)
        white = [
            data.whiten([r[:, :, None] for r in one])[:, 0]
            for one in (self.before, self.after, acting)
        ]
        of_fitted = [fitted.n * fit.found.v for fit in (model.fit(()), self.best)]
        of_judging = [judging.powers(w) for w in white]
        found = []
        for row in range(judging.places):
            own, other = _slow(fitted, row), _slow(judging, row)
            n, m = float(fitted.n[own].sum()), float(judging.n[other].sum())
            if not n or not m:
                continue
            # Mean powers, in those of the sensors' noise: without any term, with those of the best
            # set, of the causes.
            first, left = (float(power[own].sum()) / n - 1.0 for power in of_fitted)
            before, after, moved = (float(power[other].sum()) / m for power in of_judging)
            follows = left > max(NOISY, LEFT * first) and _is_structured(
                fitted, self.white_left, own
            )
            # Each recording's noise is known only to a factor NOISY.
            noise = NOISY**2 * max(1.0, left + 1.0)
            if follows or (moved > NOISY and after - 1.0 > max(noise, LEFT * (before - 1.0))):
                found.append(row)
        return found

    @cached_property
    def white_left(self) -> Array:
        """What is left of the recordings that were fitted, whitened (rows,)."""
        model, fit = self.best.model, self.best
        left = model.y - model.N @ (fit.numbers - fit.far_off)
        for t in fit.terms:
            sizes = [*np.ones(int(t.offset is not None)), *fit.raw(t)]
            left = left - np.hstack(t.parts) @ sizes
        return left

    def imperfections(self) -> tuple[Imperfection, ...]:
        """Return what the recordings say of each number."""
        problem, total = self.prepared.problem, self._numbers[0]
        stds = np.sqrt(np.maximum(np.diag(self.best.number_covariance), 0.0))
        values = self.explanation.linear.values
        off = beyond(self.best, values, problem.numbers) > 0.5
        sources = problem.sources
        return tuple(
            Imperfection(
                p.what,
                p.joint,
                p.unit,
                p.value(value),
                float(std * p.slope(value)),
                p.prior_std,
                not bool(far),
                None if p.recording is None else sources[p.recording],
                p.neutral,
            )
            for p, value, std, far in zip(problem.numbers, total, stds, off, strict=True)
            if p.is_number
        )

    @cached_property
    def known(self) -> list[tuple[EffectInstance, dict[str, ParameterEstimate]]]:
        """The known effects as they came out."""
        values = self.explanation.linear.values
        return [
            estimated(self.best, t, self.prepared.problem.numbers, values)[::-1]
            for t in self._always
        ]

    def result(self) -> Diagnosis:
        """Return the diagnosis."""
        prepared, problem = self.prepared, self.prepared.problem
        causes, laws, rows = self.causes(), self.laws, self.open_rows
        before, after = self.gaps
        unexplained = self._unexplained()
        unexplained += [
            UnexplainedResidual(e.joint, e.side, "event", e.rmse)
            for e in (*prepared.ignored, *prepared.events)
        ]
        verdict = "unknown" if unexplained else "explained" if causes else "none"
        share = self.shrink.share
        if share is None and causes:
            share = self._whitened_share()
        data, names = self.judging.data, problem.robot.joint_names
        live = problem.layout.live

        def named(values: Array) -> dict[tuple[str, str], float]:
            rows = zip(self.places, values, live, strict=True)
            return {place: float(value) for place, value, there in rows if there}

        noise, over = named(np.sqrt(before.noise.sum(axis=1))), named(after.rmse)
        left = {place[0] for place, size in over.items() if size > SURE * noise[place]}
        ratios = [self._gear_ratios(row) for row in range(len(self.places))]
        return Diagnosis(
            model=problem.model,
            robot=problem.robot.name,
            joints=names,
            prismatic=tuple(problem.robot.units.prismatic),
            identify=prepared.sources[0],
            validate=prepared.sources[1],
            independent_motion=prepared.independent_motion,
            judged=prepared.judged,
            band=problem.band.cutoff,
            trust=self.explanation.trust,
            verdict=verdict,
            noise=noise,
            before=ResidualSizes(named(before.rmse), named(before.peak)),
            after=ResidualSizes(named(after.rmse), named(after.peak)),
            shrink=None if verdict == "none" else share,
            shrink_interval=None
            if verdict == "none" or share is None
            else self.shrink.interval or (share, share),
            shrink_by_place={
                p: (None if np.isnan(v) else v) for p, v in named(self.shrink.by_row).items()
            },
            causes=tuple(cause for cause, _ in causes),
            not_confirmed=self.not_confirmed(),
            unexplained=tuple(sorted(unexplained, key=lambda place: -place.rmse)),
            imperfections=self.imperfections(),
            made=prepared.made,
            changes=changes_between(self.explanation, problem),
            known=tuple(
                {
                    "effect": instance.effect.id,
                    "joint": instance.joint,
                    "sides": list(instance.sides),
                    "parameters": plain_parameters(parameters),
                }
                for instance, parameters in self.known
            ),
            events=(*prepared.ignored, *prepared.events),
            notes=tuple(self._notes(laws, rows, left)),
            context=DiagnosisContext(
                explanation=self.explanation,
                judging=self.judging,
                before=self.before,
                after=self.after,
                alone=[alone for _, alone in causes],
                regimes=[
                    shares(data, self.before, row, ratios[row]) for row in range(len(self.places))
                ],
                known=tuple(instance for instance, _ in self.known),
                unseen=prepared.unseen,
                held_back=problem.held_back,
            ),
        )

    def _notes(
        self, laws: Sequence[tuple[float, Unknown]], rows: Sequence[int], left: Set[str]
    ) -> Iterator[str]:
        """Yield what the reader should know besides: of laws, of rows that are open, and of joints
        that keep much."""
        prepared, problem = self.prepared, self.prepared.problem
        if not self.explanation.is_whole:
            yield UNFINISHED
        yield from (self._unknown_note(term) for _, term in laws)
        yield from (shape_note(*self.places[row]) for row in rows)
        yield from event_notes((*prepared.ignored, *prepared.events))
        if left and not problem.robot.elastic:
            found = resonances(
                problem.robot, problem.model, [o.pieces for o in problem.observed[0]]
            )
            of_left = {joint: frequency for joint, frequency in found.items() if joint in left}
            yield from ringing_notes(of_left, prepared.made)
        yield from prepared.notes
        if not prepared.independent_motion:
            yield REPEATED_MOTION

    def _unknown_note(self, term: Unknown) -> str:
        joint = self.prepared.problem.robot.joint_names[term.place[0]]
        if isinstance(term, UnnamedTerm):
            return unnamed_note(joint, term.feature.effect.id)
        return law_note(joint, term.law)

    def _whitened_share(self) -> float:
        """Return the share of the whitened power over the noise that is gone, where no octave shows
        a gap by itself."""
        model, fit = self.best.model, self.best
        empty = model.fit(())
        first, left = (
            float(np.sum(np.maximum(f.found.left - model.bands.n, 0.0))) for f in (empty, fit)
        )
        return 1.0 - left / first if first else 0.0

    def _unexplained(self) -> list[UnexplainedResidual]:
        result = []
        for row in self._unknown_rows:
            (joint, side), rmse = self.places[row], float(self.gaps[1].rmse[row])
            shown = shares(self.judging.data, self.after, row, self._gear_ratios(row))
            result.append(UnexplainedResidual(joint, side, regime(shown), rmse))
        return result

    def _gear_ratios(self, row: int) -> tuple[float, float]:
        """Return r_hd and r_tot of the joint to which a residual belongs."""
        robot = self.prepared.problem.robot
        gear = robot.joints[row % robot.n].transmission
        return (gear.harmonic_drive_ratio, gear.r_tot) if gear else (1.0, 1.0)


def _slow(bands: Bands, row: int) -> NDArray[np.bool_]:
    """Return which bands are those of a residual at the frequencies of motion."""
    return (bands.place == row) & (OCTAVES[np.minimum(bands.octave, len(OCTAVES) - 1)] <= MOTION)


def _is_structured(bands: Bands, white: Array, among: NDArray[np.bool_]) -> bool:
    """Whether what is left in some bands of whitened rows is likelier of a motion than noise.

    Noise spreads its power p over the harmonics of an octave exponentially, p(p) = exp(-p/m)/m;
    what follows a motion has much of it in few, p(p) = s/(s + p)². They are taken at the mean m and
    the median s of the powers.
    """
    power = np.sum(white.reshape(-1, 2) ** 2, axis=1)
    of_pairs, odds = bands.of_rows[::2], 0.0
    for band in bands.used[among]:
        p = power[of_pairs == band] + 1e-12
        m, s = float(np.mean(p)), float(np.median(p))
        odds += float(np.sum(np.log(s) - 2.0 * np.log(s + p) + np.log(m) + p / m))
    return odds > 0.0


def _name(key: Key) -> Name:
    return key[0], key[1]


def _minus(first: Sequence[Array], added: Sequence[Sequence[Array]]) -> list[Array]:
    """Return residuals of each stretch without what some terms add."""
    left = [y.copy() for y in first]
    for own in added:
        for y, more in zip(left, own, strict=True):
            y -= more
    return left
