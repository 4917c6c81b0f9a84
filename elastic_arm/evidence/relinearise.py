"""Select, linearise beside the selection, until nothing changes; no step knows what came before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import Fit, LinearModel, Screen
from elastic_arm.evidence.nonlinear import components, moved, tangent_term
from elastic_arm.evidence.pool import effect_terms, law_terms, linear_prior, number_terms
from elastic_arm.evidence.priors import EFFECT, FAULT, FORMLESS, ROUNDS, STATED, TRUST
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.search import Search
from elastic_arm.evidence.term import Term

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is most probably there, at the linearisation beside it.

    Parameters
    ----------
    linear
        Where.
    search
        All sets met.
    best
        The most probable one.
    trust
        Probability of each trust in the description.
    log
        What was done, a line a step.
    """

    linear: Linearisation
    search: Search
    best: Fit
    trust: Mapping[str, float]
    log: tuple[str, ...] = ()


def explain(problem: Problem, *, refit: bool) -> Explanation:
    """Return the most probable explanation of the recordings that are fitted.

    Parameters
    ----------
    problem
        What is to be explained.
    refit
        Whether the description cannot be as measured.
    """
    count = len(problem.numbers)
    moving = np.array([p.moves_model for p in problem.numbers], dtype=bool)
    limits = np.array([p.limit for p in problem.numbers])
    linear, before, log = Linearisation(problem, np.zeros(count), ()), None, []
    for n in range(ROUNDS):
        found = _explained(linear, before, refit)
        log += [f"{n}: {line}" for line in found.log]
        best = found.best
        step = _step(best, count)
        same = before is not None and before.keys == best.keys
        farthest = np.max(np.abs(step[moving]) / _stds(best, count)[moving], initial=0.0)
        if (same and farthest < 1.0) or n == ROUNDS - 1:
            break
        values = np.where(moving, np.clip(linear.values + step, -limits, limits), 0.0)
        before = best
        linear = Linearisation(problem, values, _acting(best), near=linear.data)
    return replace(found, log=tuple(log))


def _explained(linear: Linearisation, before: Fit | None, refit: bool) -> Explanation:
    """Return the most probable set at a linearisation, from the one found at another."""
    count = len(linear.problem.numbers)
    always, off = known_terms(linear)
    pool = [*pool_of(linear), *(t.with_odds(float(np.log(len(off)) - np.log(FAULT))) for t in off)]
    model = LinearModel(
        linear.data.white,
        linear.numbers,
        Bands(linear.data),
        -linear.values,
        np.ones(count),
        np.array([p.is_number for p in linear.problem.numbers], dtype=bool),
        tuple(always),
    )
    screen, log = Screen(model.grams, pool), []
    terms = [] if before is None else _again(before, linear, pool)
    # The trust in the description that is most probable beside the set, and the set beside it, until both stay.
    trusts = {name: one for name, one in TRUST.items() if not (refit and name == "as measured")}
    tried: dict[str, Search] = {}
    trust = next(iter(trusts)) if before is None else before.model.name
    while trust not in tried:
        search = Search(model.trusting(trust, trusts[trust][0]), screen, linear.columns, linear.problem.largest_at)
        tried[trust], best = search, search.run(terms)
        log += [f"{trust}: {line}" for line in search.log]
        terms = best.optional
        scores = {
            name: model.trusting(name, factor).fit(terms, best).score + float(np.log(p))
            for name, (factor, p) in trusts.items()
        }
        trust = max(scores, key=lambda name: scores[name])
    search = tried[trust]
    best = search.run(terms)
    total = np.logaddexp.reduce(list(scores.values()))
    log.append(f"{trust}, {best.score:.1f}: {', '.join(f'{k[0]} {k[1]}' for k in best.keys) or 'nothing'}")
    return Explanation(linear, search, best, {k: float(np.exp(v - total)) for k, v in scores.items()}, tuple(log))


def pool_of(linear: Linearisation) -> list[Term]:
    """Return all that may be there, with its prior odds: small for each kind, shared by those that could be."""
    problem = linear.problem
    kinds = (
        (effect_terms(linear, linear.placed(problem.candidates)), EFFECT),
        (number_terms(problem.numbers, linear.values, linear.numbers), FAULT),
        (law_terms(linear.data), FORMLESS),
    )
    found = []
    for terms, odds in kinds:
        each = float(np.log(max(len({t.key for t in terms}), 1)) - np.log(odds))
        found += [t.with_odds(each) for t in terms]
    return found


