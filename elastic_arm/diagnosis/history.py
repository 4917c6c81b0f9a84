"""One arm over time: the size of each number in each recording, and where it changed.

The recordings share one posterior (:mod:`.answer`). A size whose change between them is likelier there than not has
changed; every other one is shown as it would be with a size of its own in each recording. Where a change happened
follows from these sizes x with their covariance C: for a step after recording k, x = a up to k and b from there on,

    ln p(x | k) = -1/2 |x - X_k (a, b)|² in C⁻¹ - 1/2 ln |X_k' C⁻¹ X_k|        a, b anything

each k as likely beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from operator import eq
from typing import Any

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.changes import SizedTerm, sizes_of
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.changes import change_key, change_of


@dataclass(frozen=True)
class Step:
    """A change between two recordings."""

    after: int  # index of the last recording before it
    # before_value, before_std, after_value, after_std: size before and after it
    before_value: float
    before_std: float
    after_value: float
    after_std: float
    probability: float  # that it happened there, if there was one change


@dataclass(frozen=True)
class Course:
    """A number of the arm over the recordings."""

    sized: SizedTerm  # what, with its size in each recording
    changed: float  # probability that it is not the same in all
    step: Step | None  # where it changed most probably; None where it is likelier the same in all

    def to_dict(self, recordings: tuple[str, ...]) -> dict[str, Any]:
        """Return it as in `history.json`."""
        one, step = self.sized, self.step
        values = zip(recordings, one.values, one.stds, strict=True)
        return {
            "effect": one.effect,
            "joint": one.joint,
            "parameter": one.parameter,
            "unit": one.unit,
            "values": [{"recording": r, "value": v, "std": s} for r, v, s in values],
            "changed": self.changed,
            "step": None
            if step is None
            else {
                "between": list(recordings[step.after : step.after + 2]),
                "before": {"value": step.before_value, "std": step.before_std},
                "after": {"value": step.after_value, "std": step.after_std},
                "probability": step.probability,
            },
        }


def courses(found: Diagnosis) -> tuple[Course, ...]:
    """Return every number that a diagnosis of several recordings found or knew, those that changed first."""
    if found.context is None or len(found.identify) < 2:
        raise DiagnosisError("a history needs two recordings or more", "Name them, or the folder that they are in.")
    explanation = found.context.explanation
    best, linear, model = explanation.best, explanation.linear, explanation.search.model
    result = []
    for term in best.terms:
        if term.kind not in ("effect", "number") or not term.linear:
            continue
        key = change_key(term)
        present = next((t for t in best.optional if t.key == key), None)
        change = present or change_of(linear, term)
        fit = best if present is not None else model.fit((*best.optional, change), near=best)
        sized = sizes_of(explanation, linear.problem, fit, change)
        changed = explanation.search.probability(partial(eq, key))
        result.append(Course(sized, changed, step_of(sized.values, sized.covariance) if changed > 0.5 else None))
    return tuple(sorted(result, key=lambda one: -one.changed))


def step_of(values: Array, covariance: Array) -> Step:
    """Return the most probable step in values (n,) with their covariance (n, n)."""
    inverse = np.linalg.pinv(covariance, hermitian=True)
    scores, fits = [], []
    for k in range(1, len(values)):
        later = (np.arange(len(values)) >= k).astype(float)
        X = np.stack([1.0 - later, later], axis=1)
        information = X.T @ inverse @ X
        S = np.linalg.inv(information)
        levels = S @ X.T @ inverse @ values
        left = values - X @ levels
        scores.append(-0.5 * float(left @ inverse @ left) - 0.5 * float(np.linalg.slogdet(information)[1]))
        fits.append((levels, np.sqrt(np.diag(S))))
    weights = np.exp(np.array(scores) - max(scores))
    best = int(np.argmax(weights))
    (a, b), (a_std, b_std) = fits[best][0].tolist(), fits[best][1].tolist()
    return Step(best, a, a_std, b, b_std, float(weights[best] / weights.sum()))
