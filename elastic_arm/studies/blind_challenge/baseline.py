"""What a good engineer scripts in a day: base parameters by plain least squares, then effects one by one with BIC.

The same residuals and the same columns as those of the diagnosis, but neither whitening, priors nor nuisance
parameters: each equation is weighted by what the plain fit leaves of it. An effect is added while the Bayesian
information criterion falls (Schwarz 1978), and removed again where it would fall without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis import Question
from elastic_arm.diagnosis.data.common_equations import common_band
from elastic_arm.diagnosis.selection.candidates import feature_of, features
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.recording import Recording

Array = NDArray[np.float64]

GRID, VECTOR_GRID = 5, 3  # values of a searched parameter, and of each component of a vector
MOST = 12  # effects
EXPLAINED = 0.9  # of what the base parameters leave on motion that no fit has seen
RANK = 1e-5  # of the largest singular value: what no motion excites


@dataclass(frozen=True)
class _Trial:
    """An effect at values of its searched parameters, and where its columns stand."""

    feature: Feature
    searched: tuple[float, ...]
    columns: slice


def baseline_answer(identify: Recording, validate: Recording, question: Question) -> dict[str, Any]:
    """Return an answer with the fields that the score reads."""
    model = build_model(question.robot, question.model)
    equations = ArmEquations(question.robot, question.model)
    data = [_observed(recording, model, question) for recording in (identify, validate)]
    known = [feature for i in question.given if (feature := feature_of(i, equations)).acts]
    trials = _trials(features(equations, question.candidates), known)
    fits = [_stacked(one, model, known, trials) for one in data]
    scale = _scales(fits[0], data[0])
    y, base, columns = (_weighted(part, scale[0]) for part in fits[0])
    chosen = _stepwise(y[:, 0], base, columns, trials)
    return _answer(fits, scale, known, [trials[k] for k in chosen], data)


def _observed(recording: Recording, model: Model, question: Question) -> WhitenedData:
    observation = observe(recording.select(question.robot.joint_names))
    layout = EquationSet.direct(observation.pieces[0].recorded, model.n)
    band = common_band(layout, model, observation.rate, question.settings.preprocessing)
    return WhitenedData(model, [observation], layout, band)


def _trials(candidates: Sequence[Feature], known: Sequence[Feature]) -> list[_Trial]:
    """Return every effect at every place and some values of its searched parameters, but those that are known."""
    given, found, first = {feature.key for feature in known}, [], 0
    for feature in candidates:
        if feature.key in given or (feature.fixed and feature.effect.regressor is not None):
            continue
        for searched in product(*(_values(p) for p in feature.searched for _ in range(p.size))):
            found.append(_Trial(feature, searched, slice(first, first + feature.count)))
            first += feature.count
    return found


def _values(parameter: Any) -> list[float]:
    low, high = parameter.low, parameter.high
    if parameter.integer:
        return [float(k) for k in range(int(np.ceil(low)), min(int(high), int(np.ceil(low)) + GRID - 1) + 1)]
    spread = np.geomspace if parameter.logarithmic else np.linspace
    return [float(v) for v in spread(low, high, GRID if parameter.size == 1 else VECTOR_GRID)]


def _stacked(
    data: WhitenedData, model: Model, known: Sequence[Feature], trials: Sequence[_Trial]
) -> tuple[Array, Array, Array]:
    """Return residuals (N, R, 1), columns of base parameters and known effects, and columns of all trials (N, R, k)."""
    y = np.concatenate(data.y)[:, :, None]
    base = np.concatenate([_base_columns(part, data, model) for part in data.parts])
    base = np.concatenate([base, *(np.concatenate(data.plain(feature)) for feature in known)], axis=2)
    columns = [np.concatenate(data.plain(t.feature, t.searched)).astype(np.float32) for t in trials]
    return y, base, np.concatenate(columns, axis=2)


def _base_columns(part: Any, data: WhitenedData, model: Model) -> Array:
    """Derivatives (N', R, P) of the residuals by the model's own numbers, less sign."""
    motion, n, elastic = part.stretch.quiet, model.n, model.robot.elastic
    springs = [index for spring in model.bodies.springs for index in (spring.stiffness, spring.damping)]
    Phi = model.regressor(*(motion.coordinates(rate, elastic=elastic) for rate in ("", "d", "dd")))
    kept = [k for k in range(Phi.shape[2]) if k not in springs]
    full = np.zeros((len(motion), 3 * n, len(kept) + (2 * n if elastic else 0)))
    full[:, :n, : len(kept)] = Phi[:, :n, kept]
    if elastic:
        full[:, 2 * n :, : len(kept)] = Phi[:, n : 2 * n, kept]
        for j in range(n):
            full[:, n + j, len(kept) + j] = (motion.theta - motion.q)[:, j]
            full[:, n + j, len(kept) + n + j] = (motion.dtheta - motion.dq)[:, j]
    return data.in_band(part, full)


def _scales(fit: tuple[Array, Array, Array], data: WhitenedData) -> tuple[Array, float]:
    """Return the weight (R,) of each equation, and samples that count as one: neighbours in a band are alike."""
    y, base, _ = fit
    flat = base.reshape(-1, base.shape[2])
    left = y[:, :, 0] - (flat @ np.linalg.lstsq(flat, y.ravel(), rcond=RANK)[0]).reshape(y.shape[:2])
    return 1.0 / np.maximum(left.std(axis=0), 1e-12), data.band.kept_rate / (2 * data.band.cutoff)


def _weighted(part: Array, weights: Array) -> Array:
    return (part * weights[None, :, None]).reshape(-1, part.shape[2])


def _stepwise(y: Array, base: Array, columns: Array, trials: Sequence[_Trial]) -> list[int]:
    """Return the trials that lower the information criterion, in the order of their entrance."""
    Q, singular, _ = np.linalg.svd(base / np.maximum(np.linalg.norm(base, axis=0), 1e-300), full_matrices=False)
    Q = Q[:, singular > RANK * singular[0]]
    y = y - Q @ (Q.T @ y)
    X = columns - Q @ (Q.T @ columns)
    G, b = X.T @ X, X.T @ y
    N, rss = len(y), float(y @ y)
    chosen: list[int] = []
    refused: list[int] = []  # whose sizes no engineer would believe
    while len(chosen) < MOST:
        best = max(
            (k for k in range(len(trials)) if not _stands(trials, [*chosen, *refused], k)),
            key=lambda k: _gain(G, b, trials, [*chosen, k]),
            default=None,
        )
        if best is None or _bic(G, b, rss, N, trials, [*chosen, best]) >= _bic(G, b, rss, N, trials, chosen):
            break
        if not _believable(G, b, trials, [*chosen, best]):
            refused.append(best)
            continue
        chosen.append(best)
        for k in list(chosen[:-1]):
            rest = [c for c in chosen if c != k]
            if _bic(G, b, rss, N, trials, rest) < _bic(G, b, rss, N, trials, chosen):
                chosen = rest
    return chosen


def _stands(trials: Sequence[_Trial], chosen: Sequence[int], k: int) -> bool:
    """Whether the effect of a trial is chosen at its place already."""
    own = trials[k].feature
    return any(trials[c].feature.effect.id == own.effect.id and trials[c].feature.joint == own.joint for c in chosen)


def _gain(G: Array, b: Array, trials: Sequence[_Trial], chosen: Sequence[int]) -> float:
    """Return by how much effects lower the sum of squares."""
    at = _columns(trials, chosen)
    size = np.sqrt(np.maximum(np.diag(G)[at], 1e-300))
    scaled = G[np.ix_(at, at)] / size / size[:, None] + 1e-9 * np.eye(len(at))
    return float((b[at] / size) @ np.linalg.solve(scaled, b[at] / size)) if len(at) else 0.0


def _believable(G: Array, b: Array, trials: Sequence[_Trial], chosen: Sequence[int]) -> bool:
    """Whether the size of the effect that was added last lies within the range of its file."""
    at, trial = _columns(trials, chosen), trials[chosen[-1]]
    size = np.sqrt(np.maximum(np.diag(G)[at], 1e-300))
    scaled = G[np.ix_(at, at)] / size / size[:, None] + 1e-9 * np.eye(len(at))
    coefficients = (np.linalg.solve(scaled, b[at] / size) / size)[-trial.feature.count :]
    values = trial.feature.parameters([float(c) for c in coefficients], trial.searched)
    for p in trial.feature.linear:
        off = np.abs(np.atleast_1d(values[p.name]) - (p.neutral or 0.0))
        most = max(abs(p.low - (p.neutral or 0.0)), abs(p.high - (p.neutral or 0.0)))
        if (off > most).any() or (np.atleast_1d(values[p.name]) <= p.above).any():
            return False
    return True


def _bic(G: Array, b: Array, rss: float, N: int, trials: Sequence[_Trial], chosen: Sequence[int]) -> float:
    count = sum(trials[k].columns.stop - trials[k].columns.start + len(trials[k].searched) for k in chosen)
    return float(N * np.log(max(rss - _gain(G, b, trials, chosen), 1e-12 * rss) / N) + count * np.log(N))


def _columns(trials: Sequence[_Trial], chosen: Sequence[int]) -> list[int]:
    return [column for k in chosen for column in range(trials[k].columns.start, trials[k].columns.stop)]


def _answer(
    fits: Sequence[tuple[Array, Array, Array]],
    scale: tuple[Array, float],
    known: Sequence[Feature],
    chosen: Sequence[_Trial],
    data: Sequence[WhitenedData],
) -> dict[str, Any]:
    """Fit base parameters, known and chosen effects together, and write the answer."""
    at = [column for trial in chosen for column in range(trial.columns.start, trial.columns.stop)]
    y, whole = [], []
    for residual, base, columns in fits:
        y.append(_weighted(residual, scale[0])[:, 0])
        whole.append(np.hstack([_weighted(base, scale[0]), _weighted(columns[:, :, at], scale[0])]))
    size = np.maximum(np.linalg.norm(whole[0], axis=0), 1e-300)
    own = len(size) - len(at)
    U, singular, V = np.linalg.svd(whole[0] / size, full_matrices=False)
    used = singular > RANK * singular[0]
    inverse = (V[used].T / singular[used]) @ U[:, used].T
    coefficients = inverse @ y[0] / size
    left = y[0] - whole[0] @ coefficients
    variance = float(left @ left) / max(1.0, len(left) - len(size)) * scale[1]
    std = np.sqrt(variance * (inverse**2).sum(axis=1)) / size
    first = own - sum(feature.count for feature in known)
    fitted, place = [], first
    for feature, searched in [*((f, ()) for f in known), *((t.feature, t.searched) for t in chosen)]:
        part = slice(place, place + feature.count)
        fitted.append(_effect(feature, searched, coefficients[part], std[part]))
        place = part.stop
    before = [whole[1][:, :own] @ np.linalg.lstsq(whole[0][:, :own], y[0], rcond=RANK)[0], whole[1] @ coefficients]
    rss = [float(np.sum((y[1] - predicted) ** 2)) for predicted in before]
    shrink = 1.0 - rss[1] / rss[0]
    causes = fitted[len(known) :]
    verdict = "none" if not causes else "explained" if shrink >= EXPLAINED else "unknown"
    return {
        "verdict": verdict, "causes": causes, "known": fitted[: len(known)], "imperfections": [],
        "unexplained": [], "shrink": None if verdict == "none" else shrink, "measured_by": "excess",
        "log_likelihood": 0.0, "notes": [],
    }  # fmt: skip


def _effect(feature: Feature, searched: Sequence[float], coefficients: Array, std: Array) -> dict[str, Any]:
    """Return an effect as in `diagnosis.json`; by BIC whatever it takes in is as good as certain."""
    # Not as an instance: plain least squares may well find what no arm can have.
    values = feature.parameters([float(c) for c in coefficients], searched)
    stds = {p.name: s for p, s in zip(feature.linear, std, strict=False)} if feature.phase is None else {}
    parameters: dict[str, dict[str, Any]] = {}
    for p in feature.effect.parameters:
        value = values.get(p.name, p.default)
        deviation = float(stds[p.name]) if p.name in stds and p.size == 1 else None
        parameters[p.name] = {"value": value, "std": deviation if p.size == 1 else [None] * p.size, "unit": p.unit}
    for choice in feature.effect.choices:
        if choice.name != "side":
            chosen = feature.choices[choice.name]
            listed = list(chosen) if isinstance(chosen, tuple) else chosen
            parameters[choice.name] = {"value": listed, "std": None, "unit": ""}
    return {
        "effect": feature.effect.id, "joint": feature.joint, "sides": list(feature.sides), "parameters": parameters,
        "confidence": 0.99, "alternatives": [],
    }  # fmt: skip
