"""Which effects the model lacks: a search over sets of causes, each judged on motion that its fit has not seen.

Forward by the best next cause, then every cause of the set against every other, then backward. Sensor faults and
parameter errors compete on equal terms with physics. What stops it is not significance, which with thousands of
coloured samples every term has, but the gain of a cause in log-likelihood on held-out motion, in units of the misfit
that the best hypothesis so far leaves.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations, islice, product

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.bootstrap import block_counts
from elastic_arm.diagnosis.selection.hypothesis import (
    Hypothesis,
    Key,
    Rival,
    Rivals,
    best_first,
    first_best,
    misfit,
    tie_of,
)
from elastic_arm.diagnosis.selection.plausible_hypothesis import plausible
from elastic_arm.diagnosis.selection.plausible_size import PlausibleSizes
from elastic_arm.diagnosis.selection.ranking import Rankings
from elastic_arm.diagnosis.selection.refine import is_provisional, refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings

Array = NDArray[np.float64]

SAME_LAW = 0.9999  # cosine of two columns: from here on they are one law, 1 % apart in shape


def _confused(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates are one effect, or effects that their files name as easily confused, on the same joint."""
    first, second = one.feature.effect, other.feature.effect
    named = {c.effect for c in first.confusions} | {first.id}, {c.effect for c in second.confusions} | {second.id}
    return one.feature.joint == other.feature.joint and (second.id in named[0] or first.id in named[1])


