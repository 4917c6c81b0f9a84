"""What differs between recordings of one arm: a size common to all, or one of each, two sets like any others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.estimates import estimated
from elastic_arm.diagnosis.result import Change
from elastic_arm.evidence.priors import CHANGED
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.relinearise import Explanation
from elastic_arm.evidence.term import Term


def changes_between(explanation: Explanation, problem: Problem) -> tuple[Change, ...]:
    """Return the causes and known effects whose size is not the same in all recordings that were fitted.

    Parameters
    ----------
    explanation
        With its most probable set.
    problem
        The recordings.
    """
    if len(problem.observed[0]) < 2:
        return ()
    best, model = explanation.best, explanation.search.model
    data = explanation.linear.data
    recording = data.of_stretches([part.recording for part in data.parts])
    found = []
    for term in best.terms:
        if term.kind == "law" or not term.linear or term.offset is not None:
            continue
        others = [t for t in best.optional if t is not term]
        each = [_of_one(term, recording == k, k) for k in range(len(problem.observed[0]))]
        # The common size stays: what each recording has beside it is as large as the size itself, at most.
        apart = model.fit([*others, *([term] if term in best.optional else []), *each[1:]], best)
        odds = np.exp(np.clip(apart.score - best.score + np.log(CHANGED), -50.0, 50.0))
        if (confidence := float(odds / (1.0 + odds))) <= 0.5:
            continue
        values = []
        for k, own in enumerate(each):
            shift = np.zeros(len(apart.found.x))
            shift[apart.slices[term.ident].start] = 1.0
            if k:
                shift[apart.slices[own.ident].start] = 1.0
            value, std = float(shift @ apart.found.x), float(np.sqrt(shift @ apart.found.S @ shift))
            values.append((problem.observed[0][k].source, value, std))
        parameters, _ = estimated(best, term, problem.numbers, explanation.linear.values)
        name, first = next(iter(parameters.items()))
        if term.kind == "number":
            k = int(np.flatnonzero(term.what[:, 0])[0])
            number = problem.numbers[k]
            base = number.neutral + (explanation.linear.values[k] + best.numbers[k] - best.far_off[k]) * number.prior_std
            values = [(r, base + v * number.prior_std, s * number.prior_std) for r, v, s in values]
        found.append(Change(term.key[0], term.key[1], name, first.unit, tuple(values), confidence))
    return tuple(found)


def _of_one(term: Term, there: np.ndarray, k: int) -> Term:
    """Return what a term adds in one recording beside its common size."""
    columns = np.where(there[:, None], term.columns[:, : term.linear], 0.0)
    return replace(
        term,
        kind="change",
        columns=columns,
        std=term.std[: term.linear],
        mean=np.zeros(term.linear),
        low=np.full(term.linear, -np.inf),
        high=np.full(term.linear, np.inf),
        odds=0.0,
        grid=0.0,
        tangents=(),
        ident=(*term.ident, "change", k),
    )
