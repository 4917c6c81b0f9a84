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
from elastic_arm.diagnosis.result import Change, Diagnosis, plain
from elastic_arm.effects import EFFECTS
from elastic_arm.errors import DiagnosisError
from elastic_arm.evidence.priors import EVENT, ODDS, SCATTER, STEP, UNSURE
from elastic_arm.evidence.terms.change import ChangeTerm, change_key, change_of
from elastic_arm.evidence.terms.known import StatedTerm

FEW = "a history needs at least two recordings"
TIMES = np.append(0.0, np.geomspace(0.03, 300.0, 32))  # values of t: scatter over the ordinary one


@dataclass(frozen=True)
class Step:
    """A change between two recordings."""

    # after, until: indices of the last recording before the step and the first after it, of those
    # with a size
    after: int
    until: int
    # before_value, before_std, after_value, after_std: sizes before and after the step
    before_value: float
    before_std: float
    after_value: float
    after_std: float
    probability: float  # that the number changed here, given that it changed


@dataclass(frozen=True)
class Course:
    """A number of the arm over the recordings."""

    sized: SizedTerm  # the number with its size in each recording
    changed: float  # probability that it differs between recordings
    step: Step | None  # the most probable change; None if the number probably did not change

    def sizes(self, recordings: Sequence[str]) -> list[tuple[str, float, float]]:
        """Return recording, value and standard deviation for each recording with a size."""
        each = zip(recordings, self.sized.values.tolist(), self.sized.stds.tolist(), strict=True)
        return [one for one in each if np.isfinite(one[1])]

    def change(self, recordings: Sequence[str]) -> Change:
        """Return the course as a change between these recordings."""
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
    """Return one diagnosis for diagnoses of single recordings, and the courses of all numbers.

    refused: reasons why other recordings allowed no diagnosis.
    """
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
    """Return a diagnosis with the steps of these courses as its changes."""
    return replace(
        found, changes=tuple(one.change(found.identify) for one in followed if one.step is not None)
    )


def courses_of_each(found: Sequence[Diagnosis]) -> tuple[Course, ...]:
    """Return the courses of all numbers in diagnoses of single recordings, changed ones first."""
    result = []
    places = [set(one.noise) for one in found]
    for key, own in _sizes_by_number(found).items():
        values = np.full(len(found), np.nan)
        stds = np.full(len(found), np.nan)
        for k, (value, std) in own.items():
            values[k] = value
            stds[k] = std
        absent = _absent(key[0], key[2])
        if absent is not None:
            std = float(np.nanmedian(stds))
            relative = max(1.0, float(np.nanmax(np.abs(values - absent))) / std)
            hidden = std * np.sqrt(2.0 * np.log(relative / ODDS))
            # A recording that lacks the channels of the others may have the effect all the same.
            shown = [places[k] for k in own]
            seen = [any(one <= there for one in shown) for there in places]
            values = np.where(np.isnan(values) & seen, absent, values)
            stds = np.where(np.isnan(stds) & seen, hidden, stds)
        result.append(SizedTerm(*key, values, np.diag(stds**2)))
    false = ODDS / max(1, len(result))
    wrong = np.array([UNSURE if one.verdict == "unknown" else false for one in found])
    return _followed(result, wrong, 1.0)


def _sizes_by_number(
    found: Sequence[Diagnosis],
) -> dict[tuple[str, str | None, str, str], dict[int, tuple[float, float]]]:
    """Return value and standard deviation by effect, joint, parameter and unit, and by diagnosis.

    The size of an effect is its first parameter.
    """
    sizes: dict[tuple[str, str | None, str, str], dict[int, tuple[float, float]]] = {}
    for k, one in enumerate(found):
        known = [(o["effect"], o["joint"], o["parameters"]) for o in one.known]
        causes = [(c.effect, c.joint, plain(c.parameters)) for c in one.causes]
        for effect, joint, parameters in [*known, *causes]:
            name = next(iter(parameters), None)
            if name is None:
                continue
            size = parameters[name]
            if size["std"] and not np.ndim(size["std"]):
                of_number = sizes.setdefault((effect, joint, name, size["unit"]), {})
                of_number[k] = size["value"], size["std"]
    return sizes


