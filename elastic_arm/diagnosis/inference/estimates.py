"""The values of the causes' parameters, polished together, and how certain they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from elastic_arm.diagnosis.selection.library_building import scaling
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.tangents import STEP, component, free_components, scale_of
from elastic_arm.diagnosis.settings import JudgementSettings
from elastic_arm.effects.parameters import Parameter
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]

CACHED = 200  # columns kept: bounds the memory
TOGETHER = 32  # columns marginalised at once: bounds the memory
UNDETERMINED = 1e-9  # relative eigenvalue below which a combination of parameters does not act; numerical


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter with its standard deviation (None: not determined); several numbers for a vector."""

    value: Any
    std: Any
    unit: str


def polish(library: RegressorLibrary, selected: Sequence[Candidate], settings: JudgementSettings) -> list[Candidate]:
    """Bring all parameters of all causes to the joint least-squares optimum on the identification data.

    The search takes laws as linear in most parameters and optimises the others one by one; here every law is taken as
    it is. Integer orders stay.

    Parameters
    ----------
    library
        Of all columns; the polished candidates are added to it.
    selected
        The candidates.
    settings
        Clearance of physical bounds.
    """
    wholes = [
        _whole(library, candidate, beta, settings.bound_clearance) for candidate, beta in _rescaled(library, selected)
    ]
    library.close()
    problem = _JointFit(library, wholes, settings)
    if not problem.scales.size:
        return wholes
    bounds = (problem.lowest, np.inf)
    start = np.maximum(problem.start, problem.lowest + STEP)
    found = least_squares(problem.left, start, problem.slopes, max_nfev=8, xtol=1e-7, ftol=1e-10, bounds=bounds)
    if found.cost >= 0.5 * float(np.sum(problem.left(problem.start) ** 2)):
        return wholes
    polished = [
        library.add(candidate.feature, values, fixed=True)
        for candidate, values in zip(wholes, problem.values(found.x), strict=True)
    ]
    library.close()
    return polished


def estimates(
    library: RegressorLibrary, selected: Sequence[Candidate], settings: JudgementSettings
) -> list[dict[str, ParameterEstimate]]:
    """Return the parameters of polished causes with standard deviations.

    These are the larger of what the noise (times what is left beyond it) implies, and of what the scores of whole
    blocks of the recording imply, which sees errors that are coloured.

    Parameters
    ----------
    library
        Of all columns.
    selected
        Polished candidates.
    settings
        Clearance of physical bounds.
    """
    problem = _JointFit(library, selected, settings)
    data, left = library.sets[0], problem.left(problem.start)
    jacobian = problem.jacobian()
    length = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    unit = jacobian / length
    values, vectors = np.linalg.eigh(unit.T @ unit) if len(length) else (np.zeros(0), np.zeros((0, 0)))
    acts = values > UNDETERMINED * (values[-1] if len(values) else 0.0)
    inverse = (vectors[:, acts] / values[acts]) @ vectors[:, acts].T
    lost = np.sum(vectors[:, ~acts] ** 2, axis=1) > 1e-3
    spread = max(1.0, float(left @ left) / max(1.0, data.freedom - len(length)))
    by_blocks = np.diag(inverse @ _scatter(data, unit, left, len(length)) @ inverse)
    variance = np.maximum(np.maximum(spread * np.diag(inverse), by_blocks), 0.0)
    deviation = np.where(lost | (length <= 1e-300), np.nan, np.sqrt(variance) / length) * problem.scales
    return problem.named(deviation)


