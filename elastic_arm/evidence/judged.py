"""Sets judged by all recordings, of which a part is fitted: the noise of a place and octave is the same in all.

    ln p(y, y', S) = ln p(S) + evidence of the rows y of those that are fitted and y' of those that judge

A law that bends to the fitted recordings alone is contradicted by the others. Sizes stay those of the fitted ones.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.evidence.changes import CHANGE, change_of
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import Fit, LinearModel
from elastic_arm.evidence.nonlinear import tangent_term
from elastic_arm.evidence.pool import relaxed_columns
from elastic_arm.evidence.priors import NEAR
from elastic_arm.evidence.search import Search, without
from elastic_arm.evidence.term import Ident, Term


class Judge:
    """All recordings at the linearisation of those that are fitted."""

    def __init__(self, search: Search, judging: Linearisation, always: Sequence[Term]) -> None:
        """Join both parts; always: known terms of the recordings that judge."""
        self.search, self.judging = search, judging
        own, first = search.model, search.linear
        self._terms: dict[Ident, Term] = {}
        self.model: LinearModel = replace(
            own,
            y=np.concatenate([own.y, judging.data.white]),
            N=np.concatenate([own.N, judging.numbers]),
            bands=Bands(first.data, judging.data),
            always=tuple(_joined(t, u.columns, u.offset) for t, u in zip(own.always, always, strict=True)),
            shares=tuple(self._shares()),
        )

    def settled(self, best: Fit) -> Fit:
        """Score the sets that are nearly as probable as the best one, drop from it what all recordings contradict.

        Return the most probable set. Sets that are not scored keep what they are behind the best one.
        """
        met = self.search.met
        here = (fit for fit in met.values() if fit.score > best.score - NEAR and fit.model.grams is best.model.grams)
        scored = {fit.keys: self._scored(fit) for fit in here}
        first = scored.setdefault(best.keys, self._scored(best))
        self.search.met.update(
            {keys: replace(fit, correction=fit.correction + first.score - best.score) for keys, fit in met.items()}
        )
        now = first
        while now.optional:
            less = max(
                (self._scored(self.search.model.fit(without(now, t), now)) for t in now.optional),
                key=lambda fit: fit.score,
            )
            if less.score <= now.score:
                break
            now = scored[less.keys] = less
        met.update(scored)
        return max(met.values(), key=lambda fit: fit.score)

    def whole(self, fit: Fit) -> Fit:
        """Return the fit of the same set to all recordings."""
        return self.model.fit([self._of_all(t, fit) for t in fit.optional])

    def _scored(self, fit: Fit) -> Fit:
        return replace(fit, correction=fit.correction + self.whole(fit).found.evidence - fit.found.evidence)

    def _of_all(self, term: Term, fit: Fit) -> Term:
        """Return a term with its rows in the recordings that judge as well."""
        if term.ident not in self._terms:
            self._terms[term.ident] = _joined(term, *self._judging(term, fit))
        return self._terms[term.ident]

    def _judging(self, term: Term, fit: Fit) -> tuple[Array, Array | None]:
        """Return columns (rows, k) and offset (rows,) of a term in the recordings that judge."""
        linear = self.judging
        if term.kind == "number":
            return linear.numbers @ term.what, None
        if term.kind == "law":
            return linear.data.whiten(term.what.plain(linear.data)), None
        if term.kind == CHANGE:
            common = next(t for t in fit.terms if t.key == term.what and t.kind != "stated")
            columns, offset = self._judging(common, fit)
            if linear.problem.held_back:
                return change_of(linear, replace(common, columns=columns, offset=offset)).columns, None
            return np.zeros((len(columns), term.count)), None  # as large as the mean of those that are fitted
        if np.isnan(term.theta).any():
            return relaxed_columns(linear.columns, term.feature), None
        if term.tangents:
            there = tangent_term(linear, term, term.theta, term.size)
            return there.columns, there.offset
        X = linear.columns(term.feature, term.theta)
        return X[:, : term.count], None if term.offset is None else X.sum(axis=1)

    def _shares(self) -> Sequence[Term]:
        """Return what effects that act add to the columns of numbers, in all recordings."""
        rows, found = (len(self.search.model.y), len(self.judging.data.white)), []
        parts = self.search.model.shares, self.judging.shares
        for key in dict.fromkeys(share.key for part in parts for share in part):
            own = [next((share for share in part if share.key == key), None) for part in parts]
            which = sorted({k for share in own if share is not None for k in share.what})
            columns = [np.zeros((n, len(which))) for n in rows]
            for X, share in zip(columns, own, strict=True):
                if share is not None:
                    X[:, [which.index(k) for k in share.what]] = share.columns
            found.append(Term(key, "share", np.concatenate(columns), np.zeros(len(which)), what=which))
        return found


def _joined(term: Term, columns: Array, offset: Array | None) -> Term:
    """Return a term with further rows."""
    offset = None if term.offset is None or offset is None else np.concatenate([term.offset, offset])
    return replace(term, columns=np.concatenate([term.columns, columns]), offset=offset)
