"""Select a set of terms and linearise about it, alternately, until neither changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from elastic_arm.arrays import Array
from elastic_arm.effects.effect import ControllerEffect, SensorEffect
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.frontier import Frontier, Node
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import KINDS, Fit, Frame, LinearModel, Screen
from elastic_arm.evidence.nonlinear import placed_anew
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
from elastic_arm.evidence.search import ADDED, ALL, SIMPLE, Search, Thetas, words_of
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.effect import EffectTerm, effect_terms
from elastic_arm.evidence.terms.known import coefficients_of, known_terms, theta_of
from elastic_arm.evidence.terms.law import law_terms
from elastic_arm.evidence.terms.number import number_terms
from elastic_arm.evidence.terms.share import shares_of
from elastic_arm.evidence.terms.term import Term, odds_among
from elastic_arm.evidence.terms.turnover import turnover_terms
from elastic_arm.evidence.terms.unnamed import unnamed_terms
from elastic_arm.evidence.watch import Watch

STEPS = 8  # of Gauss and Newton beside a set; numerical
SHORTER = 0.3  # share of a step that was too long; numerical
SETTLED = 0.02  # of their standard deviations: steps of numbers that are none; numerical


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is most probably there, at the linearisation beside it."""

    linear: Linearisation  # where
    search: Search  # all sets met
    best: Fit  # the most probable one
    path: Sequence[Fit]  # better and better sets on the way to it
    # The sets that share the probability, each under every trust in the description; most probable
    # first.
    sets: Sequence[tuple[float, Fit]] = ()
    log: tuple[str, ...] = ()  # what was done, a line a step
    is_whole: bool = True  # whether all moves were tried

    @cached_property
    def trust(self) -> dict[str, float]:
        """The probability of each trust in the description."""
        found: dict[str, float] = {}
        for p, fit in self.sets:
            trust = fit.model.assumed.trust
            found[trust] = found.get(trust, 0.0) + p
        return found

    def without_screens(self) -> Explanation:
        """Let go of what may be added at its linearisation, which takes most of the memory, and
        return it."""
        for name in ("pool", "laws", "refined"):
            self.linear.cache.pop(name, None)
        return self

    def probability(self, held: Callable[[Key], bool]) -> float:
        """Return the probability of the sets that hold a term whose key is one of those."""
        return sum(p for p, fit in self.sets if any(held(key) for key in fit.keys))

    @cached_property
    def sized(self) -> Fit:
        """The most probable set with its sizes by the recordings that are fitted."""
        return self.best.model.of_fitted(self.best)

    @cached_property
    def settled(self) -> Linearisation:
        """The linearisation at the numbers of the most probable set, which may have been met beside
        another."""
        return _moved(self.linear, self.sized) if _far(self.sized) else self.linear


@dataclass
class Shared:
    """What searches at several linearisations share."""

    thetas: Thetas = field(default_factory=dict)  # where nonlinear numbers were most probable
    watch: Watch = field(default_factory=Watch)