def courses(found: Diagnosis) -> tuple[Course, ...]:
    """Return the courses of all numbers in a diagnosis of several recordings, changed ones
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
    count = len(found.identify)
    if found.verdict != "unknown":
        return _followed(result, np.full(count, EVENT), 1.0)
    left = 1.0 - (found.shrink or 0.0)
    return _followed(result, np.full(count, UNSURE), float(np.sqrt(left)))


def _followed(sizes: Sequence[SizedTerm], wrong: Array, by: float) -> tuple[Course, ...]:
    found = [course_of(one, wrong, by, STEP / len(sizes)) for one in sizes]
    return tuple(sorted(found, key=lambda one: -one.changed))


def _absent(effect: str, parameter: str) -> float | None:
    """Return the value of a parameter without the effect; None if unknown."""
    return EFFECTS[effect].parameter(parameter).neutral if effect in EFFECTS else None


def course_of(sized: SizedTerm, wrong: Array, by: float, odds: float) -> Course:
    """Return the course of a number with its most probable step, if it probably changed.

    wrong: q (n,), probability of each recording that its size is wrong; by: w, range of wrong sizes
    over R; odds: prior odds that the number steps at all.
    """
    shown = np.flatnonzero(np.isfinite(sized.values))
    n = len(shown)
    if n < 2:
        return Course(sized, odds / (1.0 + odds), None)
    absent = _absent(sized.effect, sized.parameter) or 0.0
    x = sized.values[shown] - absent
    variances, common = _own_and_common(sized.covariance[np.ix_(shown, shown)])
    grid, none, before, after = _log_evidence(x, variances, wrong[shown], by)
    steps = logsumexp(before, axis=1) + np.log(odds / (n - 1))
    changed = float(np.exp(logsumexp(steps) - logsumexp([*steps, none])))
    if changed <= 0.5:
        return Course(sized, changed, None)
    m = int(np.argmax(steps))
    first, first_variance = _moments(grid, before[m])
    second, second_variance = _moments(grid, after[m])
    step = Step(
        int(shown[m]),
        int(shown[m + 1]),
        absent + first,
        float(np.sqrt(first_variance + common)),
        absent + second,
        float(np.sqrt(second_variance + common)),
        float(np.exp(steps[m] - logsumexp(steps))),
    )
    return Course(sized, changed, step)


def _own_and_common(covariance: Array) -> tuple[Array, float]:
    """Return the variance of each size by itself (n,), and the variance that all sizes share."""
    n = len(covariance)
    variances = np.diag(covariance)
    mean_covariance = (covariance.sum() - variances.sum()) / (n * (n - 1))
    common = float(np.clip(mean_covariance, 0.0, 0.999 * variances.min()))
    return variances - common, common


def _log_evidence(
    x: Array, variances: Array, wrong: Array, by: float
) -> tuple[Array, float, Array, Array]:
    """Return a grid of levels (G,), ln p(x | no step), and the integrands of ln p(x | m) over the
    levels before and after the step, (n - 1, G) each.

    x: sizes (n,) relative to that of no effect.
    """
    s2 = variances[:, None]
    q = wrong[:, None]
    R = max(float(np.abs(x).max()), float(np.sqrt(variances.max())))
    far = 4.0 * R / np.sqrt(variances.min())
    away = np.concatenate([np.arange(0.0, 2.0, 0.25), np.geomspace(2.0, far, 40)])
    near = x[:, None] + np.sqrt(s2) * np.concatenate([-away, away])
    grid = np.unique(np.quantile(near, np.linspace(0.0, 1.0, 1000)))
    prior = _log_normal(grid, R**2) + np.log(np.gradient(grid))
    left = x[:, None] - grid
    none = -np.inf
    before = np.full((len(x) - 1, len(grid)), -np.inf)
    after = before.copy()
    for t, width in zip(TIMES, np.gradient(TIMES), strict=True):
        v = s2 + t**2 * (s2 + (SCATTER * R) ** 2)
        right_size = np.log1p(-q) + _log_normal(left, v)
        wrong_size = np.log(q) + _log_normal(left, v + (by * R) ** 2)
        until = np.cumsum(np.logaddexp(right_size, wrong_size), axis=0)
        first = until[:-1] + prior
        second = until[-1] - until[:-1] + prior
        weight = np.log(width) - t
        none = np.logaddexp(none, weight + logsumexp(until[-1] + prior))
        before = np.logaddexp(before, weight + first + logsumexp(second, axis=1)[:, None])
        after = np.logaddexp(after, weight + second + logsumexp(first, axis=1)[:, None])
    return grid, float(none), before, after


def _log_normal(x: Array, variance: Array | float) -> Array:
    return -0.5 * (x**2 / variance + np.log(2.0 * np.pi * variance))


def _moments(grid: Array, log_weights: Array) -> tuple[float, float]:
    """Return the mean and variance of a level."""
    weights = np.exp(log_weights - logsumexp(log_weights))
    mean = float(weights @ grid)
    return mean, float(weights @ (grid - mean) ** 2)