class StepwiseSearch:
    """Stepwise selection of candidates: forward, exchange, backward (Efroymson 1960), judged on held-out motion.

    Parameters
    ----------
    library
        Of all columns.
    given
        Candidates that count as part of the model.
    settings
        Thresholds of the search and of the refinement.
    sizes
        The largest plausible sizes of effects; any size is allowed where they are not known.
    """

    def __init__(
        self,
        library: RegressorLibrary,
        given: Sequence[Candidate],
        settings: DiagnosisSettings,
        sizes: PlausibleSizes | None = None,
    ) -> None:
        self.library, self.given = library, list(given)
        self._settings, self._search = settings, settings.search
        self._refinements_left = settings.search.refinements
        self._refined: dict[tuple[Candidate, frozenset[Candidate]], Candidate] = {}
        self._possible: dict[tuple[Candidate, ...], bool] = {}
        self._sizes, self._tie = sizes, tie_of(library)
        self._freedom = sum(e.freedom for e in library.sets)

    @cached_property
    def _competing(self) -> tuple[Candidate, ...]:
        """All that competes where the search begins: what is added later does not."""
        return tuple(self.library.candidates)

    @cached_property
    def _candidates(self) -> list[Candidate]:
        return [e for e in self._competing if e not in self.given]

    @cached_property
    def _price(self) -> dict[Key, float]:
        """What choosing among values is worth: one of several tried fits by chance better than a single one."""
        counts = Counter(e.feature.key for e in self._competing)
        return {key: float(np.log(count)) for key, count in counts.items()}

    @cached_property
    def _rankings(self) -> Rankings:
        return Rankings(self.library, self._candidates, self._price, len(self.given), self._search.ratio_factor)

    def _score(self, selected: Sequence[Candidate]) -> float:
        """Held-out log-likelihood less what choosing among tried values is worth."""
        return self.library.held_out(selected) - sum(self._price[candidate.feature.key] for candidate in selected)

    def _gained(self, score: float) -> float:
        """Return what a score is above that of no effect, or of known ones that predict the other recording worse."""
        return score - min(0.0, self._score(self.given))

    def _plausible(self, selected: Sequence[Candidate]) -> bool:
        key = tuple(selected)
        if key not in self._possible:
            self._possible[key] = plausible(self.library, selected, self._search, self._sizes, self.given)
        return self._possible[key]

    def strongest(self) -> float:
        """Held-out log-likelihood that the best single cause gains, less what its tried values are worth."""
        given = self._score(self.given)
        best, _ = next(self._ranked(self.given), (given, []))
        return best - given

    def run(self) -> Hypothesis:
        """Return the best hypothesis found, with rivals."""
        return self.with_rivals(self.best())

    def best(self) -> Hypothesis:
        """Return the best hypothesis found, without rivals."""
        given = self._optimised(self.given)
        # The best single cause may be a wrong one that does two right ones' work, so others may begin too.
        chosen = self._grown(given)
        for score, start in islice(self._ranked(given), 1, self._search.starts):
            far = self._gained(score) < self._search.start_ratio * self._gained(self._score(chosen))
            if far or misfit(self.library, chosen) < self._search.complete:
                break
            chosen = first_best((chosen, self._grown(start)), self._merit, self._tie)
        return Hypothesis(tuple(chosen), len(self.given))

    def largest_cause(self) -> Hypothesis:
        """Return the known effects and the single cause that explains most, be it plausible or not.

        Columns hold for small changes: beside a payload as heavy as the arm, friction and gains go astray in them.
        """
        trials = self._rankings.trials(tuple(self.given), possible=False)
        selected = next((trial for _, trial in trials), self.given)
        if len(selected) > len(self.given):
            selected = [*selected[:-1], refine(self.library, selected, selected[-1], self._settings.refinement)]
        return Hypothesis(tuple(selected), len(self.given))

    def with_rivals(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return a hypothesis with what could stand in the place of each of its causes."""
        return replace(hypothesis, rivals={k: self._rivals(hypothesis.selected, k) for k in hypothesis.causes})

    def _merit(self, selected: Sequence[Candidate]) -> float:
        return self._score(selected) - self._search.least_gain * len(selected) * misfit(self.library, selected)

    def _grown(self, chosen: list[Candidate]) -> list[Candidate]:
        """Add causes one by one as long as each is worth it."""
        chosen = self._dropped(self._optimised(chosen))
        while len(chosen) - len(self.given) < self._search.most_causes:
            best = self._best_next(chosen)
            if best is None:
                break
            longer = self._dropped(self._optimised(self._exchanged(best)))
            if self._score(longer) <= self._score(chosen) + self._worth(longer):
                break
            chosen = longer
        return chosen

    def _worth(self, selected: Sequence[Candidate]) -> float:
        """Log-likelihood that one more cause has to bring.

        With next to nothing left it cannot serve as a fitting basis for what another effect has done: any part counts.
        """
        scale = misfit(self.library, selected)
        structural = any(not e.feature.effect.parameters for e in selected)
        any_part = structural or scale < self._search.complete
        # Of what is left by now: beside a large effect, a smaller one may still be all there is at its joint.
        left = 0.5 * (scale - 1.0) * self._freedom
        return max(self._search.least_gain * scale, 0.0 if any_part else self._search.least_share * left)

    def _ranked(self, selected: Sequence[Candidate]) -> Iterator[tuple[float, list[Candidate]]]:
        """Yield `selected` with each other feature added at its best, best first.

        What was searched alone may have gone astray for want of the newcomer, so its other values are tried again.
        Whether sizes are plausible takes a fit of each set, and few of them are looked at: one after another.
        """
        done: set[Key] = set()
        for score, trial in self._rankings.trials(tuple(selected), possible=True):
            key = trial[-1].feature.key
            if key not in done and self._plausible(trial):
                done.add(key)
                yield score, trial

    def _best_next(self, chosen: Sequence[Candidate]) -> list[Candidate] | None:
        first, scored = None, []
        for score, trial in islice(self._ranked(chosen), self._search.shortlist):
            if first is not None and self._gained(score) < self._search.shortlist_ratio * self._gained(first):
                break
            first = score if first is None else first
            better = self._optimised(trial)
            # A wrong cause beside a right one may only fit best at a size that none has; an exchange then removes it.
            better = better if self._plausible(better) else trial
            scored.append((self._score(better), better))
        if not scored:
            return None
        score, best = first_best(scored, lambda pair: pair[0], self._tie)
        return best if score - self._score(chosen) > self._worth(best) else None

    def _refine(self, others: Sequence[Candidate], candidate: Candidate) -> Candidate:
        key = (candidate, frozenset(others))
        if key not in self._refined and self._refinements_left <= 0 and not is_provisional(candidate):
            return candidate
        if key not in self._refined:
            self._refinements_left -= 1
            selected, settings = [*others, candidate], self._settings.refinement
            self._refined[key] = refine(self.library, selected, candidate, settings, self._plausible)
        return self._refined[key]

    def _exchanged(self, selected: list[Candidate]) -> list[Candidate]:
        """Put another cause in the place of each as long as that explains more."""
        for _ in range(self._search.exchange_passes):
            changed = False
            for k in range(len(self.given), len(selected)):
                others = selected[:k] + selected[k + 1 :]
                now = self._score(selected)
                for score, rough in islice(self._ranked(others), self._search.shortlist):
                    if self._gained(score) < self._search.shortlist_ratio * self._gained(now):
                        break
                    if rough[-1].feature.key == selected[k].feature.key:
                        continue
                    trial = [*rough[:-1], self._refine(rough[:-1], rough[-1])]
                    if self._score(trial) > now + self._search.exchange_gain and self._plausible(trial):
                        selected, changed = trial, True
                        break
            if not changed:
                break
        return selected

    def simplified(self, hypothesis: Hypothesis) -> Hypothesis:
        """Put a simpler effect in the place of each that is known to be confused with it and explains hardly more.

        Of two of a joint, as friction that bends twice for dry and viscous friction, neither need be worth it alone.
        Where next to nothing is left, any difference counts, and the likelihood has decided.
        """
        if misfit(self.library, hypothesis.selected) < self._search.complete:
            return hypothesis
        selected = list(hypothesis.selected)
        for k in hypothesis.causes:
            others = [*selected[:k], *selected[k + 1 :]]
            now = self._score(selected)
            worth = max(
                self._search.exchange_gain * misfit(self.library, selected),
                self._search.simpler_share * (now - self._score(others)),
            )
            for score, rough in self._ranked(others):
                if score < now - worth:
                    break
                if rough[-1].numbers < selected[k].numbers and _confused(rough[-1], selected[k]):
                    selected = self._settled([*rough[:k], rough[-1], *rough[k:-1]])
                    break
        for k, m in combinations(hypothesis.causes, 2):
            selected = self._simpler_pair(selected, k, m)
        changed = [k for k in hypothesis.causes if selected[k] is not hypothesis.selected[k]]
        rivals = {**hypothesis.rivals, **{k: self._rivals(selected, k) for k in changed}}
        return replace(hypothesis, selected=selected, rivals=rivals)

    def _simpler_pair(self, selected: list[Candidate], k: int, m: int) -> list[Candidate]:
        """Return a set with simpler effects in the place of two of one joint, where these explain hardly more."""
        if selected[k].feature.joint is None or selected[k].feature.joint != selected[m].feature.joint:
            return selected
        without = [candidate for place, candidate in enumerate(selected) if place not in (k, m)]
        pairs = product(*(self._simpler(selected[place]) for place in (k, m)))
        trials = [
            [pair[0] if c is selected[k] else pair[1] if c is selected[m] else c for c in selected] for pair in pairs
        ]
        trials = [trial for trial in trials if len({c.feature.key for c in trial}) == len(trial)]
        if not trials:
            return selected
        best, now = first_best(trials, self._score, self._tie), self._score(selected)
        worth = self._search.simpler_share * (now - self._score(without))
        near = self._score(best) > now - max(self._search.exchange_gain * misfit(self.library, selected), worth)
        return best if near and self._plausible(best) else selected

    def _simpler(self, candidate: Candidate) -> list[Candidate]:
        """Return the effects of fewer numbers at the joint of an effect with which it is known to be confused."""
        own = (c for c in self._candidates if c.searched is not None and c.feature.joint == candidate.feature.joint)
        return [other for other in own if other.numbers < candidate.numbers and _confused(other, candidate)]

    def replaced(self, hypothesis: Hypothesis, k: int, refused: Collection[Key]) -> Hypothesis | None:
        """Return it with an effect that is known to be confused with cause k in its place; None where none is worth it.

        Parameters
        ----------
        hypothesis, k
            That holds the cause, and its position.
        refused
            Keys of effects that are not to be taken.
        """
        others, without = hypothesis.without(k), self._score(hypothesis.without(k))
        for score, (*_, other) in self._ranked(others):
            if score - without <= self._worth([*others, other]):
                break
            if other.feature.key not in refused and _confused(other, hypothesis.selected[k]):
                chosen = [*others[:k], self._refine(others, other), *others[k:]]
                rivals = self._rivals(chosen, k, frozenset(refused))
                return replace(hypothesis, selected=chosen, rivals={**hypothesis.rivals, k: rivals})
        return None

    def _optimised(self, selected: Sequence[Candidate]) -> list[Candidate]:
        """Optimise the searched parameters of all causes, one after another."""
        selected = list(selected)
        for k, candidate in enumerate(selected):
            better = self._refine([*selected[:k], *selected[k + 1 :]], candidate)
            trial = [*selected[:k], better, *selected[k + 1 :]]
            gains = is_provisional(candidate) or self.library.both(trial) > self.library.both(selected) + self._tie
            if better is not candidate and gains:
                selected = trial
        return selected

    def _settled(self, selected: Sequence[Candidate]) -> list[Candidate]:
        """Return a set in which every candidate has values: a ranking puts neighbourhoods in the place of others."""
        settled = list(selected)
        for k, candidate in enumerate(settled):
            if candidate.searched is None:
                settled[k] = self._refine([*settled[:k], *settled[k + 1 :]], candidate)
        return settled

    def _dropped(self, selected: list[Candidate]) -> list[Candidate]:
        """Leave out causes that the others have made superfluous."""
        k = len(self.given)
        while k < len(selected):
            without = selected[:k] + selected[k + 1 :]
            if self._score(selected) - self._score(without) < self._worth(selected):
                selected = without
                k = len(self.given)
            else:
                k += 1
        return selected

    def _rivals(self, chosen: Sequence[Candidate], k: int, refused: Collection[Key] = ()) -> Rivals:
        """Return what could stand in the place of cause k, but for effects that are refused by their keys."""
        found = tuple(chosen)
        return Rivals(lambda: [r for r in self._compared(found, k) if r.candidate.feature.key not in refused])

    def _compared(self, chosen: Sequence[Candidate], k: int) -> list[Rival]:
        """Return what could stand in the place of cause k, with its odds against it."""
        others = [*chosen[:k], *chosen[k + 1 :]]
        scale = misfit(self.library, chosen)
        score, furthest = self._score(chosen), self._search.rival_slack * self._search.rivals_compared
        rivals: list[Rival] = []
        for rough, (*_, candidate) in self._ranked(others):
            if candidate.feature.key == chosen[k].feature.key:
                continue
            behind = (score - rough) / scale
            if behind > furthest and len(rivals) >= self._search.fewest_rivals:
                break
            valued = candidate.searched is not None
            better = candidate if valued and behind >= furthest else self._refine(others, candidate)
            trial = [*others, better]
            if not self._plausible(trial) or self._is_same_law(better, chosen[k]):
                continue
            odds = self._odds(self._with_foreign(chosen, k, better, scale), trial, scale)
            if odds > self._search.least_odds:
                rivals.append(Rival(better, odds))
        return [rivals[i] for i in best_first(np.array([rival.odds for rival in rivals]), self._tie / scale)]

    def _with_foreign(self, chosen: Sequence[Candidate], k: int, rival: Candidate, scale: float) -> list[Candidate]:
        """Return the set that a rival of cause k has to match: with the rival beside it where another joint lacks that.

        What gains as much beside the cause as in its place does another joint's work and is no alternative to it.
        """
        beside = [*chosen, rival]
        if rival.feature.joint in (None, chosen[k].feature.joint) or chosen[k].feature.joint is None:
            return list(chosen)
        worth = self._search.least_gain * scale
        return beside if self._score(beside) - worth > self._score(chosen) else list(chosen)

    def _is_same_law(self, rival: Candidate, cause: Candidate) -> bool:
        """Whether a rival of more numbers is at its best the cause itself, as friction that bends at no speed reached.

        It then is no other explanation, and the simpler one stands for both.
        """
        if rival.numbers <= cause.numbers or not _confused(rival, cause):
            return False
        one, other = (self.library.matrix(0, candidate.index) for candidate in (rival, cause))
        if one.shape[1] != 1 or other.shape[1] != 1:
            return False
        size = float(np.linalg.norm(one) * np.linalg.norm(other))
        return size > 0.0 and abs(float(one[:, 0] @ other[:, 0])) > SAME_LAW * size

    @cached_property
    def _resamples(self) -> Array:
        """How often (draws, blocks) each block of both data sets is drawn: the same for all hypotheses."""
        resampling = self._settings.resampling
        blocks = sum(int(data.blocks.max()) + 1 for data in self.library.sets)
        return block_counts(blocks, resampling.odds_draws, resampling.odds_seed).astype(float)

    def _odds(self, chosen: Sequence[Candidate], trial: Sequence[Candidate], scale: float) -> float:
        """Odds of a trial hypothesis: by likelihood over the misfit, or by how often blocks prefer it, if more."""
        behind = (self._score(chosen) - self._score(trial)) / scale
        blocks = np.concatenate(self.library.falls(trial, chosen))
        share = float(np.mean(self._resamples @ blocks <= 0.0))
        return float(max(np.exp(-np.clip(behind, 0.0, 700.0)), min(1.0, share / max(1.0 - share, 0.5))))