def explain(problem: Problem, *, refit: bool, watch: Watch | None = None) -> Explanation:
    """Return the most probable explanation of all recordings.

    refit: whether the description cannot be as measured; watch: who is told of the stages, and may
    end the search.
    """
    watch = watch or Watch()
    watch.say("fit of ordinary deviations")
    shared = Shared(watch=watch)
    starts = [found.without_screens() for found in _begun(problem, refit, shared)]
    log = [line for one in starts for line in one.log]
    of_one = starts[0].best.frame
    starts.sort(key=lambda found: -found.best.compared_in(of_one).score)
    first = starts[0]
    others = [Node(one.best, one.linear) for one in starts[1:]]
    frame = first.path[0].frame
    score = first.path[0].score

    def linearise(fit: Fit, near: Node) -> Node:
        there, own = _about_itself(near.linear, fit, frame, frontier.best.fit.score - COMPARED)
        log.append(
            f"linearised about itself: {own.score - near.fit.score:+.1f}: {words_of(own, near.fit)}"
        )
        gain = own.score - score
        causes = sum(term.says_cause for term in own.optional)
        watch.say(f"best set: {causes} causes, {gain:.0f} nats more probable than none")
        return Node(own, there)

    def expand(node: Node, scores: Mapping[Any, float]) -> Sequence[Fit]:
        moves = (SIMPLE, ALL)[node.depth]
        own = node.fit.correction  # scores at its linearisation lack it
        others = {keys: score - own for keys, score in scores.items() if keys != node.fit.keys}
        assumed = node.fit.model.assumed
        found = _explained(
            node.linear, node.fit.optional, assumed, refit, shared, moves=moves, refused=others
        )
        log.extend(found.log)
        node.found = found
        if moves == ALL or node is not frontier.best:
            found.without_screens()  # nothing more is looked for from there
        return found.path

    def follow_up(other: Node) -> None:
        # What each start leads to is judged where its own numbers lie.
        if other.fit.keys not in frontier.scores:
            frontier.take(other.fit, other)

    start = Node(first.path[0], first.linear, found=first)
    frontier = Frontier(start, linearise, expand, depths=2, is_over=watch.is_over)
    frontier.follow(first.path)
    del first, start, starts  # they hold all data of their linearisations
    while others and not watch.is_over():
        follow_up(others.pop(0))
    best = frontier.run()
    tried: set[frozenset[Key]] = set()
    for _ in range(ELSEWHERE):
        if watch.is_over() or best.found is None:
            break
        # Exchanged at this linearisation, a set whose numbers lie elsewhere is judged by columns
        # that are not its own.
        elsewhere = _elsewhere(best.found, tried)
        if elsewhere is None:
            break
        tried.add(elsewhere.keys)
        frontier.take(elsewhere)
        best = frontier.run()
    if best.found is None:  # ended before anything was looked for from there
        nothing_more = _explained(
            best.linear, best.fit.optional, best.fit.model.assumed, refit, shared, moves=0
        )
        best.found = nothing_more
    known = _known(best, frontier.scores, log, _assumptions(problem, refit))
    return replace(known, is_whole=best.depth == frontier.depths)


def _about_itself(
    linear: Linearisation,
    fit: Fit,
    start: Frame,
    least: float = -np.inf,
    settled: float = SETTLED,
) -> tuple[Linearisation, Fit]:
    """Return a set linearised about its own numbers, from those that it has at another
    linearisation.

    Gauss and Newton: numbers of the arm and nonlinear numbers of effects move together. A step that
    loses much was too long. A set that is further below a score than its last step moved it will
    not reach it.

    start: in which frame scores are; least: the score; settled: steps of numbers that are none, in
    their deviations.
    """
    assumed = fit.model.assumed
    before: Fit | None = None
    share = 1.0
    for _ in range(STEPS):
        if share == 1.0 and _has_settled(linear, fit, settled):
            break
        there = _moved(linear, fit, share)
        own = linear_model(there, assumed).fit(_again(fit, there)).compared_in(start)
        gain = np.inf if before is None else own.score - before.score
        if gain < -COMPARED and share == 1.0:
            share = SHORTER
            continue
        # A score counts where the numbers lie, so that a lower one nearer to them is the better
        # known.
        linear, fit, share = there, own, 1.0
        before = own
        if abs(gain) < WORTH or own.score + abs(gain) < least:
            break
    return linear, fit.compared_in(start)


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


def weighted(fits: Sequence[Fit]) -> list[tuple[float, Fit]]:
    """Return fits with their probabilities, the most probable first."""
    scores = np.array([fit.score for fit in fits])
    p = np.exp(scores - logsumexp(scores))
    return sorted(zip(p.tolist(), fits, strict=True), key=lambda one: -one[0])


def _begun(problem: Problem, refit: bool, shared: Shared) -> list[Explanation]:
    """Return what several starts lead to."""
    # If the description is exact, all that is left is an effect. If its numbers are off, false
    # effects are rarer where they were first fitted together with ordinary friction; beside a large
    # effect, however, such a fit moves them far.
    described = Linearisation(problem, np.zeros(len(problem.numbers)), _stated(problem))
    usual = linear_model(described, AS_BUILT).fit(_usual_terms(described))
    built, fitted = _about_itself(described, usual, usual.frame, settled=1.0)
    # Each is dropped again where the recordings do not show it.
    terms = [*fitted.optional, *turnover_terms(built)]
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


def _elsewhere(found: Explanation, tried: Set[frozenset[Key]]) -> Fit | None:
    """Return the likeliest set with a number more than an ordinary deviation from where the best
    one has it."""
    moving = _moving(found.linear.problem)
    sets = (
        fit
        for keys, fit in found.search.met.items()
        if keys not in tried
        and np.max(np.abs(fit.numbers - found.best.numbers)[moving], initial=0.0) > 1.0
    )
    return max(sets, key=lambda fit: fit.score, default=None)


def _moving(problem: Problem) -> NDArray[np.bool_]:
    """Return at which numbers' values (K,) the residuals are made."""
    return np.array([p.moves_model for p in problem.numbers], dtype=bool)


