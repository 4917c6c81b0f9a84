"""Select, linearise beside the selection, until nothing changes; no step knows what came before it."""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.effects.model import ControllerEffect, EffectInstance, SensorEffect
from elastic_arm.equations.places import scaling
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.evidence.changes import CHANGE, change_of
from elastic_arm.evidence.grams import Bands, kept
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.model import EXACT, KINDS, Fit, LinearModel, Screen
from elastic_arm.evidence.nonlinear import components, moved, placed_anew, tangent_term
from elastic_arm.evidence.pool import effect_terms, law_terms, linear_prior, number_terms
from elastic_arm.evidence.priors import COMPARED, ELSEWHERE, MOST, NEAR, ROUNDS, STATED, TRUST, WORTH
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.search import ADDED, ALL, SIMPLE, Search, Thetas, words_of
from elastic_arm.evidence.term import Key, Term

STEPS = 6  # of Gauss and Newton beside a set
MEASURED, BUILT = "as measured", "as built"  # of the kinds of trust, those from which a search starts


@dataclass(frozen=True, eq=False)
class Explanation:
    """What is most probably there, at the linearisation beside it."""

    linear: Linearisation  # where
    search: Search  # all sets met
    best: Fit  # the most probable one
    trust: Mapping[str, float]  # probability of each trust in the description
    log: tuple[str, ...] = ()  # what was done, a line a step

    @cached_property
    def sized(self) -> Fit:
        """The most probable set with its sizes by the recordings that are fitted."""
        return self.best.model.of_fitted(self.best)

    @cached_property
    def settled(self) -> Linearisation:
        """The linearisation at the numbers of the most probable set, which may have been met beside another."""
        return _moved(self.linear, self.sized) if _far(self.sized) else self.linear


@dataclass
class Shared:
    """What searches at several linearisations share."""

    thetas: Thetas = field(default_factory=dict)  # where nonlinear numbers were most probable
    # What may be added, of the last linearisations, and laws without a form, of the last: they take most of the memory.
    screens: dict[Linearisation, Screen] = field(default_factory=dict)
    laws: dict[Linearisation, Screen] = field(default_factory=dict)


def explain(problem: Problem, *, refit: bool) -> Explanation:
    """Return the most probable explanation of all recordings.

    refit: whether the description cannot be as measured.
    """
    described = Linearisation(problem, np.zeros(len(problem.numbers)), _stated(problem))
    shared = Shared()
    first = _begun(described, refit, shared)
    nothing = first.linear, first.search.model.fit(())
    found = _descended(first.linear, first.best, refit, shared, taken=nothing)
    tried: set[frozenset[Key]] = set()
    for _ in range(ELSEWHERE):
        # Exchanged at this linearisation, a set whose numbers lie elsewhere is judged by columns that are not its own.
        other = _elsewhere(found, tried)
        if other is None:
            break
        tried.add(other.keys)
        found = _better(found, _descended(found.linear, other, refit, shared, best=found.best))
    return replace(found, log=(*first.log, *found.log))


def _begun(described: Linearisation, refit: bool, shared: Shared) -> Explanation:
    """Return the most probable of several starts, with the steps of all."""
    # Where the description is exact, all that is left is an effect. Where it is off everywhere, there is less to
    # mistake for one where its numbers lie alone; but beside a large effect they lie far off there.
    built = _settled(described, None, BUILT)
    starts = [
        _explained(described, (), BUILT if refit else MEASURED, refit, shared, moves=ADDED),
        _explained(built, (), BUILT, refit, shared, moves=ADDED),
    ]
    if not refit and all(one.best.model.name != MEASURED for one in starts):
        # One number that is far off may have found its place among those that are a little.
        starts.append(_explained(built, (), MEASURED, refit, shared, moves=ADDED))
    first = max(starts, key=lambda found: found.best.compared_with(starts[0].best).score)
    return replace(first, log=tuple(line for one in starts for line in one.log))


def _stated(problem: Problem) -> tuple[ActingEffect, ...]:
    """Return what the description states to act, at its stated size: gains scale it, too."""
    return tuple(
        ActingEffect(feature, _theta(feature, instance), _coefficients(feature, instance.parameters))
        for feature, instance in problem.known[: len(problem.stated)]
        if not feature.fixed and not isinstance(feature.effect, (SensorEffect, ControllerEffect))
    )


def _better(one: Explanation, other: Explanation) -> Explanation:
    """Return the more probable of two explanations, with the sets and the steps of both."""
    better, worse = (one, other) if one.best.score >= other.best.compared_with(one.best).score else (other, one)
    better.search.take((fit.compared_with(better.best) for fit in worse.search.met.values()), better.best)
    return replace(better, log=(*one.log, "elsewhere:", *other.log))


