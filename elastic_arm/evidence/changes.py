"""A size of its own in each recording: what a term adds beside its common size, as a term like any
other."""

from collections.abc import Iterator

import numpy as np

from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import Fit
from elastic_arm.evidence.pool import linear_prior
from elastic_arm.evidence.problem import FITTED
from elastic_arm.evidence.term import Key, Term

CHANGE = "change"


def change_key(term: Term) -> Key:
    """Return the key of a term's change between recordings."""
    return CHANGE, term.key[1], (term.key[0], *term.key[2])


def change_of(linear: Linearisation, term: Term) -> Term:
    """Return what a term adds in each recording beside its common size: fitted ones first, then
    those that judge.

    Where a size is not the same in all recordings, it is another one in those that judge, too.
    """
    data, problem = linear.data, linear.problem
    count = len(problem.sources)
    numbered = problem.numbered(linear.which)
    recording = np.tile(
        data.of_stretches([numbered[part.recording] for part in data.parts]), data.layout.rows
    )
    own, own_std = term.columns[:, : term.linear], term.std[: term.linear]
    if bends(term):
        own = term.columns
        own_std, _, _ = linear_prior(
            term.feature.by_size, linear.problem.largest_at(term.feature.joint)
        )
    columns = np.hstack([np.where((recording == k)[:, None], own, 0.0) for k in range(count)])
    std = np.tile(own_std, count)
    fitted = len(problem.observed[FITTED])
    return Term(
        change_key(term),
        CHANGE,
        columns,
        std,
        what=term.key,
        fitted=fitted,
        ident=(*term.ident, CHANGE),
    )


def bends(term: Term) -> bool:
    """Whether a term is an effect whose sizes are among its nonlinear numbers, by steps of their
    unit."""
    if term.kind != "effect" or term.linear or not term.tangents:
        return False
    return term.feature.by_size.bends and not any(
        p.logarithmic for p in term.feature.effect.parameters
    )


def possible_changes(linear: Linearisation, fit: Fit) -> Iterator[Term]:
    """Yield the changes of a fit's terms that are not in it."""
    if len(linear.problem.observed[FITTED]) < 2:
        return
    for term in fit.terms:
        sized = (term.kind in ("effect", "number", "stated") and term.linear) or bends(term)
        if sized and change_key(term) not in fit.keys:
            yield change_of(linear, term)
