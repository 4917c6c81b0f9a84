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
# numbers of moves of a search, in their order
ADDED = 2  # add a term, change its scale
SIMPLE = 4  # also drop and exchange a term
ALL = 7


class Replacements(NamedTuple):
    """Candidates that may replace terms."""

    excluded: frozenset[Key]  # keys of the set
    among: list[set[int]]  # indices of terms, for each screen


@dataclass
class Search:
    """A search over sets of terms at one linearisation."""

    # linear, model, screens: the data and all candidates
    linear: Linearisation
    model: LinearModel
    screens: Sequence[Screen]
    # most probable values of single nonlinear numbers beside other sets, by the key of the term;
    # the search adds values
    thetas: Thetas = field(default_factory=dict)
    # scores of sets at their own linearisation
    own_scores: Mapping[frozenset[Key], float] = field(default_factory=dict)
    # terms at their most probable nonlinear numbers beside other terms, from earlier searches of
    # the same data under the same assumptions; the search adds terms
    refined: dict[tuple[Key, frozenset[Ident]], EffectTerm] = field(default_factory=dict)
    met: dict[frozenset[Key], Fit] = field(default_factory=dict)
    # sets beside which a range was scanned
    _looked: set[tuple[Key, frozenset[Ident]]] = field(default_factory=set)
    log: list[str] = field(default_factory=list)
    is_over: Callable[[], bool] = Watch().is_over
    is_far: Callable[[Fit], bool] = lambda fit: False
    # better and better sets, up to the most probable one
    path: list[Fit] = field(default_factory=list)

    def run(self, start: Sequence[Term] = (), *, moves: int = ALL, most: int = MOST) -> Fit:
        """Return the most probable set on the way from a first one; `path` keeps the way.

        moves: number of kinds of moves, :data:`ADDED`, :data:`SIMPLE` or :data:`ALL`; most: largest
        number of steps.
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
        """All moves, the fastest first: :data:`ADDED`, :data:`SIMPLE`, :data:`ALL`."""
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
        """Return a better set by one kind of moves; cheap ones, which add terms, come first."""
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
        """Return the better of two sets that improve a fit, or the set with both changes.

        Moves at different joints gain together as much as each alone. If they gain less, they are
        alternatives: the better one is taken, and the other one is proposed again later.
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

        The first-order gain counts unexplained power as noise, so it cannot rank similar terms: all
        proposals are evaluated in full.
        """
        if len(fit.optional) < MOST:
            more = (*self.proposals(fit), *possible_changes(self.linear, fit))
            found = [self._with(fit.optional, t, fit) for t in more]
            yield from sorted(found, key=lambda one: -one.score)[:1]

    def proposals(
        self, fit: Fit, count: int = TRIED, instead: Replacements | None = None, needed: float = 0.0
    ) -> list[Term]:
        """Return the terms with the largest gains beside a fit, one for each key.

        Gains at the noise of the present fit are too small: a term is proposed if its gain reaches
        the share :data:`SHORT` of the needed gain, or of the gain of the replaced terms at that
        noise.
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
        """Return the candidates that could replace terms of a fit: those related to all of them."""
        among: list[set[int]] = []
        for screen in self.screens:
            of_each = [screen.related(fit, t) for t in terms]
            among.append(set.intersection(*of_each))
        return Replacements(fit.keys, among)

    def _with(self, terms: Sequence[Term], more: Term, near: Fit) -> Fit:
        """Return the fit of a set with one more term at its most probable numbers and scale."""
        return self._scaled(self._placed(terms, more, near), more.key)

    def _scaled(self, fit: Fit, key: Key) -> Fit:
        """Return a fit with the most probable scale of a term's size beside the others."""
        for t in (t for t in fit.optional if t.key == key and t.is_scaled):
            gains = [fit.gain_of_scale(t, scale) for scale in SCALES]
            if max(gains) > WORTH:
                other = t.scaled(float(SCALES[int(np.argmax(gains))]))
                return self._keep(
                    self.model.fit([other if u is t else u for u in fit.optional], fit)
                )
        return fit

    def _placed(self, terms: Sequence[Term], more: Term, near: Fit) -> Fit:
        """Return the fit of a set with one more term at its most probable nonlinear numbers."""
        if not isinstance(more, EffectTerm) or not more.is_open:
            return self._keep(self.model.fit([*terms, more], near))
        key = (more.key, frozenset(t.ident for t in terms))
        if key not in self.refined:
            start = more
            theta = self.thetas.get(more.key)
            if theta is not None and more.feature.count == 1:
                # The range was scanned once: start at the grid, or at the value beside another set.
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
        """Discard sets that are almost impossible beside the best one, to save memory.

        The most probable sets with numbers far from the linearisation stay, because their scores
        are inaccurate.
        """
        least = best.score - COMPARED
        far = [fit for fit in self.met.values() if fit.score <= least and self.is_far(fit)]
        far.sort(key=lambda fit: -fit.score)
        stay = {fit.keys for fit in (best, *far[:ELSEWHERE])}
        self.met = {
            keys: fit for keys, fit in self.met.items() if fit.score > least or keys in stay
        }

    def _rescaled(self, fit: Fit) -> Iterator[Fit]:
        """Yield fits with the most probable scale of one size beside the others."""
        for t in fit.optional:
            yield self._scaled(fit, t.key)
        if any(isinstance(t, LawTerm) for t in fit.optional):
            yield self._resized(fit)

    def _resized(self, fit: Fit) -> Fit:
        """Return a fit with the most probable size of each nonparametric law beside the others."""
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
                # The replacement of a term that changes between recordings may change as well.
                for more in possible_changes(self.linear, one) if changes else ():
                    if more.changes(u.key):
                        yield self._with(one.optional, more, one)

    def _scanned(self, fit: Fit) -> Iterator[Fit]:
        """Yield fits with a nonlinear number from a scan of its whole range, because it was found
        beside other terms."""
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
        """Return each optional term of a fit, and the fit without it."""
        return [(t, self._keep(self._without(fit, t))) for t in fit.optional]

    def _without(self, fit: Fit, *terms: Term) -> Fit:
        """Return the fit of a set without some terms; nonparametric laws have their most probable
        sizes."""
        less = self._keep(self.model.fit(without(fit, *terms), fit))
        for t in less.optional:
            less = self._scaled(less, t.key)
        return self._resized(less)


def without(fit: Fit, *terms: Term) -> list[Term]:
    """Return the optional terms of a fit without some of them and their changes."""
    keys = {t.key for t in terms}

    def stays(term: Term) -> bool:
        return term not in terms and not any(term.changes(key) for key in keys)

    return [term for term in fit.optional if stays(term)]


def possible_changes(linear: Linearisation, fit: Fit) -> Iterator[Term]:
    """Yield the possible changes of a fit's terms between recordings that it lacks."""
    if len(linear.problem.observed[FITTED]) < 2:
        return
    for term in fit.terms:
        if may_change(term) and change_key(term) not in fit.keys:
            yield change_of(linear, term)


def words_of(now: Fit, before: Fit) -> str:
    """Return in words the added and removed terms."""
    came = now.keys - before.keys
    went = before.keys - now.keys
    words = [f"+{effect}/{joint}" for effect, joint, *_ in came]
    words += [f"-{effect}/{joint}" for effect, joint, *_ in went]
    return " ".join(words)
