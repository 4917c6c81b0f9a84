"""One arm over time: the size of each number in each recording, and where it changed.

The recordings share one posterior (:mod:`.answer`). A size whose change between them is likelier there than not has
changed; every other one is shown as it would be with a size of its own in each recording. Where a change happened
follows from these sizes x with their covariance C: for a step after recording k, x = a up to k and b from there on,

    ln p(x | k) = -1/2 |x - X_k (a, b)|² in C⁻¹ - 1/2 ln |X_k' C⁻¹ X_k|        a, b anything

each k as likely beforehand.

Of more recordings than one diagnosis holds, each is diagnosed alone. Sizes x of variances S then differ as far as they
are likelier with a spread of their own, of a share w of the largest, than without:

    p(x | w) = N(x; a, S + w² max |x|²)        a anything, odds of a change and shares w by `evidence.priors`

A cause that some have, and all that are explained before them or after them have not, has its value of no effect in
these, with a deviation of as much as odds of one cause may hide: sqrt(-2 ln EVENT) deviations where it was found. A
recording of which something is unknown shows no change: its sizes hold a part of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import eq
from typing import Any

import numpy as np
from scipy.special import expit, logsumexp

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.changes import SizedTerm, sizes_of
from elastic_arm.diagnosis.result import Change, Diagnosis, plain_parameters
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.changes import change_key, change_of
from elastic_arm.evidence.priors import CHANGED, EVENT, SCALES

FEW = "a history needs two recordings or more"


@dataclass(frozen=True)
class Step:
    """A change between two recordings."""

    # after, until: index of the last recording before it, and of the first one after it that shows the size
    after: int
    until: int
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

    def sizes(self, recordings: Sequence[str]) -> list[tuple[str, float, float]]:
        """Return recording, value and standard deviation of each that shows it."""
        each = zip(recordings, self.sized.values.tolist(), self.sized.stds.tolist(), strict=True)
        return [one for one in each if np.isfinite(one[1])]

    def change(self, recordings: Sequence[str]) -> Change:
        """Return it as a change of what these recordings show."""
        one = self.sized
        return Change(one.effect, one.joint, one.parameter, one.unit, tuple(self.sizes(recordings)), self.changed)

    def to_dict(self, recordings: tuple[str, ...]) -> dict[str, Any]:
        """Return it as in `history.json`."""
        one, step = self.sized, self.step
        return {
            "effect": one.effect,
            "joint": one.joint,
            "parameter": one.parameter,
            "unit": one.unit,
            "values": [{"recording": r, "value": v, "std": s} for r, v, s in self.sizes(recordings)],
            "changed": self.changed,
            "step": None
            if step is None
            else {
                "between": [recordings[step.after], recordings[step.until]],
                "before": {"value": step.before_value, "std": step.before_std},
                "after": {"value": step.after_value, "std": step.after_std},
                "probability": step.probability,
            },
        }


def together(found: Sequence[Diagnosis], refused: Sequence[str] = ()) -> tuple[Diagnosis, tuple[Course, ...]]:
    """Return diagnoses of one recording each as one, and every number; `refused`: why other recordings allowed none."""
    if len(found) < 2:
        raise DiagnosisError("; ".join((FEW, *refused[:1])), "Name them, or the folder that they are in.")
    recordings, followed = tuple(one.identify[0] for one in found), courses_of_each(found)
    verdicts = {one.verdict for one in found}
    doubtful = [f"{one.identify[0]} is unknown, and shows no change" for one in found if one.verdict == "unknown"]
    whole = replace(
        found[0],
        identify=recordings,
        verdict=next(verdict for verdict in ("unknown", "explained", "none") if verdict in verdicts),
        causes=tuple(cause for one in found for cause in one.causes),
        changes=tuple(one.change(recordings) for one in followed if one.step is not None),
        unexplained=tuple(place for one in found for place in one.unexplained),
        notes=(*refused, *doubtful, *(note for one in found for note in one.notes)),
    )
    return whole, followed


def courses_of_each(found: Sequence[Diagnosis]) -> tuple[Course, ...]:
    """Return every number that diagnoses of single recordings hold, those that changed first."""
    sizes: dict[tuple[str, str | None, str, str], dict[int, tuple[float, float]]] = {}
    for k, one in enumerate(found):
        causes = [(c.effect, c.joint, plain_parameters(c.parameters)) for c in one.causes]
        for effect, joint, parameters in [*((o["effect"], o["joint"], o["parameters"]) for o in one.known), *causes]:
            for name, size in list(parameters.items())[:1]:
                if size["std"] and not np.ndim(size["std"]):
                    sizes.setdefault((effect, joint, name, size["unit"]), {})[k] = size["value"], size["std"]
    result = []
    for key, own in sizes.items():
        hidden = float(np.median([std for _, std in own.values()])) * np.sqrt(-2.0 * np.log(EVENT))
        absent = EFFECTS[key[0]].parameter(key[2]).neutral if key[0] in EFFECTS else None
        lacking = [k for k, one in enumerate(found) if k not in own and one.verdict != "unknown"]
        apart = bool(lacking) and (max(lacking) < min(own) or min(lacking) > max(own))
        if absent is not None and apart and len(own) > 1:
            own |= dict.fromkeys(lacking, (absent, hidden))
        every = np.full((2, len(found)), np.nan)
        every[:, list(own)] = np.array(list(own.values())).T
        where = np.array([k for k in sorted(own) if found[k].verdict != "unknown"], np.intp)
        values, variances = every[0, where], every[1, where] ** 2
        changed = changed_of_each(values, variances) if len(where) > 1 else CHANGED
        step = step_of(values, np.diag(variances)) if changed > 0.5 else None
        if step is not None:
            step = replace(step, after=int(where[step.after]), until=int(where[step.until]))
        result.append(Course(SizedTerm(*key, every[0], np.diag(every[1] ** 2)), changed, step))
    return tuple(sorted(result, key=lambda one: -one.changed))


def changed_of_each(values: Array, variances: Array) -> float:
    """Return the probability that sizes (n,) of these variances are not all the same."""
    spread = np.append(0.0, SCALES * np.abs(values).max())[:, None] ** 2
    weights = 1.0 / (variances + spread)
    total = weights.sum(axis=1)
    left = np.sum(weights * (values - (weights @ values / total)[:, None]) ** 2, axis=1)
    scores = 0.5 * (np.log(weights).sum(axis=1) - np.log(total) - left)
    return float(expit(np.log(CHANGED) + logsumexp(scores[1:]) - np.log(len(SCALES)) - scores[0]))


def courses(found: Diagnosis) -> tuple[Course, ...]:
    """Return every number that a diagnosis of several recordings found or knew, those that changed first."""
    if found.context is None or len(found.identify) < 2:
        raise DiagnosisError(FEW, "Name them, or the folder that they are in.")
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
    return Step(best, best + 1, a, a_std, b, b_std, float(weights[best] / weights.sum()))
