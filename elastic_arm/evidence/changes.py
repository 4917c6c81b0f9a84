"""A size of its own in each recording: what a term adds beside its common size, as a term like any other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import Fit
from elastic_arm.evidence.term import Key, Term

CHANGE = "change"


def change_key(term: Term) -> Key:
    """Return the key of a term's change between recordings."""
    return CHANGE, term.key[1], (term.key[0], *term.key[2])


def change_of(linear: Linearisation, term: Term) -> Term:
    """Return what a term adds in each recording beside its common size."""
    data, count = linear.data, len(linear.problem.observed[linear.which])
    recording = data.of_stretches([part.recording for part in data.parts])
    columns = np.hstack(
        [np.where((recording == k)[:, None], term.columns[:, : term.linear], 0.0) for k in range(count)]
    )
    std = np.tile(term.std[: term.linear], count)
    return Term(change_key(term), CHANGE, columns, std, what=term.key, ident=(*term.ident, CHANGE))


def possible_changes(linear: Linearisation, fit: Fit) -> Iterator[Term]:
    """Yield the changes of a fit's terms that are not in it."""
    if len(linear.problem.observed[linear.which]) < 2:
        return
    for term in fit.terms:
        if term.kind in ("effect", "number", "stated") and term.linear and change_key(term) not in fit.keys:
            yield change_of(linear, term)