def certain(library: RegressorLibrary, selected: Sequence[Candidate], settings: JudgementSettings) -> list[bool]:
    """Whether each polished cause's parameters together differ from no effect (chi-square).

    Of a link's mass, centre and inertia perhaps none is known by itself, and yet some combination of them is. Each
    combination is as uncertain as the noise makes it, or as blocks of the recording do, whichever is more.

    Parameters
    ----------
    library
        Of all columns.
    selected
        Polished candidates.
    settings
        Level of the test.
    """
    problem = _JointFit(library, selected, settings)
    data, left, jacobian = library.sets[0], problem.left(problem.start), problem.jacobian()
    spread = max(1.0, float(left @ left) / max(1.0, data.freedom - jacobian.shape[1]))
    owner, away = np.array([k for k, _ in problem.free], dtype=int), problem.away()
    found = []
    for k in range(len(selected)):
        own, others = jacobian[:, owner == k], jacobian[:, owner != k]
        own = own - others @ np.linalg.lstsq(others, own, rcond=UNDETERMINED)[0]
        u, s, _ = np.linalg.svd(own, full_matrices=False)
        rank = int(np.sum(s**2 > UNDETERMINED * s[0] ** 2)) if len(s) else 0
        u = u[:, :rank]
        variance = np.maximum(spread, np.diag(_scatter(data, u, left, jacobian.shape[1])))
        shown = u.T @ (own @ away[owner == k])
        found.append(rank > 0 and float(np.sum(shown**2 / variance)) > chi2.ppf(settings.level, rank))
    return found


def _scatter(data: WhitenedData, columns: Array, left: Array, fitted: int) -> Array:
    """Return the covariance (k, k) of the scores on what is left, by whole blocks; `fitted` numbers are lost."""
    rows, scores = len(data.white), np.zeros((int(data.blocks.max()) + 1, columns.shape[1]))
    np.add.at(scores, data.blocks, data.in_time(columns[:rows]) * data.in_time(left[:rows, None]))
    if len(left) > rows:
        # The rows of the nuisance parameters' priors are a block of their own.
        scores = np.vstack([scores, left[rows:] @ columns[rows:]])
    return np.asarray(scores.T @ scores * (len(scores) / max(1, len(scores) - fitted)))


def several(estimate: dict[str, ParameterEstimate]) -> bool:
    """Whether a cause has more than one number to estimate."""
    return sum(np.size(e.value) for e in estimate.values() if not (np.ndim(e.std) == 0 and e.std == 0.0)) > 1


def differs(estimate: dict[str, ParameterEstimate], candidate: Candidate, level: float) -> bool:
    """Whether the interval of a cause's parameters excludes no effect; any of several numbers is enough.

    Parameters
    ----------
    estimate
        Of the candidate's parameters.
    candidate
        Its effect holds the values that mean no effect.
    level
        Probability of the interval.
    """
    quantile = float(norm.ppf(0.5 + 0.5 * level))
    checked = False
    for p in candidate.feature.effect.parameters:
        if p.neutral is None:
            continue
        checked = True
        values, stds = np.atleast_1d(estimate[p.name].value), np.atleast_1d(estimate[p.name].std)
        known = [s is not None for s in stds]
        if any(abs(v - p.neutral) > quantile * s for v, s, k in zip(values, stds, known, strict=True) if k):
            return True
    return not checked


def _rescaled(library: RegressorLibrary, selected: Sequence[Candidate]) -> list[tuple[Candidate, Array]]:
    """Return candidates and coefficients; what scales friction scales that which is fitted beside it."""
    fitted = list(zip(selected, library.coefficients(selected), strict=True))
    if not any(candidate.feature.effect.scales_friction for candidate in selected):
        return fitted
    acting = [ActingEffect(c.feature, c.searched or (), beta) for c, beta in fitted]
    again = []
    for candidate, _ in fitted:
        if candidate.feature.effect.scales_friction:
            candidate = library.add(scaling(candidate.feature, acting), candidate.searched, fixed=candidate.fixed)
        again.append(candidate)
    library.close()
    return list(zip(again, library.coefficients(again), strict=True))