def known_terms(linear: Linearisation) -> tuple[list[Term], list[Term]]:
    """Return the terms of known effects, and those by which stated ones may be far off."""
    problem, always, off = linear.problem, [], []
    for i, (feature, instance) in enumerate(problem.known):
        (feature,) = linear.placed([feature])
        theta = tuple(float(v) for p in feature.searched for v in np.atleast_1d(instance.parameters[p.name]))
        X = linear.columns(feature, theta)
        if feature.fixed:
            whole = X.sum(axis=1)
            always.append(Term(feature.key, "effect", X[:, :0], np.zeros(0), offset=whole, feature=feature, theta=theta))
            continue
        std, _, _ = linear_prior(feature, problem.largest_at(feature.joint))
        if i >= len(problem.stated):
            always.append(Term(feature.key, "effect", X, std, feature=feature, theta=theta))
            continue
        mean = _coefficients(feature, instance.parameters)
        width = STATED * np.maximum(np.abs(mean), 1e-3 * std)
        always.append(Term(feature.key, "effect", X, width, mean=mean, feature=feature, theta=theta))
        off.append(Term(feature.key, "stated", X, std, feature=feature, theta=theta))
    return always, off


def _coefficients(feature: Feature, values: Mapping[str, Any]) -> Array:
    """Return the coefficients of the columns of an effect with these parameters."""
    if feature.phase is not None:
        size, phase = values[feature.linear[0].name], values[feature.phase.name]
        return size * np.array([np.cos(phase), np.sin(phase)])
    return np.concatenate([np.atleast_1d(values[p.name]) - (p.neutral or 0.0) for p in feature.linear])


def _step(fit: Fit, count: int) -> Array:
    """Return by how much the numbers move to where they are most probable (K,)."""
    step = fit.found.x[:count].copy()
    for t in fit.optional:
        if t.kind == "number":
            step += t.what @ fit.beta(t)
    return step


def _stds(fit: Fit, count: int) -> Array:
    """Return the standard deviations of the numbers (K,), what is far off included."""
    moves = np.zeros((count, len(fit.found.x)))
    moves[:, :count] = np.eye(count)
    for t in fit.optional:
        if t.kind == "number":
            moves[:, fit.slices[t.ident]] += t.what
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", moves, fit.found.S, moves), 1e-12))


def theta_of(term: Term, fit: Fit) -> tuple[float, ...]:
    """Return the nonlinear numbers of a term where a fit puts them."""
    theta, own = list(term.theta), components(term.feature)
    for k, j in enumerate(term.tangents):
        theta[j] = moved(own[j], theta[j], float(fit.beta(term)[term.linear + k]))
    return tuple(theta)


def _acting(fit: Fit) -> tuple[ActingEffect, ...]:
    """Return the effects of a fit that act in the torques."""
    found: dict[object, ActingEffect] = {}
    for t in fit.terms:
        if t.kind not in ("effect", "stated") or isinstance(t.feature.effect, SensorEffect):
            continue
        beta = np.ones(1) if t.offset is not None else fit.beta(t)[: t.linear]
        if t.key in found:
            beta = beta + found[t.key].coefficients
        found[t.key] = ActingEffect(t.feature, theta_of(t, fit), beta)
    return tuple(found.values())


def _again(fit: Fit, linear: Linearisation, pool: Sequence[Term]) -> list[Term]:
    """Return the terms of a fit at another linearisation."""
    alike = {(t.kind, t.key, t.count, t.theta): t for t in pool}
    found = []
    for t in fit.optional:
        if t.kind == "effect" and t.tangents:
            (feature,) = linear.placed([t.feature])
            size = 1.0 if feature.fixed else float(fit.beta(t)[0])
            largest = linear.problem.largest_at(feature.joint)
            found.append(tangent_term(linear.columns, replace(t, feature=feature), theta_of(t, fit), size, largest))
        elif same := alike.get((t.kind, t.key, t.count, t.theta)):
            found.append(replace(same, std=t.std, grid=t.grid, ident=t.ident) if t.kind == "law" else same)
    return found
