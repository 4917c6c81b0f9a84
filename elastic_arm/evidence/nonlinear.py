"""Nonlinear numbers of laws, fitted by Gauss–Newton steps on the Gram matrices.

About theta_0 a law is X(theta_0) beta + beta_0 dX/dtheta (theta - theta_0). The derivatives are
additional columns, and the range of theta is the prior of their coefficients. The evidence of a set
is therefore Laplace's, and the nonlinear numbers add to the uncertainty of sizes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from elastic_arm.arrays import Array
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.evidence.fit import Fit, LinearModel
from elastic_arm.evidence.linearisation import Linearisation
from elastic_arm.evidence.priors import SCALES
from elastic_arm.evidence.screen import Screen
from elastic_arm.evidence.terms.effect import (
    EffectTerm,
    axis,
    components,
    monomial_columns,
    monomials,
    moved,
    tangent_term,
)
from elastic_arm.evidence.terms.term import Term

STEPS = 6  # largest number of Gauss–Newton steps
LONGEST = 0.25  # share of the range, largest step
# Scan of one number; numerical.
SCANNED = 25  # values over its range
DECIDED = 5  # of these, fitted
EVALUATIONS = 8  # evaluations between two of these
TINY = 1e-12  # numerical
NEVER = -1e30  # score out of bounds; numerical
CELLS = 500  # points of a grid over several numbers; numerical
PLACES = 120  # steps of the search from the best of them; numerical
SETTLED = 0.1  # standard deviations: a step below this counts as zero; numerical


def start_of(term: EffectTerm, fit: Fit) -> tuple[Feature, tuple[float, ...], float]:
    """Return the feature, nonlinear numbers and size at which the refinement of a term starts.

    fit: of a set with the term.
    """
    feature = term.feature
    beta = fit.beta(term)
    if np.isnan(
        term.theta
    ).any():  # linear in the size and in size times monomials, first those of single numbers
        size = float(beta[0]) if beta[0] else TINY
        own = components(feature)
        theta = [
            float(np.clip(b / size, p.low, p.high))
            for b, p in zip(beta[1 : 1 + len(own)], own, strict=True)
        ]
        return feature, tuple(theta), size
    if feature.bends:
        values = feature.parameters([float(b) for b in beta], term.theta)
        flat = np.concatenate([np.atleast_1d(values[p.name]) for p in feature.effect.parameters])
        inside = [
            float(np.clip(v, p.low, p.high))
            for v, p in zip(flat, components(feature.whole()), strict=True)
        ]
        return feature.whole(), tuple(inside), 1.0
    if feature.fixed:
        return feature, term.theta, 1.0
    return feature, term.theta, float(beta[0])


def refined(
    linear: Linearisation,
    model: LinearModel,
    term: EffectTerm,
    others: Sequence[Term],
    near: Fit,
    *,
    scan: bool,
) -> tuple[EffectTerm, Fit]:
    """Return a term with its most probable nonlinear numbers beside others, and the fit of all.

    scan: whether a single number is first scanned over its whole range.
    """
    first = model.fit([*others, term], near)
    feature, theta, size = start_of(term, first)
    start = replace(term, feature=feature)
    if feature is term.feature and len(theta) == 1 and scan:
        theta, size = _scanned(linear, model, term, others, first)
    if np.isnan(term.theta).any():
        start = start.scaled(1.0)  # a relaxed law has the scale of its first order
        theta, size = _placed(linear, model, start, model.fit(others, near), theta)
        start = start.scaled(
            float(min(SCALES, key=lambda s: abs(np.log(max(size, TINY) / (s * start.std[0])))))
        )
    best = tangent_term(linear, start, theta, size)
    fit = model.fit([*others, best], first)
    for _ in range(STEPS):
        step = _step(best, fit)
        if step is None:
            break
        better = None
        for share in (1.0, 0.3):
            there = [
                moved(p, v, share * s)
                for p, v, s in zip(linear.allowed(feature), best.theta, step, strict=True)
            ]
            size = best.size if feature.fixed else float(fit.beta(best)[0])
            one = tangent_term(linear, start, there, size)
            now = model.fit([*others, one], fit)
            if now.score > fit.score:
                better = one, now
                break
        if better is None:
            break
        gained = better[1].score - fit.score
        best, fit = better
        if gained < SETTLED:
            break
    return best, fit


def placed_anew(
    linear: Linearisation, model: LinearModel, term: EffectTerm, others: Sequence[Term]
) -> EffectTerm:
    """Return the term of a law of second degree in several numbers, at their most probable values
    beside other terms."""
    theta, size = _placed(linear, model, term, model.fit(others), term.theta)
    return tangent_term(linear, term, theta, size)


def _placed(
    linear: Linearisation,
    model: LinearModel,
    term: EffectTerm,
    near: Fit,
    relaxed: tuple[float, ...],
) -> tuple[tuple[float, ...], float]:
    """Return the most probable values of several nonlinear numbers and of the size beside a fit, at
    its noise.

    The law is of second degree in the numbers, so its column is V m(theta) with their monomials m.
    The products of V beside the fit (a Schur complement) give the gain of any theta.

    relaxed: numbers of the law that is linear in all monomials; the search starts from these and
    from the best point of a grid.
    """
    ranges = np.array([(p.low, p.high) for p in components(term.feature)])
    V = monomial_columns(linear, term.feature)
    whole = EffectTerm(term.key, V, np.ones(V.shape[1]), feature=term.feature, theta=(np.nan,))
    G, b = Screen(model.grams, [whole]).beside(near)
    variance = float(term.std[0]) ** 2

    def sizes_at(points: Array) -> tuple[Array, Array]:
        """Return the most probable size at each point (M, k), and the gains, nats."""
        m = monomials(points)
        energy = np.sum(m @ G * m, axis=1)
        curvature = 1.0 + variance * np.maximum(energy, 0.0)
        slope = m @ b
        size = variance * slope / curvature
        gain = 0.5 * size * slope - 0.5 * np.log(curvature)
        # Beyond the bounds of the mean, derivatives have the opposite sign.
        inside = (term.low[0] <= size) & (size <= term.high[0])
        return size, np.where(inside, gain, NEVER)

    grid = _grid(ranges)
    widths = np.diff(ranges, axis=1)[:, 0]
    found = []
    for start in (np.array(relaxed), grid[int(np.argmax(sizes_at(grid)[1]))]):
        inwards = np.diag(np.where(start > ranges.mean(axis=1), -0.1, 0.1) * widths)
        options = {
            "initial_simplex": start + np.vstack([np.zeros_like(start), inwards]),
            "maxfev": PLACES,
        }
        best = minimize(
            lambda at: -sizes_at(at[None])[1][0],
            start,
            method="Nelder-Mead",
            bounds=ranges,
            options=options,
        )
        found.append((-float(best.fun), tuple(best.x.tolist())))
    theta = max(found)[1]
    return theta, float(sizes_at(np.array([theta]))[0][0])


def _grid(ranges: Array) -> Array:
    """Return the centres (M, k) of equal cells that fill some ranges (k, 2)."""
    count = max(2, round(CELLS ** (1.0 / len(ranges))))
    middles = (np.arange(count) + 0.5) / count
    axes = [low + middles * (high - low) for low, high in ranges]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(ranges))


def _scanned(
    linear: Linearisation, model: LinearModel, term: EffectTerm, others: Sequence[Term], near: Fit
) -> tuple[tuple[float, ...], float]:
    """Return the most probable nonlinear number and size, by a scan over the range of the number.

    Far from its optimum, a law leaves so much that its slow part counts as noise, and derivatives
    see only its edges. The gain of each value beside the others proposes it, and the fits of the
    best values decide.
    """
    feature = term.feature
    (p,) = linear.allowed(term.feature)
    low, high = axis(p)
    prior = {name: getattr(term, name)[:1] for name in ("std", "mean", "low", "high")}
    values = np.linspace(low, high, SCANNED)

    def laws_at(places: Sequence[float]) -> list[EffectTerm]:
        thetas = [(float(np.exp(at)) if p.logarithmic else at,) for at in places]
        columns = np.split(linear.columns_at(feature, thetas), len(thetas), axis=1)
        return [
            replace(
                term,
                columns=X.copy("K"),
                theta=theta,
                tangents=(),
                ident=(*term.ident, theta),
                **prior,
            )
            for theta, X in zip(thetas, columns, strict=True)
        ]

    tried: list[tuple[float, tuple[float, ...], float]] = []

    def cost(one: EffectTerm) -> float:
        fit = model.fit([*others, one], near)
        size = float(fit.beta(one)[0])
        inside = one.low[0] <= size <= one.high[0]
        tried.append((fit.score if inside else NEVER, one.theta, size))
        return -tried[-1][0]

    scanned = laws_at(values.tolist())
    gains = Screen(model.grams, scanned).gains(model.fit(others, near))
    likeliest = np.argsort(-gains)[:DECIDED].tolist()
    best = min(likeliest, key=lambda k: cost(scanned[k]))
    bounds = values[max(best - 1, 0)], values[min(best + 1, SCANNED - 1)]
    minimize_scalar(
        lambda at: cost(laws_at([float(at)])[0]),
        bounds=bounds,
        method="bounded",
        options={"maxiter": EVALUATIONS},
    )
    _, theta, size = max(tried)
    return theta, 1.0 if feature.fixed else size


def _step(term: EffectTerm, fit: Fit) -> Array | None:
    """Return the step of each nonlinear number in its coordinate; None if all are settled."""
    if not term.tangents:
        return None
    beta = fit.beta(term)
    variance = np.diag(fit.covariance(term))
    own = components(term.feature)
    step = np.zeros(len(own))
    moves = False
    for k, j in enumerate(term.tangents):
        at = term.linear + k
        low, high = axis(own[j])
        step[j] = float(np.clip(beta[at], -LONGEST * (high - low), LONGEST * (high - low)))
        moves |= abs(step[j]) > SETTLED * float(np.sqrt(variance[at]))
    return step if moves else None
