"""A size of its own in each recording: what a term adds beside its common size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.evidence.keys import Key
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import CHANGED
from elastic_arm.evidence.problem import FITTED
from elastic_arm.evidence.terms.effect import EffectTerm, linear_prior
from elastic_arm.evidence.terms.known import StatedTerm
from elastic_arm.evidence.terms.term import Coefficients, Term

CHANGE = "change"


@dataclass(frozen=True, eq=False)
class ChangeTerm(Term):
    """The change of a term between recordings: the fitted ones first, then those that judge."""

    of: Key | None = None  # the term whose size changes
    fitted: int = 0  # number of fitted recordings

    kind = CHANGE
    says_cause = False

    def doubt(self, is_usual: bool) -> float:
        """Return -ln of the prior odds that a size changes, nats."""
        return -float(np.log(CHANGED))

    def changes(self, key: Key) -> bool:
        """Whether it is the change of the term of a key."""
        return self.of == key

    def is_of(self, term: Term) -> bool:
        """Whether it is the change of a term: not of how far a stated size is off."""
        return self.of == term.key and not isinstance(term, StatedTerm)

    def common(self, terms: Sequence[Term]) -> Term | None:
        """Return the term among some whose size changes; None where it is not there."""
        found = (t for t in terms if self.is_of(t))
        return next(found, None)

    def again(
        self, linear: Linearisation, fit: Coefficients, others: Sequence[Term]
    ) -> Sequence[Term]:
        """Return it at another linearisation, beside the term whose size changes."""
        common = self.common(others)
        return [] if common is None else [change_of(linear, common)]

    def added(self, linear: Linearisation, fit: Coefficients, along: Array) -> list[Array]:
        """Return what it adds to the residuals (N', R) of each stretch, Nm.

        Nothing in recordings that judge, but where they are parts of the fitted ones.
        """
        common = self.common(fit.terms)
        assert common is not None
        if isinstance(common, EffectTerm) and common.bends:
            columns = linear.data.plain(common.feature.by_size)
        else:
            columns = common.plain(linear, fit, along)
        each = fit.raw(self).reshape(-1, columns[0].shape[2])
        each = each - each[: self.fitted].mean(axis=0)
        each = each * (linear.problem.held_back or linear.which == FITTED)
        parts = zip(columns, linear.data.parts, strict=True)
        return [X @ each[part.recording] for X, part in parts]


def change_key(term: Term) -> Key:
    """Return the key of a term's change between recordings."""
    return CHANGE, term.key[1], (term.key[0], *term.key[2])


def may_change(term: Term) -> bool:
    """Whether a term has a size that may differ between recordings."""
    if not term.says_cause or isinstance(term, StatedTerm):
        return False
    return term.linear > 0 or (isinstance(term, EffectTerm) and term.bends)


def change_of(linear: Linearisation, term: Term) -> ChangeTerm:
    """Return what a term adds in each recording beside its common size.

    Where a size is not the same in all recordings, it is another one in those that judge, too.
    """
    data = linear.data
    problem = linear.problem
    count = len(problem.sources)
    numbered = problem.numbered(linear.which)
    of_stretches = data.of_stretches([numbered[part.recording] for part in data.parts])
    recording = np.tile(of_stretches, data.layout.rows)
    if isinstance(term, EffectTerm) and term.bends:
        own = term.columns
        largest = problem.largest_at(term.feature.joint)
        own_std, _, _ = linear_prior(term.feature.by_size, largest)
    else:
        own = term.columns[:, : term.linear]
        own_std = term.std[: term.linear]
    columns = np.hstack([np.where((recording == k)[:, None], own, 0.0) for k in range(count)])
    return ChangeTerm(
        change_key(term),
        columns,
        np.tile(own_std, count),
        of=term.key,
        fitted=len(problem.observed[FITTED]),
        ident=(*term.ident, CHANGE),
    )