def _has_settled(linear: Linearisation, fit: Fit, none: float) -> bool:
    """Whether a fit moves nothing by which its linearisation would be another: effects that act in
    its torques, numbers, nonlinear numbers.

    none: steps of numbers that count as none, in their deviations.
    """
    acting = {one.feature.key for one in linear.acting}
    if {one.feature.key for one in _acting(fit)} != acting:
        return False
    moves = [_steps(fit), *(t.steps(fit) for t in fit.terms if isinstance(t, EffectTerm))]
    return bool(np.max(np.concatenate(moves), initial=0.0) < none)


def _far(fit: Fit) -> bool:
    """Whether one of a fit's numbers is further from the linearisation than its deviation."""
    return bool(np.max(_steps(fit), initial=0.0) > 1.0)


def _steps(fit: Fit) -> Array:
    """Return how far a fit's numbers are from the linearisation, in their deviations."""
    steps = np.abs(fit.numbers) / np.sqrt(np.diag(fit.number_covariance))
    return np.asarray(steps[fit.model.moving])


def _moved(linear: Linearisation, fit: Fit, share: float = 1.0) -> Linearisation:
    """Return the linearisation a share of the way to where a fit puts the numbers."""
    limits = np.array([p.limit for p in linear.problem.numbers])
    there = np.clip(linear.values + share * fit.numbers, -limits, limits)
    return linear.moved(np.where(fit.model.moving, there, 0.0), _acting(fit))


def linear_model(linear: Linearisation, assumed: Assumed) -> LinearModel:
    """Return the data at a linearisation; made once."""
    if "model" not in linear.cache:
        linear.cache["model"] = LinearModel(
            linear.data.white,
            linear.numbers,
            Bands(linear.data),
            -linear.values,
            np.array([KINDS.index(p.kind) for p in linear.problem.numbers], dtype=int),
            _moving(linear.problem),
            tuple(known_terms(linear)[0]),
            shares_of(linear),
            assumed,
            linear.data.density,
            linear.fitted_rows,
            linear.problem.usual,
        )
    return linear.cache["model"].assuming(assumed)


def _screens(linear: Linearisation, model: LinearModel, *, laws: bool) -> list[Screen]:
    """Return what may be added, laws without a form apart; made once."""
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
    refused: Mapping[frozenset[Key], float] | None = None,
) -> Explanation:
    """Return the most probable set at a linearisation, from one to start from.

    most: steps that the search may take; refused: scores of sets at their own
    linearisations, as they compare with those at this one.
    """
    assumptions = _assumptions(linear.problem, refit)
    model = linear_model(linear, assumed)
    log: list[str] = []
    screens = _screens(linear, model, laws=moves == ALL)
    terms = start
    # What is most probably assumed beside the set, and the set beside it, until both stay.
    tried: dict[Assumed, Search] = {}
    path: list[Fit] = []
    while assumed not in tried:
        known = linear.cache.setdefault("refined", {}).setdefault(assumed, {})
        search = Search(
            linear, model.assuming(assumed), screens, shared.thetas, refused or {}, known
        )
        search.is_over = shared.watch.is_over
        search.is_far = _far
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
        number_terms(problem.numbers, linear.numbers, problem.far),
        unnamed_terms(problem.numbers, linear.numbers, problem.far),
        known_terms(linear)[1],
        list(turnover_terms(linear)),
    )
    for terms in others:
        odds = odds_among((t.key for t in terms), problem.usual)
        yield from (t.with_odds(odds[t.key]) for t in terms)


def _acting(fit: Fit) -> tuple[ActingEffect, ...]:
    """Return the effects of a fit that act in the true torques."""
    terms = [t for t in fit.terms if isinstance(t, EffectTerm) and t.acts]
    return tuple(t.acting(fit, known=t in fit.model.always) for t in terms)


def _again(fit: Fit, linear: Linearisation) -> list[Term]:
    """Return the terms of a fit at another linearisation."""
    always = known_terms(linear)[0]
    found: list[Term] = []
    for t in sorted(fit.optional, key=lambda t: isinstance(t, ChangeTerm)):
        found += t.again(linear, fit, [*always, *found])
    for k, t in enumerate(found):
        if isinstance(t, EffectTerm) and t.was_relaxed:
            model = linear_model(linear, fit.model.assumed)
            found[k] = placed_anew(linear, model, t, [*found[:k], *found[k + 1 :]])
    return found
