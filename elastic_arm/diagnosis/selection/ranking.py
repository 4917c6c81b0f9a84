"""What gains most beside a set of candidates: each further one, and other values of one of the set beside it.

All choices are fitted together, and kept as numbers: a search looks at few of them, and comes back to the same sets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.selection.gram_fits import FurtherColumns
from elastic_arm.diagnosis.selection.hypothesis import Key, best_first, tie_of
from elastic_arm.diagnosis.selection.plausible_hypothesis import coefficient_bounds
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

KEPT = 300  # rankings; bounds the memory to some tens of megabytes
NONE = -1  # in the place of a number


@dataclass(frozen=True, eq=False)
class Ranking:
    """Choices beside a set of candidates, best first and equal ones in the order of the candidates.

    Parameters
    ----------
    scores
        (M,) held-out log-likelihood less what choosing among tried values is worth.
    replaced, values
        (M,) position in the set of what takes another value, and the number of the candidate with that value; none
        where nothing does.
    further
        (M,) number of the further candidate.
    impossible
        (M,) whether a coefficient of the set is certainly none that its effect can have.
    """

    scores: Array
    replaced: Numbers
    values: Numbers
    further: Numbers
    impossible: NDArray[np.bool_]


class Rankings:
    """Rankings of sets of candidates of a library.

    Parameters
    ----------
    library
        Of all columns.
    candidates
        What may be added.
    prices
        What choosing among the tried values of a feature is worth, by its key, nats.
    given
        How many candidates of every set keep their values.
    ratio_factor
        How far outside its plausible range a ratio may be.
    """

    def __init__(
        self,
        library: RegressorLibrary,
        candidates: Sequence[Candidate],
        prices: Mapping[Key, float],
        given: int,
        ratio_factor: float,
    ) -> None:
        self._library, self._candidates, self._prices = library, candidates, prices
        self._given, self._ratio_factor = given, ratio_factor
        self._numbers = {key: number for number, key in enumerate(dict.fromkeys(c.feature.key for c in candidates))}
        self._features = np.array([self._numbers[c.feature.key] for c in candidates], dtype=int)
        joints = {joint: number for number, joint in enumerate(dict.fromkeys(c.feature.joint for c in candidates))}
        self._joint_numbers, self._joints = joints, np.array([joints[c.feature.joint] for c in candidates], dtype=int)
        self._paid = np.array([prices[c.feature.key] for c in candidates])
        self._starts = np.array([c.columns.start for c in candidates], dtype=int)
        self._widths = np.array([len(c.index) for c in candidates], dtype=int)
        self._fixed = np.array([c.fixed for c in candidates], dtype=bool)
        self._kinds = 2 * self._widths + self._fixed
        # By column of the library.
        self._bounds = np.full((2, library.count), np.nan)
        for candidate in candidates:
            self._bounds[:, candidate.columns] = coefficient_bounds([candidate], ratio_factor)
        self._kept: dict[tuple[Candidate, ...], Ranking] = {}
        self._tie = tie_of(library)

    def trials(self, selected: tuple[Candidate, ...], *, possible: bool) -> Iterator[tuple[float, list[Candidate]]]:
        """Yield score and the set with a further candidate, which comes last, best first.

        Parameters
        ----------
        selected
            The set of candidates.
        possible
            Whether to leave out what is certainly impossible.
        """
        if selected not in self._kept:
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[selected] = self._ranking(selected)
        ranking = self._kept[selected]
        for i in np.flatnonzero(~ranking.impossible) if possible else range(len(ranking.scores)):
            trial = list(selected)
            if ranking.replaced[i] != NONE:
                trial[ranking.replaced[i]] = self._candidates[ranking.values[i]]
            yield float(ranking.scores[i]), [*trial, self._candidates[ranking.further[i]]]

    def _ranking(self, selected: tuple[Candidate, ...]) -> Ranking:
        own = [self._numbers.get(c.feature.key, NONE) for c in selected]
        free = np.flatnonzero(~np.isin(self._features, own))
        blocks, fits = [(NONE, free[:, None])], [self._fits(selected, free[:, None])]
        for k in range(self._given, len(selected)):
            same = np.flatnonzero(self._features == own[k])
            beside = free[self._joints[free] == self._joint_numbers.get(selected[k].feature.joint, NONE)]
            if len(same) > 1 and len(beside):
                pairs = np.stack([np.repeat(same, len(beside)), np.tile(beside, len(same))], axis=1)
                blocks.append((k, pairs))
                fits.append(self._fits((*selected[:k], *selected[k + 1 :]), pairs))
        scores = np.concatenate([score for score, _ in fits])
        order = best_first(scores, self._tie)
        replaced = np.concatenate([np.full(len(choices), k) for k, choices in blocks])
        values = np.concatenate([choices[:, 0] for _, choices in blocks])
        further = np.concatenate([choices[:, -1] for _, choices in blocks])
        impossible = np.concatenate([ruled_out for _, ruled_out in fits])
        return Ranking(scores[order], replaced[order], values[order], further[order], impossible[order])

    def _fits(self, base: Sequence[Candidate], choices: Numbers) -> tuple[Array, NDArray[np.bool_]]:
        """Return scores (M,) of a set with each of the choices (M, m), and whether they are certainly impossible."""
        kinds = self._kinds[choices] @ (self._kinds.max(initial=0) + 1) ** np.arange(choices.shape[1])
        groups = []
        for kind in np.unique(kinds):
            members = np.flatnonzero(kinds == kind)
            starts, first = self._starts[choices[members]], choices[members[0]]
            widths = self._widths[first]
            columns = np.hstack([start[:, None] + np.arange(m) for start, m in zip(starts.T, widths, strict=True)])
            fixed = np.repeat(self._fixed[first], widths)
            groups.append(FurtherColumns(members, columns, fixed, self._bounds[:, columns]))
        own = coefficient_bounds(base, self._ratio_factor)
        # Known effects may be nothing on this arm: whether they are is asked of the few sets that are looked at.
        free = sum(len(candidate.index) for candidate in base[: self._given])
        own[:, :free] = np.array([[-np.inf], [np.inf]])
        scores, ruled_out = self._library.held_out_each(base, own, groups)
        paid = sum(self._prices[candidate.feature.key] for candidate in base)
        return scores - paid - self._paid[choices].sum(axis=1), ruled_out