def _whole(library: RegressorLibrary, candidate: Candidate, beta: Array, clearance: float) -> Candidate:
    """Return a cause as its law at the parameters that its columns' coefficients mean."""
    feature = candidate.feature
    whole = feature.whole()
    if whole is feature and candidate.fixed:
        return candidate
    values = feature.parameters([] if feature.fixed else [float(b) for b in beta], candidate.searched or ())
    parts = [np.maximum(np.atleast_1d(values[p.name]), _lowest(p, clearance)) for p in feature.effect.parameters]
    flat = np.concatenate(parts or [np.zeros(0)])
    return library.add(whole, tuple(float(v) for v in flat), fixed=True)


class _JointFit:
    """Least squares over all parameters of all causes, in units of their scales, around the present values."""

    def __init__(self, library: RegressorLibrary, selected: Sequence[Candidate], settings: JudgementSettings) -> None:
        self._library, self._selected = library, list(selected)
        self._y = library.marginalised(library.matrix(0, [0]), residual=True)[:, 0]
        self._cache: dict[tuple[int, tuple[float, ...]], Array] = {}
        # Where each free number stands: (candidate, component).
        self.free = [(k, j) for k, candidate in enumerate(selected) for j in free_components(candidate)]
        self.scales = np.array([scale_of(selected[k], j) for k, j in self.free])
        self.start = np.ones(len(self.free))
        clearance = settings.bound_clearance
        least = [_lowest(component(selected[k], j), clearance) for k, j in self.free]
        now = [(selected[k].searched or ())[j] for k, j in self.free]
        self.lowest = np.array([1.0 + (a - b) / s for a, b, s in zip(least, now, self.scales, strict=True)])

    def away(self) -> Array:
        """Return how far (numbers,) each free number is from no effect, in units of its scale."""
        found = []
        for (k, j), scale in zip(self.free, self.scales, strict=True):
            candidate = self._selected[k]
            neutral = component(candidate, j).neutral
            # A phase, a speed, a position: no value of it means no effect.
            found.append(0.0 if neutral is None else ((candidate.searched or ())[j] - neutral) / scale)
        return np.array(found)

    def values(self, z: Array) -> list[tuple[float, ...]]:
        """Return the parameters of all causes."""
        moved = [list(candidate.searched or ()) for candidate in self._selected]
        for (k, j), scale, value in zip(self.free, self.scales, z, strict=True):
            moved[k][j] += scale * (value - 1.0)
        return [tuple(float(v) for v in values) for values in moved]

    def left(self, z: Array) -> Array:
        """Return the whitened remainder (rows,)."""
        remainder = self._y.copy()
        for k, values in enumerate(self.values(z)):
            remainder -= self._column(k, values)
        return remainder

    def slopes(self, z: Array) -> Array:
        """Return the derivative (rows, numbers) of the remainder by forward differences."""
        steps = STEP * np.where(z == 0.0, 1.0, z)
        steps = np.where(z + steps < self.lowest, -steps, steps)
        ends = z + np.diag(steps)
        self._evaluate(ends)
        here = self.left(z)
        return np.stack([(self.left(end) - here) / (end[i] - z[i]) for i, end in enumerate(ends)], axis=1)

    def jacobian(self) -> Array:
        """Return the derivative (rows, numbers) of what the causes explain."""
        steps = STEP * np.eye(len(self.free))
        below, above = self.start - steps, self.start + steps
        self._evaluate([*below, *above])
        columns = [(self.left(low) - self.left(high)) / (2 * STEP) for low, high in zip(below, above, strict=True)]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self._y), 0))

    def _evaluate(self, points: Sequence[Array] | Array) -> None:
        """Make the columns of the causes at several values of their numbers, and marginalise them at one go."""
        self._forget()
        wanted = {(k, values) for z in points for k, values in enumerate(self.values(z))}
        missing = [key for key in sorted(wanted) if key not in self._cache]
        for first in range(0, len(missing), TOGETHER):
            keys = missing[first : first + TOGETHER]
            self._cache.update(zip(keys, self._marginalised(keys).T, strict=True))

    def named(self, deviation: Array) -> list[dict[str, ParameterEstimate]]:
        """Return all parameters by name, with these standard deviations (numbers,); nan where not determined."""
        stds: dict[tuple[int, int], float | None] = {
            place: (float(d) if np.isfinite(d) else None) for place, d in zip(self.free, deviation, strict=True)
        }
        found = []
        for k, candidate in enumerate(self._selected):
            values, j, own = candidate.searched or (), 0, {}
            feature = candidate.feature
            for p in feature.effect.parameters if len(values) else ():
                part = [float(v) for v in values[j : j + p.size]]
                spread = [stds.get((k, j + i), 0.0) for i in range(p.size)]
                own[p.name] = (
                    ParameterEstimate(part[0], spread[0], feature.unit(p))
                    if p.size == 1
                    else ParameterEstimate(part, spread, feature.unit(p))
                )
                j += p.size
            found.append(own)
        return found

    def _column(self, k: int, values: tuple[float, ...]) -> Array:
        key = (k, values)
        if key not in self._cache:
            self._forget()
            self._cache[key] = self._marginalised([key])[:, 0]
        return self._cache[key]

    def _forget(self) -> None:
        if len(self._cache) > CACHED:
            self._cache.clear()

    def _marginalised(self, keys: Sequence[tuple[int, tuple[float, ...]]]) -> Array:
        """Return what causes add to the residual (rows, keys) at these numbers, the nuisance marginalised."""
        columns = [self._library.columns(0, self._selected[k].feature, values).sum(axis=1) for k, values in keys]
        return self._library.marginalised(np.stack(columns, axis=1))


