"""Structure that no cause of the catalogue explains: what a residual follows all the same.

An effect that the catalogue does not hold may be far too small to make a residual stand out of its noise by size, and
yet follow the rotor's angle, the sign of a velocity or the load as no noise does. Every regime's general columns are
fitted, at every place, on one data set and judged on the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.inference.regimes import bases
from elastic_arm.diagnosis.selection.regressor_library import Entry, RegressorLibrary
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]

RANK = 1e-6  # relative singular value below which a combination of columns says nothing
# A torque sensor's fault shows in the three equations that share it, with these signs, and in no single one.
SHARED = {"link": 1.0, "drive": 1.0, "motor": -1.0}


@dataclass(frozen=True)
class Structure:
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


def structures(
    bank: RegressorLibrary, entries: Sequence[Entry], ratios: Sequence[tuple[float, float]]
) -> list[Structure]:
    """Return what stands out of what the entries leave, the strongest of each residual, strongest first.

    Parameters
    ----------
    ratios
        r_hd and r_tot of every joint.
    """
    n = bank.sets[0].layout.n
    left = [bank.remainder(which, entries, bank.fit(which, entries)) for which in (0, 1)]
    explained = [_basis(bank.matrix(which, _numbers(entries))) for which in (0, 1)]
    found: list[Structure] = []
    for joint in range(n):
        shapes = {
            of: [_shapes(evidence, of, joint, ratios[joint]) for evidence in bank.sets] for of in ("link", "motor")
        }
        for side in (*bank.sets[0].layout.sides, "sensor"):
            row = _row(bank.sets[0], "link" if side == "sensor" else side, joint)
            thin = shapes["link" if side in ("link", "sensor") else "motor"]
            for regime in thin[0]:
                plain = [_placed(e, side, joint, part[regime]) for e, part in zip(bank.sets, thin, strict=True)]
                white = [
                    _without(evidence.whiten(part), known)
                    for evidence, part, known in zip(bank.sets, plain, explained, strict=True)
                ]
                fits = [_least_squares(w, y) for w, y in zip(white, left, strict=True)]
                gain = sum(_gain(white[which], left[which], fits[1 - which]) for which in (0, 1))
                size = np.concatenate([part[:, row] @ fits[0] for part in plain[1]])
                found.append(Structure(row, regime, gain, float(np.sqrt(np.mean(size**2)))))
    strongest: dict[int, Structure] = {}
    for structure in sorted(found, key=lambda structure: -structure.gain):
        strongest.setdefault(structure.row, structure)
    return list(strongest.values())


def _shapes(evidence: WhitenedData, of: str, joint: int, ratios: tuple[float, float]) -> dict[str, list[Array]]:
    """Return what depends on the "link" or "motor" of a joint (N', k) in the band, by regime, one array a stretch."""
    found: dict[str, list[Array]] = {}
    for part in evidence.parts:
        for regime, columns in bases(part.signals, of, joint, evidence.layout.n, ratios).items():
            found.setdefault(regime, []).append(evidence.band.apply(columns)[part.stretch.kept])
    return found


def _placed(evidence: WhitenedData, side: str, joint: int, shapes: Sequence[Array]) -> list[Array]:
    """Return shapes as columns (N', R, k) of the residuals in which a side of a joint shows."""
    layout = evidence.layout
    pattern = np.zeros(layout.rows)
    for name in layout.sides if side == "sensor" else (side,):
        pattern[_row(evidence, name, joint)] = SHARED.get(name, 1.0) if side == "sensor" else 1.0
    return [pattern[None, :, None] * thin[:, None, :] for thin in shapes]


def _row(evidence: WhitenedData, side: str, joint: int) -> int:
    sides = evidence.layout.sides
    return (sides.index(side) if side in sides else 0) * evidence.layout.n + joint


def _numbers(entries: Sequence[Entry]) -> NDArray[np.intp]:
    return np.concatenate([entry.index for entry in entries]) if entries else np.empty(0, dtype=int)


def _basis(columns: Array) -> Array:
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return u[:, s > RANK * s[0]]


def _without(columns: Array, known: Array) -> Array:
    """Return columns less what the entries' own hold of them; nothing where only rounding would be left."""
    left = columns - known @ (known.T @ columns)
    left[:, np.linalg.norm(left, axis=0) < RANK * np.linalg.norm(columns, axis=0)] = 0.0
    return left


def _least_squares(columns: Array, y: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    scale = np.where(length > 0.0, length, np.inf)  # what does not act here has no coefficient
    return np.linalg.lstsq(columns / scale, y, rcond=RANK)[0] / scale


def _gain(columns: Array, y: Array, beta: Array) -> float:
    predicted = columns @ beta
    return float(predicted @ y - 0.5 * predicted @ predicted)
