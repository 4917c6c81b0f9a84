"""One arm over time: the size of each number in each recording, and its changes.

A number has the sizes x_k with variances s_k² (:mod:`.estimates`) in the recordings k = 1 … n. Its
level a may step to b after recording m. Besides noise, two things make sizes differ:

- *Scatter* from recording to recording (temperature, a tool, noise outside the model). Its
  variance is the same in all recordings, v_k(t) = s_k² + t² (s_k² + (SCATTER R)²), with t from an
  exponential distribution of mean 1: scatter of the size of the deviations and of a relative
  SCATTER is ordinary, and only the sizes themselves can show ten times as much.
- *Wrong* sizes, each with a probability q_k, by w_k R. In recordings that were diagnosed alone, a
  false cause (w = 1) has the probability ODDS, shared by the arm's N numbers, or UNSURE if
  something is unknown. In recordings that were diagnosed together, with the same causes, a size may
  include a part of what is unknown, w² = 1 - shrink.

R, the largest distance of a size from that of no effect x_0, is the range of levels and of wrong
sizes:

    a, b ~ N(x_0, R²), independent
    p(x_k | a, t) = (1 - q_k) N(x_k; a, v_k) + q_k N(x_k; a, v_k + (w_k R)²)
    p(x | no step) = ∫dt e⁻ᵗ ∫da p(a) Π_k p(x_k | a, t)
    p(x | m) = ∫dt e⁻ᵗ [∫da p(a) Π_{k ≤ m} p(x_k | a, t)] [∫db p(b) Π_{k > m} p(x_k | b, t)]

With prior odds STEP / (N (n - 1)) for each number and place, these give the posterior of every
place; its sum over places is the probability that the number changed. The integrals are sums over a
grid that is as fine as the deviations near every size. A variance that all sizes share, as in one
diagnosis of all recordings, moves both levels alike: it is removed first and added to both levels
in the end.

A cause that a recording lacks has the value of no effect there. Its deviation is what the search
could have overlooked: z s with z² / 2 = ln(R / s) - ln ODDS.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from scipy.special import logsumexp

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.changes import SizedTerm, sizes_of
from elastic_arm.diagnosis.result import Change, Diagnosis, plain_parameters
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.priors import EVENT, ODDS, SCATTER, STEP, UNSURE
from elastic_arm.evidence.terms.change import ChangeTerm, change_key, change_of
from elastic_arm.evidence.terms.known import StatedTerm

FEW = "a history needs at least two recordings"
TIMES = np.append(0.0, np.geomspace(0.03, 300.0, 32))  # of scatter, over the ordinary one


@dataclass(frozen=True)
class Step:
    """A change between two recordings."""

    # after, until: index of the last recording before it, and of the first one after it that shows
    # the size
    after: int
    until: int
    # before_value, before_std, after_value, after_std: size before and after it
    before_value: float
    before_std: float
    after_value: float
    after_std: float
    probability: float  # that it happened there, if it did


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
        return Change(
            one.effect,
            one.joint,
            one.parameter,
            one.unit,
            tuple(self.sizes(recordings)),
            self.changed,
        )

    def to_dict(self, recordings: tuple[str, ...]) -> dict[str, Any]:
        """Return it as in `history.json`."""
        one = self.sized
        step = self.step
        return {
            "effect": one.effect,
            "joint": one.joint,
            "parameter": one.parameter,
            "unit": one.unit,
            "values": [
                {"recording": r, "value": v, "std": s} for r, v, s in self.sizes(recordings)
            ],
            "changed": self.changed,
            "step": (
                None
                if step is None
                else {
                    "between": [recordings[step.after], recordings[step.until]],
                    "before": {"value": step.before_value, "std": step.before_std},
                    "after": {"value": step.after_value, "std": step.after_std},
                    "probability": step.probability,
                }
            ),
        }


def together(
    found: Sequence[Diagnosis], refused: Sequence[str] = ()
) -> tuple[Diagnosis, tuple[Course, ...]]:
    """Return diagnoses of one recording each as one, and every number; `refused`: why other
    recordings allowed none."""
    if len(found) < 2:
        raise DiagnosisError(
            "; ".join((FEW, *refused[:1])), "Give them, or the folder that contains them."
        )
    recordings = tuple(one.identify[0] for one in found)
    followed = courses_of_each(found)
    verdicts = {one.verdict for one in found}
    doubtful = [
        f"{one.identify[0]} is unknown: its sizes have little weight"
        for one in found
        if one.verdict == "unknown"
    ]
    places = set().union(*(one.noise for one in found))
    lacking = [
        f"{one.identify[0]} lacks channels of the other recordings: effects visible only in"
        " these are not compared"
        for one in found
        if set(one.noise) < places
    ]
    whole = replace(
        found[0],
        identify=recordings,
        verdict=next(v for v in ("unknown", "explained", "none") if v in verdicts),
        causes=tuple(chain.from_iterable(one.causes for one in found)),
        unexplained=tuple(chain.from_iterable(one.unexplained for one in found)),
        notes=(*refused, *doubtful, *lacking, *chain.from_iterable(one.notes for one in found)),
    )
    return with_steps(whole, followed), followed


def with_steps(found: Diagnosis, followed: Sequence[Course]) -> Diagnosis:
    """Return a diagnosis whose changes are these steps."""
    return replace(
        found, changes=tuple(one.change(found.identify) for one in followed if one.step is not None)
    )


def courses_of_each(found: Sequence[Diagnosis]) -> tuple[Course, ...]:
    """Return every number that diagnoses of single recordings hold, those that changed first."""
    sizes: dict[tuple[str, str | None, str, str], dict[int, tuple[float, float]]] = {}
    for k, one in enumerate(found):
        causes = [(c.effect, c.joint, plain_parameters(c.parameters)) for c in one.causes]
        for effect, joint, parameters in [
            *((o["effect"], o["joint"], o["parameters"]) for o in one.known),
            *causes,
        ]:
            for name, size in list(parameters.items())[:1]:
                if size["std"] and not np.ndim(size["std"]):
                    sizes.setdefault((effect, joint, name, size["unit"]), {})[k] = (
                        size["value"],
                        size["std"],
                    )
    result = []
    places = [set(one.noise) for one in found]
    for key, own in sizes.items():
        values, stds = np.full((2, len(found)), np.nan)
        values[list(own)], stds[list(own)] = np.array(list(own.values())).T
        if (absent := _absent(key[0], key[2])) is not None:
            std = float(np.nanmedian(stds))
            relative = max(1.0, float(np.nanmax(np.abs(values - absent))) / std)
            hidden = std * np.sqrt(2.0 * np.log(relative / ODDS))
            # What lacks a channel at which the others show it may have it all the same.
            shown = [places[j] for j in own]
            seen = [any(one <= there for one in shown) for there in places]
            values = np.where(np.isnan(values) & seen, absent, values)
            stds = np.where(np.isnan(stds) & seen, hidden, stds)
        result.append(SizedTerm(*key, values, np.diag(stds**2)))
    wrong = np.array(
        [UNSURE if one.verdict == "unknown" else ODDS / max(1, len(result)) for one in found]
    )
    return _followed(result, wrong, 1.0)


def courses(found: Diagnosis) -> tuple[Course, ...]:
    """Return every number that a diagnosis of several recordings found or knew, those that changed
    first."""
    if found.context is None or len(found.identify) < 2:
        raise DiagnosisError(FEW, "Give them, or the folder that contains them.")
    explanation = found.context.explanation
    best = explanation.best
    linear = explanation.linear
    model = explanation.search.model
    result = []
    for term in best.terms:
        if not term.says_cause or isinstance(term, StatedTerm) or not term.linear:
            continue
        key = change_key(term)
        changes = (t for t in best.optional if isinstance(t, ChangeTerm) and t.key == key)
        present = next(changes, None)
        change = present or change_of(linear, term)
        fit = best if present is not None else model.fit((*best.optional, change), near=best)
        result.append(sizes_of(explanation, linear.problem, fit, change))
    unknown = found.verdict == "unknown"
    wrong = np.full(len(found.identify), UNSURE if unknown else EVENT)
    return _followed(result, wrong, float(np.sqrt(1.0 - (found.shrink or 0.0))) if unknown else 1.0)


def _followed(sizes: Sequence[SizedTerm], wrong: Array, by: float) -> tuple[Course, ...]:
    found = [course_of(one, wrong, by, STEP / len(sizes)) for one in sizes]
    return tuple(sorted(found, key=lambda one: -one.changed))


def _absent(effect: str, parameter: str) -> float | None:
    return EFFECTS[effect].parameter(parameter).neutral if effect in EFFECTS else None


def course_of(sized: SizedTerm, wrong: Array, by: float, odds: float) -> Course:
    """Return where a number steps most probably: `wrong`, q (n,), `by` w; `odds`, that it steps at
    all."""
    shown = np.flatnonzero(np.isfinite(sized.values))
    n = len(shown)
    absent = _absent(sized.effect, sized.parameter) or 0.0
    if n < 2:
        return Course(sized, odds / (1.0 + odds), None)
    x = sized.values[shown] - absent
    C = sized.covariance[np.ix_(shown, shown)]
    q = wrong[shown, None]
    S = np.diag(C)
    common = float(np.clip((C.sum() - S.sum()) / (n * (n - 1)), 0.0, 0.999 * S.min()))
    S = (S - common)[:, None]
    R = max(float(np.abs(x).max()), float(np.sqrt(S.max())))
    away = np.concatenate(
        [np.arange(0.0, 2.0, 0.25), np.geomspace(2.0, 4.0 * R / np.sqrt(S.min()), 40)]
    )
    near = x[:, None] + np.sqrt(S) * np.concatenate([-away, away])
    grid = np.unique(np.quantile(near, np.linspace(0.0, 1.0, 1000)))
    prior = _log_normal(grid, R**2) + np.log(np.gradient(grid))
    none, before, after = -np.inf, *np.full((2, n - 1, len(grid)), -np.inf)
    for t, width in zip(TIMES, np.gradient(TIMES), strict=True):
        v = S + t**2 * (S + (SCATTER * R) ** 2)
        left = x[:, None] - grid
        each = np.logaddexp(
            np.log1p(-q) + _log_normal(left, v), np.log(q) + _log_normal(left, v + (by * R) ** 2)
        )
        until = np.cumsum(each, axis=0)
        first = until[:-1] + prior
        second = until[-1] - until[:-1] + prior
        weight = np.log(width) - t
        none = np.logaddexp(none, weight + logsumexp(until[-1] + prior))
        before = np.logaddexp(before, weight + first + logsumexp(second, axis=1)[:, None])
        after = np.logaddexp(after, weight + second + logsumexp(first, axis=1)[:, None])
    steps = logsumexp(before, axis=1) + np.log(odds / (n - 1))
    changed = float(np.exp(logsumexp(steps) - logsumexp([*steps, none])))
    if changed <= 0.5:
        return Course(sized, changed, None)
    m = int(np.argmax(steps))
    level, variance = _moments(grid, before[m])
    first = absent + level
    first_std = float(np.sqrt(variance + common))
    level, variance = _moments(grid, after[m])
    second = absent + level
    second_std = float(np.sqrt(variance + common))
    probability = float(np.exp(steps[m] - logsumexp(steps)))
    step = Step(int(shown[m]), int(shown[m + 1]), first, first_std, second, second_std, probability)
    return Course(sized, changed, step)


def _log_normal(x: Array, variance: Array | float) -> Array:
    return -0.5 * (x**2 / variance + np.log(2.0 * np.pi * variance))


def _moments(grid: Array, log_weights: Array) -> tuple[float, float]:
    """Return mean and variance."""
    weights = np.exp(log_weights - logsumexp(log_weights))
    mean = float(weights @ grid)
    return mean, float(weights @ (grid - mean) ** 2)
