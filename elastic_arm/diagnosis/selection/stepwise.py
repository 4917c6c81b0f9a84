"""Which effects the model lacks: a search over sets of causes, each judged on motion that its fit has not seen.

Forward by the best next cause, then every cause of the set against every other, then backward. Sensor faults and
parameter errors compete on equal terms with physics. What stops it is not significance, which with thousands of
coloured samples every term has, but what a cause is worth: a share of the gap, on held-out motion, counted in units of
what the best explanation so far leaves beyond noise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.refine import refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary

Array = NDArray[np.float64]
Key = tuple[str, str | None, tuple[object, ...]]

RESAMPLES = 2000
BEYOND = 1.2  # how far outside its plausible range a ratio may be found
PATIENCE = 30  # optimisations that one search may spend
ENOUGH = 12.0  # log-likelihood, over the misfit that is left, that another cause must gain
SHARE = 0.005  # of all the log-likelihood that there is to gain
MOST_CAUSES = 16
STARTS = 2  # single causes from which the search sets out
COMPLETE = 1.3  # mean square of the whitened remainder up to which next to nothing is left
SHORTLIST = 4  # candidates whose searched parameters are optimised before they are compared
CLOSE = 40.0  # log-likelihood (over the misfit) within which an alternative deserves an optimised comparison


@dataclass(frozen=True)
class Rival:
    """An explanation that could stand in a cause's place, and how likely it is beside it."""

    candidate: Candidate
    odds: float


@dataclass
class Hypothesis:
    """A set of causes with the coefficients that the identification data give.

    Parameters
    ----------
    selected
        The causes, those given by the user first.
    given
        How many of them the user gave.
    rivals
        Alternatives of each cause, by position in `selected`.
    """

    selected: list[Candidate]
    given: int = 0
    rivals: dict[int, list[Rival]] = field(default_factory=dict)


def misfit(library: RegressorLibrary, selected: Sequence[Candidate]) -> float:
    """Mean square of what is left, whitened, over both data sets: 1 for a complete explanation, more for others."""
    beta = library.fit(0, selected)
    left = sum(float(np.sum(library.remainder(which, selected, beta) ** 2)) for which in (0, 1))
    return max(1.0, left / sum(e.freedom for e in library.sets))


def plausible(library: RegressorLibrary, selected: Sequence[Candidate]) -> bool:
    """Whether every parameter has a sign that its effect can have (no friction that drives, no negative mass)."""
    beta = library.fit(0, selected)
    k = 0
    for candidate in selected:
        count = candidate.columns.stop - candidate.columns.start
        if not candidate.fixed and candidate.searched is not None and not _possible(candidate, beta[k : k + count]):
            return False
        k += count
    return True


def _possible(candidate: Candidate, beta: Array) -> bool:
    feature = candidate.feature
    if feature.fixed:
        return bool(beta[0] > 0)
    if feature.phase is not None:
        return True
    first = feature.linear[0]
    value = first.value_of(float(beta[0]))
    if first.neutral == 0.0 and first.low > 0.0:
        return value > 0.0
    if first.neutral:
        return first.low / BEYOND < value < first.high * BEYOND
    return value > first.above


