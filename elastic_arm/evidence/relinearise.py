"""The search over sets of terms, alternating with linearisation about the best set.

    S_{k+1} = best set found from S_k at the linearisation of S_k
    score(S_{k+1}) counts at the linearisation of S_{k+1}

Both steps repeat until no set is better (:mod:`.frontier`). The search starts at the description
with friction in every drive, and again at a fit of ordinary deviations and of the lag of each
channel, with friction that turns over within a distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from elastic_arm.effects.effect import ControllerEffect, SensorEffect
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.explanation import Explanation, weighted
from elastic_arm.evidence.fit import Fit, Frame, LinearModel
from elastic_arm.evidence.frontier import Frontier, Node
from elastic_arm.evidence.gauss_newton import (
    about_itself,
    again,
    at_lags,
    is_far,
    linear_model,
    moved,
    moving_numbers,
)
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import (
    AS_BUILT,
    AS_MEASURED,
    COMPARED,
    ELSEWHERE,
    FIRST,
    MEASURED,
    MOST,
    SUMMED,
    TRUST,
    WORTH,
    ZEROS,
    Assumed,
)
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.search import ADDED, ALL, SIMPLE, Search, Thetas, without, words_of
from elastic_arm.evidence.terms.dry_friction import dry_friction_terms
from elastic_arm.evidence.terms.effect import effect_terms
from elastic_arm.evidence.terms.known import coefficients_of, known_terms, theta_of
from elastic_arm.evidence.terms.law import law_terms
from elastic_arm.evidence.terms.number import number_terms
from elastic_arm.evidence.terms.term import Term, odds_among
from elastic_arm.evidence.terms.unnamed import unnamed_terms
from elastic_arm.evidence.watch import Stage, Watch
from elastic_arm.formatting import counted

# Numbers of moves that expand a set: first these, then more if they find no better set.
STAGES = (SIMPLE, ALL)
# Typical remaining share of a search after each set that was linearised about itself.
EACH = 0.8


@dataclass
class Shared:
    """Quantities that searches at several linearisations share."""

    thetas: Thetas = field(default_factory=dict)  # the most probable nonlinear numbers so far
    watch: Watch = field(default_factory=Watch)
    look: Callable[[Explanation], None] | None = None
    linearised: int = 0  # sets that were linearised about themselves


def explain(
    problem: Problem,
    *,
    refit: bool,
    watch: Watch | None = None,
    look: Callable[[Explanation], None] | None = None,
) -> Explanation:
    """Return the most probable explanation of all recordings.

    refit: whether to exclude the trust `as measured`; watch: receives the stages and may end the
    search; look: receives the fit of ordinary deviations and friction before the search.
    """
    watch = watch or Watch()
    watch.say("fit of ordinary deviations and friction", Stage.ORDINARY)
    shared = Shared(watch=watch, look=look)
    starts = [found.without_screens() for found in _begun(problem, refit, shared)]
    log = [line for one in starts for line in one.log]
    of_one = starts[0].best.frame
    starts.sort(key=lambda found: -found.best.compared_in(of_one).score)
    first = starts[0]
    others = [Node(one.best, one.linear) for one in starts[1:]]
    start = Node(first.path[0], first.linear, found=first)
    exploration = _Exploration(start, refit, shared, log)
    exploration.frontier.follow(first.path)
    del first, start, starts  # frees the data of their linearisations
    exploration.follow_up(others)
    best = exploration.run()
    known = _known(best, exploration.frontier.scores, log, _assumptions(problem, refit))
    return replace(known, is_whole=best.depth == exploration.frontier.depths)


class _Exploration:
    """The linearisations and searches of a frontier.

    start: first set; log: lines of all searches.
    """

    def __init__(self, start: Node, refit: bool, shared: Shared, log: list[str]) -> None:
        self.refit = refit
        self.shared = shared
        self.log = log
        self.frame: Frame = start.fit.frame  # the frame in which all scores compare
        self.first_score: float = start.fit.score
        is_over = shared.watch.is_over
        self.frontier = Frontier(
            start, self._linearise, self._expand, depths=len(STAGES), is_over=is_over
        )

    def follow_up(self, others: list[Node]) -> None:
        """Linearise the best sets of the other starts about themselves, and discard each."""
        while others and not self.shared.watch.is_over():
            other = others.pop(0)
            if other.fit.keys not in self.frontier.scores:
                self.frontier.take(other.fit, other)

    def run(self) -> Node:
        """Return the best set, after all moves and the most probable sets with distant numbers."""
        best = self.frontier.run()
        tried: set[frozenset[Key]] = set()
        for _ in range(ELSEWHERE):
            if self.shared.watch.is_over() or best.found is None:
                break
            # The columns here are wrong for sets with distant numbers.
            distant = _likeliest_distant(best.found, tried)
            if distant is None:
                break
            tried.add(distant.keys)
            self.frontier.take(distant)
            best = self.frontier.run()
        while not self.shared.watch.is_over() and self.frontier.retry(_simpler(best.fit)):
            best = self.frontier.run()
        if best.found is None:  # the search ended before this set was expanded
            best.found = self._search(best, moves=0)
        return best

    def _linearise(self, fit: Fit, near: Node) -> Node:
        """Return a set at its own linearisation, starting from that of a node."""
        least = self.frontier.best.fit.score - COMPARED
        there, own = about_itself(near.linear, fit, self.frame, least)
        gain = own.score - near.fit.score
        self.log.append(f"linearised about itself: {gain:+.1f}: {words_of(own, near.fit)}")
        causes = sum(term.says_cause for term in own.optional)
        of_all = own.score - self.first_score
        self.shared.linearised += 1
        self.shared.watch.say(
            f"set of {counted(causes, 'cause')}: {of_all:+.0f} nats, compared with the first set",
            Stage.CAUSES,
            1.0 - EACH**self.shared.linearised,
        )
        return Node(own, there)

    def _expand(self, node: Node, scores: Mapping[Any, float]) -> Sequence[Fit]:
        """Return the path of a search from a node at its own linearisation."""
        moves = STAGES[node.depth]
        own = node.fit.correction  # correction that scores at its linearisation lack
        others = {keys: score - own for keys, score in scores.items() if keys != node.fit.keys}
        found = self._search(node, moves, others)
        self.log.extend(found.log)
        node.found = found
        if moves == ALL or node is not self.frontier.best:
            found.without_screens()  # the set is not expanded any more
        return found.path

    def _search(
        self,
        node: Node,
        moves: int,
        own_scores: Mapping[frozenset[Key], float] | None = None,
    ) -> Explanation:
        assumed = node.fit.model.assumed
        terms = node.fit.optional
        return _explained(
            node.linear, terms, assumed, self.refit, self.shared, moves=moves, own_scores=own_scores
        )


def _assumptions(problem: Problem, refit: bool) -> list[Assumed]:
    """Return all assumptions: trust in the description, and scale of the zeros.

    refit: whether to exclude the trust `as measured`.
    """
    has_zeros = any(number.kind == "zero" for number in problem.numbers)
    scales = [*ZEROS] if has_zeros else [1.0]
    found = [] if refit else [AS_MEASURED]
    found += [Assumed(name, zeros) for name in TRUST if name != MEASURED for zeros in scales]
    return found


def _known(
    node: Node, scores: Mapping[Any, float], log: Sequence[str], assumptions: Sequence[Assumed]
) -> Explanation:
    """Return the explanation at the best node, with the own scores of sets that were linearised
    about themselves.

        p(S | y) = sum over assumptions a of p(S, a | y)
    """
    found: Explanation = node.found
    met = found.search.met
    for keys, fit in met.items():
        if keys in scores:
            own = scores[keys] - node.fit.correction
            met[keys] = replace(fit, correction=fit.correction + own - fit.score)
    best = max(met.values(), key=lambda fit: fit.score)
    least = best.score + float(np.log(SUMMED))
    # Assumptions that are improbable for the best set are improbable for similar sets.
    beside = [best.model.assuming(one).fit(best.optional, best) for one in assumptions]
    likely = [fit.model.assumed for fit in beside if fit.score + best.correction > least]
    fits: list[Fit] = []
    for fit in (fit for fit in met.values() if fit.score > least):
        own = fit.model.assumed
        fits.append(fit)
        for other in (one for one in likely if one != own):
            under = fit.model.assuming(other).fit(fit.optional, fit)
            fits.append(replace(under, correction=fit.correction))
    best = max(fits, key=lambda fit: fit.score)
    return replace(found, best=best, sets=weighted(fits), log=tuple(log))


def _begun(problem: Problem, refit: bool, shared: Shared) -> list[Explanation]:
    """Return the explanations of the first searches, one for each start."""
    # If the description is exact, all residuals are effects. If its numbers are off, a first fit of
    # numbers and ordinary friction avoids false effects. Beside a large effect, however, such a fit
    # moves the numbers far.
    described = Linearisation(problem, np.zeros(len(problem.numbers)), _stated(problem))
    usual = linear_model(described, AS_BUILT).fit(_usual_terms(described))
    first = moved(described, usual)
    # Without them, a lag of the torque would stand for friction that turns over within a distance.
    # The search drops each of them that the recordings do not show.
    terms = [*again(usual, first), *dry_friction_terms(first)]
    begun = linear_model(first, AS_BUILT).fit(terms)
    begun = begun.model.fit(again(begun, first), begun).compared_in(usual.frame)
    late, begun = at_lags(first, begun, usual.frame)
    built, fitted = about_itself(late, begun, usual.frame, settled=1.0)
    terms = list(fitted.optional)
    if shared.look is not None:
        shared.look(Explanation(built, Search(built, fitted.model, ()), fitted, [fitted]))
    shared.watch.say("search for causes", Stage.CAUSES)
    starts = [_explained(built, terms, AS_BUILT, refit, shared, moves=ADDED)]
    # Ordinary deviations that stand for a large effect may move the linearisation so far that the
    # columns of the effect are wrong there.
    near = [*usual.optional, *dry_friction_terms(described)]
    starts.append(_explained(described, near, AS_BUILT, refit, shared, moves=ADDED, most=FIRST))
    if refit:
        return starts
    exact = _explained(described, (), AS_MEASURED, refit, shared, moves=ADDED, most=FIRST)
    starts.insert(0, exact)
    if all(one.best.model.assumed != AS_MEASURED for one in starts):
        # The fit may have spread one large deviation over many small ones.
        starts.append(_explained(built, terms, AS_MEASURED, refit, shared, moves=ADDED, most=FIRST))
    return starts


def _usual_terms(linear: Linearisation) -> list[Term]:
    """Return the terms that every real drive has and the description does not state."""
    problem = linear.problem
    features = [feature for feature in problem.candidates if feature.key in problem.usual]
    return list(effect_terms(linear, linear.placed(features), problem.usual))


def _stated(problem: Problem) -> tuple[ActingEffect, ...]:
    """Return the described effects at their stated sizes, which gains scale as well."""
    return tuple(
        ActingEffect(
            feature, theta_of(feature, instance), coefficients_of(feature, instance.parameters)
        )
        for feature, instance in problem.known[: len(problem.stated)]
        if not feature.fixed and not isinstance(feature.effect, (SensorEffect, ControllerEffect))
    )


def _simpler(fit: Fit) -> list[Fit]:
    """Return the sets with one term less that are better at the linearisation of a set, the best
    first."""
    without_one = [fit.model.fit(without(fit, term), fit) for term in fit.optional]
    least = fit.score - fit.correction + WORTH
    better = [one for one in without_one if one.score > least]
    return sorted(better, key=lambda one: -one.score)


def _likeliest_distant(found: Explanation, tried: Set[frozenset[Key]]) -> Fit | None:
    """Return the most probable set with a number more than one prior standard deviation from that
    of the best set."""
    moving = moving_numbers(found.linear.problem)
    sets = (
        fit
        for keys, fit in found.search.met.items()
        if keys not in tried
        and np.max(np.abs(fit.numbers - found.best.numbers)[moving], initial=0.0) > 1.0
    )
    return max(sets, key=lambda fit: fit.score, default=None)


def _screens(linear: Linearisation, model: LinearModel, *, laws: bool) -> list[Screen]:
    """Return the screens of candidates, computed once; nonparametric laws have one of their own."""
    if "pool" not in linear.cache:
        linear.cache["pool"] = Screen(model.grams, pool_of(linear))
    if laws and "laws" not in linear.cache:
        linear.cache["laws"] = Screen(model.grams, law_terms(linear))
    return [linear.cache[name] for name in ("pool", *["laws"] * laws)]


def _explained(
    linear: Linearisation,
    start: Sequence[Term],
    assumed: Assumed,
    refit: bool,
    shared: Shared,
    *,
    moves: int,
    most: int = MOST,
    own_scores: Mapping[frozenset[Key], float] | None = None,
) -> Explanation:
    """Return the most probable set at a linearisation.

    start: first set; most: largest number of steps; own_scores: scores of sets at their own
    linearisations, in the frame of this one.
    """
    parts = linear, refit, shared, moves, most, own_scores or {}
    found = _alternated(start, assumed, *parts)
    alone = found.best.model.assumed._replace(zeros=1.0)
    if alone == found.best.model.assumed or shared.watch.is_over():
        return found
    # A single far-off zero is more than one move away from a larger scale of all zeros.
    other = _alternated(found.best.optional, alone, *parts)
    better = max(found, other, key=lambda one: one.best.score)
    return replace(better, path=[*found.path, *other.path], log=(*found.log, *other.log))


def _alternated(
    start: Sequence[Term],
    assumed: Assumed,
    linear: Linearisation,
    refit: bool,
    shared: Shared,
    moves: int,
    most: int,
    own_scores: Mapping[frozenset[Key], float],
) -> Explanation:
    """Return the most probable set: search under one assumption, choose the most probable
    assumption for the set found, and repeat until neither changes."""
    assumptions = _assumptions(linear.problem, refit)
    model = linear_model(linear, assumed)
    log: list[str] = []
    screens = _screens(linear, model, laws=moves == ALL)
    terms = start
    tried: dict[Assumed, Search] = {}
    path: list[Fit] = []
    while assumed not in tried:
        known = linear.cache.setdefault("refined", {}).setdefault(assumed, {})
        search = Search(linear, model.assuming(assumed), screens, shared.thetas, own_scores, known)
        search.is_over = shared.watch.is_over
        search.is_far = is_far
        best = search.run(terms, moves=moves, most=most)
        tried[assumed] = search
        path += search.path
        log += [f"{_words(assumed)}: {line}" for line in search.log]
        terms = best.optional
        scores = {one: model.assuming(one).fit(terms, best).score for one in assumptions}
        assumed = max(scores, key=lambda one: scores[one])
    if tried[assumed] is not search:  # found under another assumption in the meantime
        search = tried[assumed]
        before = len(search.log)
        best = search.run(terms, moves=moves, most=most)
        path += search.path
        log += [f"{_words(assumed)}: {line}" for line in search.log[before:]]
    search.screens = ()
    model.grams.let_go()
    names = ", ".join(f"{key[0]} {key[1]}" for key in best.keys) or "nothing"
    log.append(f"{_words(assumed)}, {best.score:.1f}: {names}")
    return Explanation(linear, search, best, path, log=tuple(log))


def _words(assumed: Assumed) -> str:
    return f"{assumed.trust}, zeros x {assumed.zeros:g}"


def pool_of(linear: Linearisation) -> Iterator[Term]:
    """Yield all candidates except nonparametric laws."""
    problem = linear.problem
    yield from effect_terms(linear, linear.placed(problem.candidates), problem.usual)
    others: tuple[Sequence[Term], ...] = (
        number_terms(problem.numbers, linear.numbers, problem.far, problem.bodies),
        unnamed_terms(problem.numbers, linear.numbers, problem.far),
        known_terms(linear)[1],
        list(dry_friction_terms(linear)),
    )
    for terms in others:
        odds = odds_among((t.key for t in terms), problem.usual)
        yield from (replace(t, odds=odds[t.key]) for t in terms)
