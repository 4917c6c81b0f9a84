"""The search for the most probable set of terms, by moves from set to set.

Moves add, drop or exchange a term, replace two terms by one or one by two, or change the scale of a
size. The gain of a term at the noise of the present fit proposes a move, and the score of the whole
set decides. All scored sets are kept, because probabilities are sums over them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from elastic_arm.evidence.fit import Fit, LinearModel
from elastic_arm.evidence.keys import Ident, Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.nonlinear import refined
from elastic_arm.evidence.priors import (
    APART,
    COMPARED,
    ELSEWHERE,
    MOST,
    RELATED,
    SCALES,
    SHORT,
    SIZES,
    TRIED,
    TRIED_OF_TWO,
    WORTH,
)
from elastic_arm.evidence.problem import FITTED
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.terms.change import change_key, change_of, may_change
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.law import LawTerm
from elastic_arm.evidence.terms.term import Term
from elastic_arm.evidence.watch import Watch

Thetas = dict[Key, tuple[float, ...]]
Move = Callable[[Fit], Iterator[Fit]]
# how many of the moves of a search, in their order
ADDED = 2  # add a term, choose its scale
SIMPLE = 4  # also drop and exchange one
ALL = 7


class Replacements(NamedTuple):
    """What may take the place of terms."""

    excluded: frozenset[Key]  # keys of the set itself
    among: list[set[int]]  # terms of each screen


@dataclass
class Search:
    """A search over sets of terms at one linearisation."""

    # linear, model, screens: the data, and all that may be added
    linear: Linearisation
    model: LinearModel
    screens: Sequence[Screen]
    # where one nonlinear number was most probable beside another set, by key of its term; what is
    # found is added
    thetas: Thetas = field(default_factory=dict)
    # scores of sets at their own linearisation
    own_scores: Mapping[frozenset[Key], float] = field(default_factory=dict)
    # terms with nonlinear numbers where they are most probable beside others, of earlier searches
    # at the same data and assumptions; what is found is added
    refined: dict[tuple[Key, frozenset[Ident]], EffectTerm] = field(default_factory=dict)
    met: dict[frozenset[Key], Fit] = field(default_factory=dict)
    # beside which sets a range was scanned
    _looked: set[tuple[Key, frozenset[Ident]]] = field(default_factory=set)
    log: list[str] = field(default_factory=list)
    is_over: Callable[[], bool] = Watch().is_over
    is_far: Callable[[Fit], bool] = lambda fit: False
    # better and better sets, the last one the most probable
    path: list[Fit] = field(default_factory=list)

    def run(self, start: Sequence[Term] = (), *, moves: int = ALL, most: int = MOST) -> Fit:
        """Return the most probable set met on the way from one to start from; the way is kept in
        `path`.

        moves: as many kinds as :data:`ADDED`, :data:`SIMPLE` or :data:`ALL`; most: steps of the
        way.
        """
        best = self._keep(self.model.fit(start))
        self.path = [best]
        while len(self.path) <= most and (better := self._better(best, moves)) is not None:
            self.log.append(f"{better.score - best.score:+.1f}: {words_of(better, best)}")
            best = better
            self.path.append(best)
            if self.is_far(best):
                break
        self._discard_improbable(best)
        return best

    @property
    def moves(self) -> tuple[Move, ...]:
        """All moves, the quick ones first: of :data:`ADDED`, :data:`SIMPLE`, :data:`ALL`."""
        return (
            self._added,
            self._rescaled,
            self._dropped,
            self._exchanged,
            self._scanned,
            self._two_for_one,
            self._one_for_two,
        )

    def _better(self, fit: Fit, count: int) -> Fit | None:
        """Return a better set by moves of one kind: more terms first, as they are cheap to find."""
        for move in self.moves[:count]:
            best = fit
            for one in move(fit):
                gain = one.score - fit.score
                if gain > WORTH:
                    best = self._together(fit, best, one)
                if self.is_over():
                    return None if best is fit else best
            if best is not fit:
                return best
            self._discard_improbable(fit)
        return None

    def _together(self, fit: Fit, best: Fit, one: Fit) -> Fit:
        """Return the better of two sets that are better than a fit, or what both change together.

        Moves at different joints gain as much together as each alone. Where they gain less, they
        are alternatives: the better one is taken, and the other one comes up again beside it.
        """
        if best is fit:
            return one
        better = max(best, one, key=lambda each: each.score)
        before = {t.ident for t in fit.optional}
        gone = before - {t.ident for t in one.optional}
        more = [t for t in one.optional if t.ident not in before]
        stays = [t for t in best.optional if t.ident not in gone]
        is_apart = len(stays) == len(best.optional) - len(gone)
        has_new = not best.keys & {t.key for t in more}
        if not is_apart or not has_new:
            return better
        both = self._keep(self.model.fit([*stays, *more], better))
        less = min(best.score, one.score) - fit.score
        return both if both.score - better.score > max(WORTH, APART * less) else better

    def _added(self, fit: Fit) -> Iterator[Fit]:
        """Yield the best fit with one more term.

        The first-order gain counts unexplained power as noise, so it cannot rank terms that act
        alike: all proposals are evaluated in full.
        """
        if len(fit.optional) < MOST:
            more = (*self.proposals(fit), *possible_changes(self.linear, fit))
            found = [self._with(fit.optional, t, fit) for t in more]
            yield from sorted(found, key=lambda one: -one.score)[:1]

    def proposals(
        self, fit: Fit, count: int = TRIED, instead: Replacements | None = None, needed: float = 0.0
    ) -> list[Term]:
        """Return the terms that would gain most beside a fit, one of each key.

        Gains at the noise of the present fit are too small: a term is tried where its gain reaches
        the share :data:`SHORT` of what is needed, or of what the replaced terms gain at that noise.
        """
        gained = [
            (gain, screen, t)
            for k, screen in enumerate(self.screens)
            for t, gain in enumerate(
                screen.gains(fit, None if instead is None else instead.among[k])
            )
        ]
        have = fit.keys | (frozenset() if instead is None else instead.excluded)
        replaced = have - fit.keys
        own: dict[Key, float] = {}
        for gain, screen, t in gained if replaced else ():
            key = screen.terms[t].key
            if key in replaced:
                own[key] = max(own.get(key, 0.0), gain)
        if own:
            needed = min(needed, sum(own.values()))
        found = list[Term]()
        for gain, screen, t in sorted(gained, key=lambda one: -one[0]):
            if len(found) == count or not gain >= SHORT * needed:
                break
            key = screen.terms[t].key
            if key not in have:
                found.append(screen.term(t))
                have = have | {key}
        return found

    def _instead(self, fit: Fit, *terms: Term) -> Replacements:
        """Return what could take the place of terms of a fit: what is related to all of them."""
        among: list[set[int]] = []
        for screen in self.screens:
            of_each = [screen.related(fit, t) for t in terms]
            among.append(set.intersection(*of_each))
        return Replacements(fit.keys, among)

    def _with(self, terms: Sequence[Term], more: Term, near: Fit) -> Fit:
        """Return the fit of a set with one more term, its numbers and its scale where they are most
        probable."""
        return self._scaled(self._placed(terms, more, near), more.key)

    def _scaled(self, fit: Fit, key: Key) -> Fit:
        """Return a fit with the size of a term on the scale on which it is most probable beside the
        others."""
        for t in (t for t in fit.optional if t.key == key and t.is_scaled):
            gains = [fit.gain_of_scale(t, scale) for scale in SCALES]
            if max(gains) > WORTH:
                other = t.scaled(float(SCALES[int(np.argmax(gains))]))
                return self._keep(
                    self.model.fit([other if u is t else u for u in fit.optional], fit)
                )
        return fit

    def _placed(self, terms: Sequence[Term], more: Term, near: Fit) -> Fit:
        """Return the fit of a set with one more term, its nonlinear numbers where they are most
        probable."""
        if not isinstance(more, EffectTerm) or not more.is_open:
            return self._keep(self.model.fit([*terms, more], near))
        key = (more.key, frozenset(t.ident for t in terms))
        if key not in self.refined:
            start = more
            theta = self.thetas.get(more.key)
            if theta is not None and more.feature.count == 1:
                # Near where it was most probable beside another set, or on the grid: its range was
                # scanned once.
                columns = self.linear.columns(more.feature, theta)
                there = replace(
                    more, columns=columns, theta=theta, grid=0.0, ident=(*more.ident, theta)
                )
                start = max(more, there, key=lambda t: self.model.fit([*terms, t], near).score)
            self.refined[key], fit = refined(
                self.linear, self.model, start, terms, near, scan=theta is None
            )
            if len(more.theta) == 1:
                self.thetas[more.key] = self.refined[key].theta
            return self._keep(fit)
        return self._keep(self.model.fit([*terms, self.refined[key]], near))

    def _keep(self, fit: Fit) -> Fit:
        if fit.keys in self.own_scores:
            fit = replace(fit, correction=fit.correction + self.own_scores[fit.keys] - fit.score)
        known = self.met.get(fit.keys)
        if known is None or fit.score > known.score:
            self.met[fit.keys] = fit
        return fit

    def _discard_improbable(self, best: Fit) -> None:
        """Discard sets that are next to impossible beside the best: each takes memory.

        The likeliest of those whose numbers are far from the linearisation stay: their scores are
        only guesses.
        """
        least = best.score - COMPARED
        far = [fit for fit in self.met.values() if fit.score <= least and self.is_far(fit)]
        far.sort(key=lambda fit: -fit.score)
        stay = {fit.keys for fit in (best, *far[:ELSEWHERE])}
        self.met = {
            keys: fit for keys, fit in self.met.items() if fit.score > least or keys in stay
        }

    def _rescaled(self, fit: Fit) -> Iterator[Fit]:
        """Yield fits with a size on the scale on which it is most probable beside the others."""
        for t in fit.optional:
            yield self._scaled(fit, t.key)
        if any(isinstance(t, LawTerm) for t in fit.optional):
            yield self._resized(fit)

    def _resized(self, fit: Fit) -> Fit:
        """Return a fit with each nonparametric law at the size that is most probable beside the
        others."""
        for t in [t for t in fit.optional if isinstance(t, LawTerm)]:
            gains = [fit.gain_of_size(t, float(size)) for size in SIZES]
            if max(gains) > WORTH:
                other = t.at_size(float(SIZES[int(np.argmax(gains))]))
                fit = self._keep(
                    self.model.fit([other if u is t else u for u in fit.optional], fit)
                )
        return fit

    def _dropped(self, fit: Fit) -> Iterator[Fit]:
        return (less for _, less in self._left_out(fit))

    def _exchanged(self, fit: Fit) -> Iterator[Fit]:
        for t, less in self._left_out(fit):
            own = [u for u in fit.optional if u.changes(t.key)]
            changes = bool(own)
            common = self._keep(self.model.fit(without(fit, *own), fit)) if changes else fit
            for u in self.proposals(
                less, instead=self._instead(fit, t), needed=common.score - less.score
            ):
                one = self._with(less.optional, u, less)
                yield one
                # What takes the place of a term that changes between recordings may change as well.
                for more in possible_changes(self.linear, one) if changes else ():
                    if more.changes(u.key):
                        yield self._with(one.optional, more, one)

    def _scanned(self, fit: Fit) -> Iterator[Fit]:
        """Yield fits with one nonlinear number looked for over all its range: it was found beside
        other terms."""
        for t, less in self._left_out(fit):
            key = (t.key, frozenset(u.ident for u in less.optional))
            if not isinstance(t, EffectTerm) or not t.is_open or len(t.theta) != 1:
                continue
            if key in self._looked:
                continue
            self._looked.add(key)
            self.refined[key], found = refined(
                self.linear, self.model, t, less.optional, less, scan=True
            )
            yield self._keep(found)

    def _two_for_one(self, fit: Fit) -> Iterator[Fit]:
        for pair in combinations(fit.optional, 2):
            if fit.correlation(*pair) < RELATED:
                continue
            less = self._without(fit, *pair)
            for t in self.proposals(
                less, TRIED_OF_TWO, self._instead(fit, *pair), fit.score - less.score
            ):
                yield self._with(less.optional, t, less)

    def _one_for_two(self, fit: Fit) -> Iterator[Fit]:
        for gone, less in self._left_out(fit):
            instead = self._instead(fit, gone)
            for t in self.proposals(less, TRIED_OF_TWO, instead):
                one = self._with(less.optional, t, less)
                for u in self.proposals(one, TRIED_OF_TWO, instead, fit.score - one.score):
                    yield self._with(one.optional, u, one)

    def _left_out(self, fit: Fit) -> list[tuple[Term, Fit]]:
        """Return each term of a fit, and the fit without it."""
        return [(t, self._keep(self._without(fit, t))) for t in fit.optional]

    def _without(self, fit: Fit, *terms: Term) -> Fit:
        """Return the fit of a set without some of its terms; the others are of the size that is
        most probable then."""
        less = self._keep(self.model.fit(without(fit, *terms), fit))
        for t in less.optional:
            less = self._scaled(less, t.key)
        return self._resized(less)


def without(fit: Fit, *terms: Term) -> list[Term]:
    """Return the terms of a fit without some and their changes between recordings."""
    keys = {t.key for t in terms}

    def stays(term: Term) -> bool:
        return term not in terms and not any(term.changes(key) for key in keys)

    return [term for term in fit.optional if stays(term)]


def possible_changes(linear: Linearisation, fit: Fit) -> Iterator[Term]:
    """Yield the changes of a fit's terms that are not in it."""
    if len(linear.problem.observed[FITTED]) < 2:
        return
    for term in fit.terms:
        if may_change(term) and change_key(term) not in fit.keys:
            yield change_of(linear, term)


def words_of(now: Fit, before: Fit) -> str:
    """Return which terms came and went."""
    came = now.keys - before.keys
    went = before.keys - now.keys
    words = [f"+{effect}/{joint}" for effect, joint, *_ in came]
    words += [f"-{effect}/{joint}" for effect, joint, *_ in went]
    return " ".join(words)