class Search:
    """The search for causes in a library of columns."""

    def __init__(self, library: RegressorLibrary, given: Sequence[Candidate] = ()) -> None:
        self.library, self.given = library, list(given)
        self._candidates = [e for e in library.candidates if e not in self.given]
        # One of several values tried fits by chance better than a single one: that many times less is each worth.
        self._price = {key: np.log(count) for key, count in Counter(e.feature.key for e in library.candidates).items()}
        self._patience = PATIENCE
        self._refined: dict[tuple[Candidate, frozenset[Candidate]], Candidate] = {}
        total = 0.5 * sum(float(e.white @ e.white) - e.freedom for e in library.sets)
        self._least = SHARE * max(total, 0.0)

    def _score(self, selected: Sequence[Candidate]) -> float:
        """Held-out log-likelihood less what choosing among tried values is worth."""
        return self.library.held_out(selected) - sum(self._price[candidate.feature.key] for candidate in selected)

    def strongest(self) -> float:
        """Held-out log-likelihood that the best single cause gains, less what its tried values are worth."""
        given = self._score(self.given)
        return max((score for score, _ in self._ranked(self.given)), default=given) - given

    def run(self) -> Hypothesis:
        """Return the best explanation found."""
        given = self._optimised(self.given)
        # The best single cause may be a wrong one that does two right ones' work, so others may begin too.
        chosen = self._grown(given)
        for score, start in self._ranked(given)[1:STARTS]:
            if misfit(self.library, chosen) < COMPLETE or score < 0.3 * self._score(chosen):
                break
            chosen = max(chosen, self._grown(start), key=self._merit)
        explanation = Hypothesis(chosen, len(self.given))
        for k in range(len(self.given), len(chosen)):
            explanation.rivals[k] = self._rivals(chosen, k)
        return explanation

    def _merit(self, selected: Sequence[Candidate]) -> float:
        return self._score(selected) - ENOUGH * len(selected) * misfit(self.library, selected)

    def _grown(self, chosen: list[Candidate]) -> list[Candidate]:
        """Add causes one by one as long as each is worth it."""
        chosen = self._dropped(self._optimised(chosen))
        while len(chosen) - len(self.given) < MOST_CAUSES:
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
        return max(ENOUGH * scale, 0.0 if structural or scale < COMPLETE else self._least)

    def _open(self, selected: Sequence[Candidate]) -> list[Candidate]:
        taken = {e.feature.key for e in selected}
        return [e for e in self._candidates if e.feature.key not in taken]

    def _ranked(self, selected: Sequence[Candidate]) -> list[tuple[float, list[Candidate]]]:
        """Return `selected` with each other feature added at its best, best first.

        What was searched alone may have gone astray for want of the newcomer, so its other values are tried again.
        """
        others: dict[str | None, list[list[Candidate]]] = {}
        for k in range(len(self.given), len(selected)):
            same = [e for e in self._candidates if e.feature.key == selected[k].feature.key]
            if len(same) > 1:
                tried = [[*selected[:k], e, *selected[k + 1 :]] for e in same]
                others.setdefault(selected[k].feature.joint, []).extend(tried)
        best: dict[Key, tuple[float, list[Candidate]]] = {}
        for candidate in self._open(selected):
            key = candidate.feature.key
            for base in [list(selected), *others.get(candidate.feature.joint, [])]:
                trial = [*base, candidate]
                score = self._score(trial)
                if (key not in best or score > best[key][0]) and plausible(self.library, trial):
                    best[key] = (score, trial)
        return sorted(best.values(), key=lambda pair: -pair[0])

    def _best_next(self, chosen: Sequence[Candidate]) -> list[Candidate] | None:
        ranked = self._ranked(chosen)[:SHORTLIST]
        scored = []
        for score, trial in ranked:
            if score < 0.5 * ranked[0][0]:
                break
            better = self._optimised(trial)
            if plausible(self.library, better):
                scored.append((self._score(better), better))
        if not scored:
            return None
        score, best = max(scored, key=lambda pair: pair[0])
        gain = score - self._score(chosen)
        return best if gain > self._worth(best) else None

    def _refine(self, others: Sequence[Candidate], candidate: Candidate) -> Candidate:
        key = (candidate, frozenset(others))
        makeshift = candidate.searched is None or (candidate.feature.fixed and not candidate.fixed)
        if key not in self._refined and self._patience <= 0 and not makeshift:
            return candidate
        if key not in self._refined:
            self._patience -= 1
            self._refined[key] = refine(self.library, [*others, candidate], candidate)
        return self._refined[key]

    def _exchanged(self, selected: list[Candidate]) -> list[Candidate]:
        """Put another cause in the place of each as long as that explains more."""
        for _ in range(2):
            changed = False
            for k in range(len(self.given), len(selected)):
                others = selected[:k] + selected[k + 1 :]
                now = self._score(selected)
                for score, rough in self._ranked(others)[:SHORTLIST]:
                    if rough[-1].feature.key == selected[k].feature.key or score < 0.5 * now:
                        continue
                    trial = [*rough[:-1], self._refine(rough[:-1], rough[-1])]
                    if self._score(trial) > now + 3.0 and plausible(self.library, trial):
                        selected, changed = trial, True
                        break
            if not changed:
                break
        return selected

    def _optimised(self, selected: Sequence[Candidate]) -> list[Candidate]:
        """Optimise the searched parameters of all causes, one after another."""
        selected = list(selected)
        for k, candidate in enumerate(selected):
            better = self._refine([*selected[:k], *selected[k + 1 :]], candidate)
            trial = [*selected[:k], better, *selected[k + 1 :]]
            # Columns that span a neighbourhood, or were scaled while their size was searched, are no law.
            makeshift = candidate.searched is None or (candidate.feature.fixed and not candidate.fixed)
            if makeshift or (better is not candidate and self.library.both(trial) > self.library.both(selected)):
                selected = trial
        return selected

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

    def _rivals(self, chosen: Sequence[Candidate], k: int) -> list[Rival]:
        """Return what could stand in the place of cause k, with its odds against it."""
        others = [*chosen[:k], *chosen[k + 1 :]]
        scale = misfit(self.library, chosen)
        score = self._score(chosen)
        rivals: list[Rival] = []
        for rough, (*_, candidate) in self._ranked(others):
            if candidate.feature.key == chosen[k].feature.key:
                continue
            if (score - rough) / scale > 1e3 * CLOSE and len(rivals) >= 2:
                break
            better = self._refine(others, candidate) if (score - rough) / scale < 1e3 * CLOSE else candidate
            trial = [*others, better]
            if not plausible(self.library, trial):
                continue
            odds = self._odds(chosen, trial, scale)
            if odds > 1e-4:
                rivals.append(Rival(better, odds))
        return sorted(rivals, key=lambda rival: -rival.odds)

    def _odds(self, chosen: Sequence[Candidate], trial: Sequence[Candidate], scale: float) -> float:
        """Odds of a trial explanation: by likelihood over the misfit, or by how often blocks prefer it, if more."""
        behind = (self._score(chosen) - self._score(trial)) / scale
        blocks = np.concatenate(self.library.falls(trial, chosen))
        weights = np.random.default_rng(0).multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)), RESAMPLES)
        share = float(np.mean(weights @ blocks <= 0.0))
        return float(max(np.exp(-np.clip(behind, 0.0, 700.0)), min(1.0, share / max(1.0 - share, 0.5))))
