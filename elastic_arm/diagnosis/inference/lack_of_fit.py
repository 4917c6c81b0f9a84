"""LackOfFit that no cause of the catalogue explains: what a residual follows all the same.

An effect that the catalogue does not hold may be far too small to make a residual stand out of its noise by size, and
yet follow the rotor's angle, the sign of a velocity or the load as no noise does. Every regime's general columns are
fitted, at every place, on one data set and judged on the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.inference.regimes import bases
from elastic_arm.diagnosis.selection.gram_fits import first_row, orthonormal_basis
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings, RegimeSettings
from elastic_arm.estimation.band import LowPass
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]

RANK = 1e-6  # relative singular value below which a combination of columns is not determined; numerical
# A torque sensor's fault shows in the three equations that share it, with these signs, and in no single one.
SHARED = {"link": 1.0, "drive": 1.0, "motor": -1.0}

# Shapes of data, by side, joint, ratios and settings: each hypothesis is compared with the same ones.
_SHAPES: WeakKeyDictionary[WhitenedData, dict[tuple[object, ...], dict[str, list[Array]]]] = WeakKeyDictionary()


@dataclass(frozen=True)
class LackOfFit:
    """Where something is left, what it follows, and how sure that is.

    Parameters
    ----------
    row
        Number of the residual: side times joints plus joint.
    regime
        What it follows.
    gain
        Held-out log-likelihood of the regime's columns.
    rmse
        Nm, size of what follows the regime on the judging data.
    """

    row: int
    regime: str
    gain: float
    rmse: float


class LackOfFitTest:
    """What hypotheses leave that is not noise, be it too faint to show by its size.

    Parameters
    ----------
    library
        Of all columns.
    ratios
        r_hd and r_tot of every joint.
    settings
        Least log-likelihood, and what residuals are compared with.
    """

    def __init__(
        self, library: RegressorLibrary, ratios: Sequence[tuple[float, float]], settings: DiagnosisSettings
    ) -> None:
        self._library, self._ratios, self._settings = library, ratios, settings
        self._found: dict[tuple[Candidate, ...], list[LackOfFit]] = {}

    def __call__(self, selected: Sequence[Candidate]) -> list[LackOfFit]:
        """Return what candidates leave, strongest first; each set of candidates is worked out once."""
        key = tuple(selected)
        if key not in self._found:
            self._found[key] = lack_of_fit(self._library, selected, self._ratios, self._settings)
        found, detected = self._found[key], self._settings.significance.detected
        share = self._settings.judgement.trace_share
        shown = [one for one in found if one.gain > max(detected, share * found[0].gain)]
        if not len(self._library.nuisance):
            return shown
        # Beside nuisance parameters the noise is that of ordinary sensors, and follows angles a little.
        data = self._library.sets[1]
        noise = data.noise_std(LowPass(data.band.cutoff, data.band.kept_rate))
        return [one for one in shown if one.rmse > self._settings.significance.practical * noise[one.row]]


def lack_of_fit(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    ratios: Sequence[tuple[float, float]],
    settings: DiagnosisSettings,
) -> list[LackOfFit]:
    """Return what stands out of what the candidates leave, the strongest of each residual, strongest first.

    Parameters
    ----------
    library
        Of all columns.
    selected
        The candidates, fitted together on each data set.
    ratios
        r_hd and r_tot of every joint.
    settings
        The shapes that residuals are compared with, and how much of them nuisance parameters may hold.
    """
    left = [library.remainder(which, selected, library.fit(which, selected)) for which in (0, 1)]
    explained = [_Explained.by(library, selected, which, settings.search.held) for which in (0, 1)]

    def of_joint(joint: int) -> list[LackOfFit]:
        found: list[LackOfFit] = []
        shapes = {
            of: [shapes_of(data, of, joint, ratios[joint], settings.regimes) for data in library.sets]
            for of in ("link", "motor")
        }
        for side in (*library.sets[0].layout.sides, "sensor"):
            row = _row(library.sets[0], "link" if side == "sensor" else side, joint)
            thin = shapes["link" if side in ("link", "sensor") else "motor"]
            plain = [
                {regime: placed(data, side, joint, shapes) for regime, shapes in part.items()}
                for data, part in zip(library.sets, thin, strict=True)
            ]
            products = [
                _products(data, part, known, y)
                for data, part, known, y in zip(library.sets, plain, explained, left, strict=True)
            ]
            for regime in thin[0]:
                fits = [_least_squares(*own[regime]) for own in products]
                gain = sum(_gain(*products[which][regime], fits[1 - which]) for which in (0, 1))
                size = np.concatenate([part[:, row] @ fits[0] for part in plain[1][regime]])
                found.append(LackOfFit(row, regime, gain, float(np.sqrt(np.mean(size**2)))))
        return found

    return strongest(list(chain.from_iterable(share_out(of_joint, range(library.sets[0].layout.n)))))


def strongest(found: Sequence[LackOfFit]) -> list[LackOfFit]:
    """Return the strongest of each residual, strongest first."""
    kept: dict[int, LackOfFit] = {}
    for structure in sorted(found, key=lambda structure: -structure.gain):
        kept.setdefault(structure.row, structure)
    return list(kept.values())


def shapes_of(
    data: WhitenedData, of: str, joint: int, ratios: tuple[float, float], settings: RegimeSettings
) -> dict[str, list[Array]]:
    """Return shapes (N', k) in the band that depend on one side of a joint, by regime, one array a stretch; made once.

    Parameters
    ----------
    data
        Of a recording.
    of
        "link" or "motor".
    joint
        Its index.
    ratios
        r_hd and r_tot of the joint.
    settings
        The shapes.
    """
    made, key = _SHAPES.setdefault(data, {}), (of, joint, ratios, settings)
    if key not in made:
        found: dict[str, list[Array]] = {}
        for part in data.parts:
            for regime, columns in bases(part.signals, of, joint, data.layout.n, ratios, settings).items():
                found.setdefault(regime, []).append(data.band.apply(columns)[part.stretch.kept])
        made[key] = found
    return made[key]


def placed(data: WhitenedData, side: str, joint: int, shapes: Sequence[Array]) -> list[Array]:
    """Return shapes as columns (N', R, k) of the residuals in which a side of a joint shows, treated as those are.

    Parameters
    ----------
    data
        Of a recording.
    side
        "link", "drive", "motor", or "sensor" for all that share a torque sensor.
    joint
        Its index.
    shapes
        (N', k) of each stretch.
    """
    layout = data.layout
    columns = [np.zeros((thin.shape[1], layout.rows, len(thin))).T for thin in shapes]
    for name in layout.sides if side == "sensor" else (side,):
        sign = SHARED.get(name, 1.0) if side == "sensor" else 1.0
        for own, thin in zip(columns, shapes, strict=True):
            own[:, _row(data, name, joint)] = sign * thin
    return data.weighted(columns, in_place=True)


def _row(data: WhitenedData, side: str, joint: int) -> int:
    sides = data.layout.sides
    return (sides.index(side) if side in sides else 0) * data.layout.n + joint


def _numbers(selected: Sequence[Candidate]) -> NDArray[np.intp]:
    return np.concatenate([candidate.index for candidate in selected]) if selected else np.empty(0, dtype=int)


@dataclass(frozen=True, eq=False)
class _Explained:
    """What is explained already of the residuals of a data set.

    Parameters
    ----------
    basis
        (rows, m) orthonormal: of the columns of nuisance parameters, then of what candidates have beyond these.
    nuisance
        How many of them are of nuisance parameters.
    held
        Share of a shape's squares from which it is the nuisance parameters': what is left of it is the error of their
        linearisation.
    """

    basis: Array
    nuisance: int
    held: float

    @staticmethod
    def by(library: RegressorLibrary, selected: Sequence[Candidate], which: int, held: float) -> _Explained:
        """Return what nuisance parameters and candidates explain of one of the two data sets."""
        nuisance, further = library.nuisance.white[which], library.matrix(which, _numbers(selected))
        alone = orthonormal_basis(nuisance, RANK)
        own = further / np.maximum(np.linalg.norm(further, axis=0), 1e-300)
        for _ in range(2):  # once leaves rounding of what the nuisance parameters hold
            own = own - alone @ (alone.T @ own)
        basis = np.hstack([alone, orthonormal_basis(own[:, np.linalg.norm(own, axis=0) > RANK], RANK)])
        return _Explained(basis, alone.shape[1], held)

    def off(self, columns: Array) -> Array:
        """Return columns (rows, k) less what is explained of them; nothing where only errors would be left."""
        begin = first_row(columns)
        along = self.basis[begin:].T @ columns[begin:]
        left = columns - self.basis @ along
        squares = np.sum(columns**2, axis=0)
        held = np.sum(along[: self.nuisance] ** 2, axis=0) > self.held * squares
        left[:, held | (np.sum(left**2, axis=0) < RANK**2 * squares)] = 0.0
        return left


def _products(
    data: WhitenedData, shapes: Mapping[str, Sequence[Array]], explained: _Explained, y: Array
) -> dict[str, tuple[Array, Array]]:
    """Return products (k, k), (k,) of each regime's whitened shapes with each other and with y (rows,).

    Shapes less what is explained of them. All are made at one go.
    """
    together = [np.concatenate(parts, axis=2) for parts in zip(*shapes.values(), strict=True)]
    columns = explained.off(data.whiten(together))
    gram, target = columns.T @ columns, columns.T @ y
    ends = np.cumsum([parts[0].shape[2] for parts in shapes.values()])
    places = [slice(end - parts[0].shape[2], end) for end, parts in zip(ends, shapes.values(), strict=True)]
    return {regime: (gram[place, place], target[place]) for regime, place in zip(shapes, places, strict=True)}


def _least_squares(gram: Array, target: Array) -> Array:
    length = np.sqrt(np.diag(gram))
    scale = np.where(length > 0.0, length, np.inf)  # what does not act here has no coefficient
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    seen = values > RANK**2 * values[-1]
    vectors = vectors[:, seen] / np.sqrt(values[seen])
    return vectors @ (vectors.T @ (target / scale)) / scale


def _gain(gram: Array, target: Array, beta: Array) -> float:
    return float(beta @ target - 0.5 * beta @ gram @ beta)
