"""Select, linearise beside the selection, until nothing changes; no step knows what came before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
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
from elastic_arm.evidence.priors import ELSEWHERE, NEAR, ROUNDS, STATED, TRUST
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.search import Search
from elastic_arm.evidence.term import Key, Term

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
    linear = Linearisation(problem, np.zeros(len(problem.numbers)), ())
    found = _descended(linear, None, refit)
    tried: set[frozenset[Key]] = set()
    for _ in range(ELSEWHERE):
        # Exchanged at this linearisation, a set whose numbers lie elsewhere is judged by columns that are not its own.
        other = _elsewhere(found, tried)
        if other is None:
            break
        tried.add(other.keys)
        again = _descended(found.linear, other, refit)
        better, worse = (again, found) if again.best.score > found.best.score else (found, again)
        better.search.take(worse.search.met.values())
        found = replace(better, log=(*found.log, "elsewhere:", *again.log))
    return found


def _elsewhere(found: Explanation, tried: Set[frozenset[Key]]) -> Fit | None:
    """Return the likeliest set with a number more than an ordinary deviation from where the most probable one has it."""
    moving = np.array([p.moves_model for p in found.linear.problem.numbers], dtype=bool)
    sets = (
        fit
        for keys, fit in found.search.met.items()
        if fit.score > found.best.score - NEAR
        and keys not in tried
        and np.max(np.abs(fit.numbers - found.best.numbers)[moving], initial=0.0) > 1.0
    )
    return max(sets, key=lambda fit: fit.score, default=None)


def _descended(linear: Linearisation, before: Fit | None, refit: bool) -> Explanation:
    """Return the most probable set beside which the linearisation stays."""
    problem, log, whole = linear.problem, [], False
    moving = np.array([p.moves_model for p in problem.numbers], dtype=bool)
    limits = np.array([p.limit for p in problem.numbers])
    if before is not None:
        linear = _moved(linear, before, moving, limits)
    for n in range(ROUNDS):
        found = _explained(linear, before, refit, whole=whole)
        log += [f"{n}: {line}" for line in found.log]
        best = found.best
        deviations = np.abs(best.numbers) / np.sqrt(np.diag(best.number_covariance))
        settled = before is not None and before.keys == best.keys and np.max(deviations[moving], initial=0.0) < 1.0
        if settled and whole:
            break
        # Laws without a form and the moves that take long come where the linearisation has settled.
        whole = whole or settled or n == ROUNDS - 2
        before = best
        if not settled and n < ROUNDS - 1:
            linear = _moved(linear, best, moving, limits)
    return replace(found, log=tuple(log))


def _moved(linear: Linearisation, fit: Fit, moving: NDArray[np.bool_], limits: Array) -> Linearisation:
    """Return the linearisation where a fit puts the numbers."""
    values = np.where(moving, np.clip(linear.values + fit.numbers, -limits, limits), 0.0)
    return Linearisation(linear.problem, values, _acting(fit), near=linear.data)


def _explained(linear: Linearisation, before: Fit | None, refit: bool, *, whole: bool) -> Explanation:
    """Return the most probable set at a linearisation, from the one found at another."""
    trusts = {name: one for name, one in TRUST.items() if not (refit and name == "as measured")}
    trust = next(iter(trusts)) if before is None else before.model.name
    always, off = known_terms(linear)
    pool = [*pool_of(linear, laws=whole), *(t.with_odds(float(np.log(len(off)))) for t in off)]
    model = LinearModel(
        linear.data.white,
        linear.numbers,
        Bands(linear.data),
        -linear.values,
        np.array([p.is_number for p in linear.problem.numbers], dtype=bool),
        tuple(always),
        trust,
    )
    screen, log = Screen(model.grams, pool), []
    terms = [] if before is None else _again(before, linear, pool)
    # The trust in the description that is most probable beside the set, and the set beside it, until both stay.
    tried: dict[str, Search] = {}
    while trust not in tried:
        search = Search(model.trusting(trust), screen, linear.columns, linear.problem.largest_at)
        tried[trust], best = search, search.run(terms, whole=whole)
        log += [f"{trust}: {line}" for line in search.log]
        terms = best.optional
        scores = {
            name: model.trusting(name).fit(terms, best).score + float(np.log(one.prior)) for name, one in trusts.items()
        }
        trust = max(scores, key=lambda name: scores[name])
    search = tried[trust]
    best = search.run(terms, whole=whole)
    total = np.logaddexp.reduce(list(scores.values()))
    log.append(f"{trust}, {best.score:.1f}: {', '.join(f'{k[0]} {k[1]}' for k in best.keys) or 'nothing'}")
    return Explanation(linear, search, best, {k: float(np.exp(v - total)) for k, v in scores.items()}, tuple(log))


def pool_of(linear: Linearisation, *, laws: bool) -> list[Term]:
    """Return all that may be there, with its prior odds: small for each kind, shared by those that could be."""
    problem = linear.problem
    kinds = (
        effect_terms(linear, linear.placed(problem.candidates)),
        number_terms(problem.numbers, linear.values, linear.numbers),
        law_terms(linear.data) if laws else [],
    )
    found = []
    for terms in kinds:
        each = float(np.log(max(len({t.key for t in terms}), 1)))
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
        always.append(Term(feature.key, "effect", X, width, mean=mean, feature=feature, theta=theta, trusted=True))
        off.append(Term(feature.key, "stated", X, std, feature=feature, theta=theta))
    return always, off


def _coefficients(feature: Feature, values: Mapping[str, Any]) -> Array:
    """Return the coefficients of the columns of an effect with these parameters."""
    if feature.phase is not None:
        size, phase = values[feature.linear[0].name], values[feature.phase.name]
        return size * np.array([np.cos(phase), np.sin(phase)])
    return np.concatenate([np.atleast_1d(values[p.name]) - (p.neutral or 0.0) for p in feature.linear])


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
            found.append(replace(same, std=t.std, grid=t.grid, scale=t.scale, ident=t.ident))
    return found
