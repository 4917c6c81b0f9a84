"""The search over sets of terms, alternating with linearisation about the best set.

    S_{k+1} = best set found from S_k at the linearisation of S_k
    score(S_{k+1}) counts at the linearisation of S_{k+1}

Both steps repeat until no set is better (:mod:`.frontier`). The search starts at the description,
and again at the description with friction in every drive.
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
from elastic_arm.evidence.gauss_newton import about_itself, is_far, linear_model, moving_numbers
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
    ZEROS,
    Assumed,
)
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.search import ADDED, ALL, SIMPLE, Search, Thetas, words_of
from elastic_arm.evidence.terms.dry_friction import dry_friction_terms
from elastic_arm.evidence.terms.effect import effect_terms
from elastic_arm.evidence.terms.known import coefficients_of, known_terms, theta_of
from elastic_arm.evidence.terms.law import law_terms
from elastic_arm.evidence.terms.number import number_terms
from elastic_arm.evidence.terms.term import Term, odds_among
from elastic_arm.evidence.terms.unnamed import unnamed_terms
from elastic_arm.evidence.watch import Stage, Watch

# Moves by which a set is expanded: at first, and where these find no better set.
STAGES = (SIMPLE, ALL)
# Share of a search that is typically still to come after each set that is linearised about itself.
EACH = 0.8


@dataclass
class Shared:
    """What searches at several linearisations share."""

    thetas: Thetas = field(default_factory=dict)  # where nonlinear numbers were most probable
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

    refit: whether the description cannot be as measured; watch: who is told of the stages, and may
    end the search; look: takes the fit of ordinary deviations and friction, before the search.
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
    del first, start, starts  # they hold all data of their linearisations
    exploration.follow_up(others)
    best = exploration.run()
    known = _known(best, exploration.frontier.scores, log, _assumptions(problem, refit))
    return replace(known, is_whole=best.depth == exploration.frontier.depths)


class _Exploration:
    """The linearisations and searches by which a frontier moves on.

    start: the set from which it begins; log: the lines of all searches.
    """

    def __init__(self, start: Node, refit: bool, shared: Shared, log: list[str]) -> None:
        self.refit = refit
        self.shared = shared
        self.log = log
        self.frame: Frame = start.fit.frame  # in which all scores compare
        self.first_score: float = start.fit.score
        is_over = shared.watch.is_over
        self.frontier = Frontier(
            start, self._linearise, self._expand, depths=len(STAGES), is_over=is_over
        )

    def follow_up(self, others: list[Node]) -> None:
        """Linearise the best sets of the other starts about themselves; each is let go then."""
        while others and not self.shared.watch.is_over():
            other = others.pop(0)
            if other.fit.keys not in self.frontier.scores:
                self.frontier.take(other.fit, other)

    def run(self) -> Node:
        """Return the best set, after all moves and the likeliest sets with distant numbers."""
        best = self.frontier.run()
        tried: set[frozenset[Key]] = set()
        for _ in range(ELSEWHERE):
            if self.shared.watch.is_over() or best.found is None:
                break
            # The scores of sets with distant numbers use the wrong columns here.
            distant = _likeliest_distant(best.found, tried)
            if distant is None:
                break
            tried.add(distant.keys)
            self.frontier.take(distant)
            best = self.frontier.run()
        if best.found is None:  # ended before anything was looked for from there
            best.found = self._search(best, moves=0)
        return best

    def _linearise(self, fit: Fit, near: Node) -> Node:
        """Return a set at its own linearisation, from that of a node at which it was met."""
        least = self.frontier.best.fit.score - COMPARED
        there, own = about_itself(near.linear, fit, self.frame, least)
        gain = own.score - near.fit.score
        self.log.append(f"linearised about itself: {gain:+.1f}: {words_of(own, near.fit)}")
        causes = sum(term.says_cause for term in own.optional)
        of_all = own.score - self.first_score
        self.shared.linearised += 1
        self.shared.watch.say(
            f"set of {causes} causes: {of_all:+.0f} nats, compared with the first set",
            Stage.CAUSES,
            1.0 - EACH**self.shared.linearised,
        )
        return Node(own, there)

    def _expand(self, node: Node, scores: Mapping[Any, float]) -> Sequence[Fit]:
        """Return the path of a search from a node at its own linearisation."""
        moves = STAGES[node.depth]
        own = node.fit.correction  # scores at its linearisation lack it
        others = {keys: score - own for keys, score in scores.items() if keys != node.fit.keys}
        found = self._search(node, moves, others)
        self.log.extend(found.log)
        node.found = found
        if moves == ALL or node is not self.frontier.best:
            found.without_screens()  # nothing more is looked for from there
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
    """Return what the priors of an arm may share: trust in the description, scale of the zeros.

    refit: whether the description cannot be as measured.
    """
    has_zeros = any(number.kind == "zero" for number in problem.numbers)
    scales = [*ZEROS] if has_zeros else [1.0]
    found = [] if refit else [AS_MEASURED]
    found += [Assumed(name, zeros) for name in TRUST if name != MEASURED for zeros in scales]
    return found


def _known(
    node: Node, scores: Mapping[Any, float], log: Sequence[str], assumptions: Sequence[Assumed]
) -> Explanation:
    """Return the explanation at the best node: sets that were linearised about themselves have that
    score.

        p(S | y) = sum over what may be assumed, a, of p(S, a | y)
    """
    found: Explanation = node.found
    met = found.search.met
    for keys, fit in met.items():
        if keys in scores:
            own = scores[keys] - node.fit.correction
            met[keys] = replace(fit, correction=fit.correction + own - fit.score)
    best = max(met.values(), key=lambda fit: fit.score)
    least = best.score + float(np.log(SUMMED))
    # What is unlikely beside the best set is unlikely beside those that differ little from it.
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
    """Return the explanations that the first searches find, one of each start."""
    # If the description is exact, all that is left is an effect. If its numbers are off, false
    # effects are rarer where they were first fitted together with ordinary friction; beside a large
    # effect, however, such a fit moves them far.
    described = Linearisation(problem, np.zeros(len(problem.numbers)), _stated(problem))
    usual = linear_model(described, AS_BUILT).fit(_usual_terms(described))
    built, fitted = about_itself(described, usual, usual.frame, settled=1.0)
    # Each is dropped again where the recordings do not show it.
    terms = [*fitted.optional, *dry_friction_terms(built)]
    if shared.look is not None:
        usual = fitted.model.fit(terms, fitted)
        shared.look(Explanation(built, Search(built, fitted.model, ()), usual, [usual]))
    shared.watch.say("search for causes", Stage.CAUSES)
    starts = [_explained(built, terms, AS_BUILT, refit, shared, moves=ADDED)]
    if refit:
        return starts
    exact = _explained(described, (), AS_MEASURED, refit, shared, moves=ADDED, most=FIRST)
    starts.insert(0, exact)
    if all(one.best.model.assumed != AS_MEASURED for one in starts):
        # One large deviation may have been spread over many small ones.
        starts.append(_explained(built, terms, AS_MEASURED, refit, shared, moves=ADDED, most=FIRST))
    return starts


def _usual_terms(linear: Linearisation) -> list[Term]:
    """Return what every real drive has and the description does not state."""
    problem = linear.problem
    features = [feature for feature in problem.candidates if feature.key in problem.usual]
    return list(effect_terms(linear, linear.placed(features), problem.usual))


def _stated(problem: Problem) -> tuple[ActingEffect, ...]:
    """Return what the description states to act, at its stated size: gains scale it, too."""
    return tuple(
        ActingEffect(
            feature, theta_of(feature, instance), coefficients_of(feature, instance.parameters)
        )
        for feature, instance in problem.known[: len(problem.stated)]
        if not feature.fixed and not isinstance(feature.effect, (SensorEffect, ControllerEffect))
    )


def _likeliest_distant(found: Explanation, tried: Set[frozenset[Key]]) -> Fit | None:
    """Return the likeliest set of which a number differs from the best set's by more than one
    standard deviation of its prior."""
    moving = moving_numbers(found.linear.problem)
    sets = (
        fit
        for keys, fit in found.search.met.items()
        if keys not in tried
        and np.max(np.abs(fit.numbers - found.best.numbers)[moving], initial=0.0) > 1.0
    )
    return max(sets, key=lambda fit: fit.score, default=None)


def _screens(linear: Linearisation, model: LinearModel, *, laws: bool) -> list[Screen]:
    """Return what may be added, nonparametric laws apart; made once."""
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
    """Return the most probable set at a linearisation, from one to start from.

    most: steps that the search may take; own_scores: scores of sets at their own
    linearisations, as they compare with those at this one.
    """
    parts = linear, refit, shared, moves, most, own_scores or {}
    found = _alternated(start, assumed, *parts)
    alone = found.best.model.assumed._replace(zeros=1.0)
    if alone == found.best.model.assumed or shared.watch.is_over():
        return found
    # One zero far off is more than one move from all zeros on a larger scale.
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
    if tried[assumed] is not search:  # found under another assumption since
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
    """Yield the effects, numbers and stated effects that may be there."""
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
        yield from (t.with_odds(odds[t.key]) for t in terms)