def _elsewhere(found: Explanation, tried: Set[frozenset[Key]]) -> Fit | None:
    """Return the likeliest set with a number more than an ordinary deviation from where the best one has it."""
    moving = _moving(found.linear.problem)
    sets = (
        fit
        for keys, fit in found.search.met.items()
        if fit.score > found.best.score - NEAR
        and keys not in tried
        and np.max(np.abs(fit.numbers - found.best.numbers)[moving], initial=0.0) > 1.0
    )
    return max(sets, key=lambda fit: fit.score, default=None)


def _descended(
    linear: Linearisation,
    before: Fit,
    refit: bool,
    shared: Shared,
    *,
    taken: tuple[Linearisation, Fit] | None = None,
    best: Fit | None = None,
) -> Explanation:
    """Return the most probable set, linearised at its own numbers, from one that was found at another linearisation.

    taken: a set that is known at its own linearisation; best: the most probable set known.

    Each set that a search finds is linearised for itself, and taken if it is not much less probable there than the one
    taken before; if it is, the next search may differ by half as many terms. Laws without a form and the moves that
    take long come once the set stays, as before they would fit the linearisation's error; not at all where a set stays
    that is less probable than the best one known.
    """
    log: list[str] = []
    moves, most = SIMPLE, MOST
    refused: dict[frozenset[Key], float] = {}
    previous = -np.inf
    for n in range(ROUNDS + 1):
        there, own = linear, before
        if taken is None or before.keys == taken[1].keys or _apart(linear, before, taken[1].numbers):
            there = _settled(linear, before, before.model.name)
            own = linear_model(there, before.model.name).fit(_again(before, there))
        known = own if taken is None else taken[1]
        score = own.compared_with(known).score
        worse = score < known.score - COMPARED
        stays = taken is not None and known.keys == own.keys
        if taken is None or not worse:
            taken, most = (there, own), MOST
        elif not stays:
            log.append(f"{n}: {score - known.score:+.1f} where it is linearised: {words_of(own, known)}")
            changed = len(own.keys ^ known.keys)
            if changed == 1 or most == 1:
                refused[own.keys] = score
            most = max(1, min(most, changed) // 2)
        if n == ROUNDS:
            break
        linear, last = taken
        found = _explained(
            linear, last.optional, last.model.name, refit, shared, moves=moves, most=most, refused=refused
        )
        log += [f"{n}: {line}" for line in found.log]
        before = found.best
        gains = max(before.score, score) > max(known.score, previous) + WORTH  # its nonlinear numbers move on
        previous = before.score
        if before.keys == last.keys and not gains and (stays or worse or not _far(before)):
            if moves == ALL or (best is not None and before.score < best.score + WORTH):
                break
            moves = ALL
        elif n == ROUNDS - 2:
            moves = ALL
    met = found.search.met
    if worse and not stays:  # A set that is not taken is no more probable than the last one, whatever it gains here.
        for keys in [keys for keys, fit in met.items() if fit.score > known.score + WORTH and keys != known.keys]:
            del met[keys]
    return replace(found, best=max(met.values(), key=lambda fit: fit.score, default=known), log=tuple(log))


def _settled(linear: Linearisation, before: Fit | None, trust: str) -> Linearisation:
    """Return the linearisation where the numbers are most probable beside a set, by Gauss and Newton."""
    if before is not None and _apart(linear, before):
        linear = _moved(linear, before)
    best: tuple[Linearisation, Fit] | None = None
    for _ in range(STEPS):
        if before is None and TRUST[trust].factor < EXACT:
            return linear
        model = linear_model(linear, trust)
        fit = model.fit([] if before is None else _again(before, linear))
        gain = np.inf if best is None else fit.compared_with(best[1]).score - best[1].score
        if best is not None and gain < -COMPARED:
            linear = _moved(best[0], best[1], share=0.3)  # too far
            best = None
            continue
        best = linear, fit
        if not _far(fit) or abs(gain) < WORTH:
            break
        linear = _moved(linear, fit)
    return linear if best is None else best[0]


def _moving(problem: Problem) -> NDArray[np.bool_]:
    """Return at which numbers' values (K,) the residuals are made."""
    return np.array([p.moves_model for p in problem.numbers], dtype=bool)


def _apart(linear: Linearisation, fit: Fit, numbers: Array | float = 0.0) -> bool:
    """Whether a fit needs a linearisation of its own: for its numbers, or for the effects that act in its torques."""
    acting = {one.feature.key for one in linear.acting}
    return _far(fit, numbers) or {one.feature.key for one in _acting(fit)} != acting


def _far(fit: Fit, numbers: Array | float = 0.0) -> bool:
    """Whether one of a fit's numbers is further from others, or from the linearisation, than its deviation."""
    steps = np.abs(fit.numbers - numbers) / np.sqrt(np.diag(fit.number_covariance))
    return bool(np.max(steps[fit.model.moving], initial=0.0) > 1.0)


def _moved(linear: Linearisation, fit: Fit, share: float = 1.0) -> Linearisation:
    """Return the linearisation a share of the way to where a fit puts the numbers."""
    limits = np.array([p.limit for p in linear.problem.numbers])
    there = np.clip(linear.values + share * fit.numbers, -limits, limits)
    return Linearisation(linear.problem, np.where(fit.model.moving, there, 0.0), _acting(fit), near=linear.motions)


def linear_model(linear: Linearisation, trust: str) -> LinearModel:
    """Return the data at a linearisation; made once."""
    if "model" not in linear.cache:
        linear.cache["model"] = LinearModel(
            linear.data.white,
            linear.numbers,
            Bands(linear.data),
            -linear.values,
            np.array([KINDS.index(p.kind) for p in linear.problem.numbers], dtype=int),
            _moving(linear.problem),
            tuple(known_terms(linear)[0]),
            linear.shares,
            trust,
            linear.data.density,
            linear.fitted_rows,
        )
    return linear.cache["model"].trusting(trust)


def _screens(linear: Linearisation, model: LinearModel, shared: Shared, *, laws: bool) -> list[Screen]:
    """Return what may be added, laws without a form apart."""
    found = [kept(shared.screens, linear, lambda: Screen(model.grams, pool_of(linear)), 2)]
    if laws:
        found.append(kept(shared.laws, linear, lambda: Screen(model.grams, _chosen_among(law_terms(linear))), 1))
    return found


def _explained(
    linear: Linearisation,
    start: Sequence[Term],
    trust: str,
    refit: bool,
    shared: Shared,
    *,
    moves: int,
    most: int = MOST,
    refused: Mapping[frozenset[Key], float] | None = None,
) -> Explanation:
    """Return the most probable set at a linearisation, from one to start from.

    most: terms by which it may differ; refused: sets that were not taken, with their scores where they are linearised.
    """
    trusts = {name: one for name, one in TRUST.items() if not (refit and name == MEASURED)}
    model, log = linear_model(linear, trust), []
    screens = _screens(linear, model, shared, laws=moves == ALL)
    terms = start
    # The trust in the description that is most probable beside the set, and the set beside it, until both stay.
    tried: dict[str, Search] = {}
    while trust not in tried:
        search = Search(linear, model.trusting(trust), screens, shared.thetas, refused or {})
        tried[trust], best = search, search.run(terms, moves=moves, most=most)
        log += [f"{trust}: {line}" for line in search.log]
        terms = best.optional
        scores = {
            name: model.trusting(name).fit(terms, best).score + float(np.log(one.prior)) for name, one in trusts.items()
        }
        trust = max(scores, key=lambda name: scores[name])
    search = tried[trust]
    best = search.run(terms if most == MOST else start, moves=moves, most=most)
    search.screens = ()
    model.grams.let_go()
    total = np.logaddexp.reduce(list(scores.values()))
    log.append(f"{trust}, {best.score:.1f}: {', '.join(f'{k[0]} {k[1]}' for k in best.keys) or 'nothing'}")
    shares = {k: float(np.exp(v - total)) for k, v in scores.items()}
    return Explanation(linear, search, best, shares, tuple(log))


def pool_of(linear: Linearisation) -> list[Term]:
    """Return the effects, numbers and stated effects that may be there."""
    problem = linear.problem
    kinds = (
        effect_terms(linear, linear.placed(problem.candidates)),
        number_terms(problem.numbers, linear.numbers, problem.far),
        known_terms(linear)[1],
    )
    return [t for terms in kinds for t in _chosen_among(terms)]


def _chosen_among(terms: Sequence[Term]) -> list[Term]:
    """Return terms of which each effect is as likely, and each of its places."""
    places: dict[str, set[Key]] = {}
    for t in terms:
        places.setdefault(t.key[0], set()).add(t.key)
    return [t.with_odds(float(np.log(len(places)) + np.log(len(places[t.key[0]])))) for t in terms]


def known_terms(linear: Linearisation) -> tuple[list[Term], list[Term]]:
    """Return the terms of known effects, and those by which stated ones may be far off; made once."""
    if "known" not in linear.cache:
        linear.cache["known"] = _known_terms(linear)
    known: tuple[list[Term], list[Term]] = linear.cache["known"]
    return known


def _known_terms(linear: Linearisation) -> tuple[list[Term], list[Term]]:
    problem, always, off = linear.problem, [], []
    for i, (feature, instance) in enumerate(problem.known):
        (feature,) = linear.placed([feature])
        theta = _theta(feature, instance)
        X = linear.columns(feature, theta)
        if feature.fixed:
            whole = X.sum(axis=1)
            always.append(
                Term(feature.key, "effect", X[:, :0], np.zeros(0), offset=whole, feature=feature, theta=theta)
            )
            continue
        std, _, _ = linear_prior(feature, problem.largest_at(feature.joint))
        if i >= len(problem.stated):
            always.append(Term(feature.key, "effect", X, std, feature=feature, theta=theta))
            continue
        mean = _coefficients(feature, instance.parameters)
        law = _whole(feature, instance)
        # Its columns are the law to first order alone: what is stated is known beyond.
        offset = None if law is None else linear.columns(*law).sum(axis=1) - X @ mean
        width = STATED * np.where(mean == 0.0, 1e-3 * std, np.abs(mean))
        term = Term(feature.key, "effect", X, width, mean=mean, feature=feature, theta=theta, trusted=True)
        always.append(replace(term, offset=offset, what=law))
        # Less than no friction would be a gain.
        bounded = all(p.least == 0.0 for p in feature.linear)
        low = -mean if bounded else np.full(len(mean), -np.inf)
        off.append(Term(feature.key, "stated", X, std, low=low, feature=feature, theta=theta))
    return always, off


def _theta(feature: Feature, instance: EffectInstance) -> tuple[float, ...]:
    return tuple(float(v) for p in feature.searched for v in np.atleast_1d(instance.parameters[p.name]))


def _whole(feature: Feature, instance: EffectInstance) -> tuple[Feature, tuple[float, ...]] | None:
    """Return the law at its stated numbers where it is not linear in them."""
    return (feature.whole(), _theta(feature.whole(), instance)) if feature.bends else None


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
    """Return the effects of a fit that act in the true torques: neither those of sensors nor those of controllers."""
    beside = (SensorEffect, ControllerEffect)
    acting = [t for t in fit.terms if t.kind in ("effect", "stated") and not isinstance(t.feature.effect, beside)]
    sizes = [np.ones(1) if t.feature.fixed else fit.beta(t)[: t.linear] for t in acting]
    return tuple(
        ActingEffect(t.feature, theta_of(t, fit), size, known=t in fit.model.always)
        for t, size in zip(acting, sizes, strict=True)
    )


def _again(fit: Fit, linear: Linearisation) -> list[Term]:
    """Return the terms of a fit at another linearisation; made once there for the same fit."""
    if linear.cache.get("again", (None,))[0] is fit:
        return list(linear.cache["again"][1])
    stated = {t.key: t for t in known_terms(linear)[1]}
    found = []
    for t in sorted(fit.optional, key=lambda t: t.kind == CHANGE):  # the sizes that change first
        if t.kind == "number":
            found.append(replace(t, columns=linear.numbers @ t.what))
        elif t.kind == "law":
            found.append(replace(t, columns=linear.data.whiten(t.what.plain(linear.data))))
        elif t.kind == CHANGE:
            common = (u for u in (*known_terms(linear)[0], *found) if u.key == t.what and u.kind != "stated")
            found += [change_of(linear, one) for one in common]
        elif t.kind == "stated":
            found.append(replace(t, columns=stated[t.key].columns))
        else:
            again = _effect_again(t, fit, linear)
            # Without the friction that it scales there is nothing of it.
            found += [again] if again.feature.friction or not again.feature.effect.scales_friction else []
    for k, t in enumerate(found):
        if t.tangents and t.feature.quadratic and t.feature.count == 1 and not t.feature.fixed:
            model = linear_model(linear, fit.model.name)
            found[k] = placed_anew(linear, model, t, [*found[:k], *found[k + 1 :]])
    linear.cache["again"] = fit, found
    return found


def _effect_again(t: Term, fit: Fit, linear: Linearisation) -> Term:
    """Return the term of an effect at another linearisation."""
    (feature,) = linear.placed([t.feature])
    feature = scaling(feature, linear.acting)
    if t.tangents:
        size = 1.0 if feature.fixed else float(fit.beta(t)[0])
        return tangent_term(linear, replace(t, feature=feature), theta_of(t, fit), size)
    X = linear.columns(feature, t.theta)
    if t.offset is not None:
        return replace(t, offset=X.sum(axis=1), feature=feature)
    return replace(t, columns=X[:, : t.count], feature=feature)