def _lowest(parameter: Parameter, clearance: float) -> float:
    """Smallest value that an estimate may take: physics allows no less."""
    neutral = parameter.neutral or 0.0
    if np.isfinite(parameter.above):
        return parameter.above + clearance * abs(neutral - parameter.above)
    return 0.0 if parameter.low > 0.0 and neutral == 0.0 else -np.inf


@dataclass(frozen=True)
class RecordingEstimate:
    """A cause in one recording.

    Parameters
    ----------
    source
        The recording.
    parameters
        Refitted there, with standard deviations.
    gain
        Log-likelihood that the cause gains there beside the others.
    """

    source: str
    parameters: Mapping[str, ParameterEstimate]
    gain: float


@dataclass(frozen=True)
class Agreement:
    """A cause over several recordings.

    Parameters
    ----------
    effect, joint
        The cause.
    findings
        One a recording.
    chi_square, freedom, probability
        Of the parameter that agrees least: its scatter over its variances, the degrees of freedom, and the probability
        of as much by chance (for as many parameters as were looked at). None where none can be compared.
    spread
        Largest distance of a value from the mean, as a share of the effect's size.
    agrees
        Whether the cause is there in every recording, of one size as far as they determine it.
    comparable
        Whether single recordings determine the size well enough for that to mean something.
    odds
        Of sizes that differ by a good part of themselves against nearly one size; 0 where it agrees.
    """

    effect: str
    joint: str | None
    findings: tuple[RecordingEstimate, ...]
    chi_square: float | None
    freedom: int
    probability: float | None
    spread: float | None
    agrees: bool
    comparable: bool = True
    odds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "effect": self.effect,
            "joint": self.joint,
            "agrees": self.agrees,
            "comparable": self.comparable,
            "chi_square": _rounded(self.chi_square),
            "degrees_of_freedom": self.freedom,
            "probability": _rounded(self.probability),
            "spread": _rounded(self.spread),
            "recordings": [
                {
                    "recording": f.source,
                    "parameters": {
                        name: {"value": _rounded(e.value), "std": _rounded(e.std), "unit": e.unit}
                        for name, e in f.parameters.items()
                    },
                    "log_likelihood": _rounded(f.gain),
                }
                for f in self.findings
            ],
        }


def _rounded(value: Any) -> Any:
    if value is None:
        return None
    if isinstance(value, list | tuple):
        return [_rounded(v) for v in value]
    return float(f"{float(value):.5g}") if np.isfinite(value) else None
