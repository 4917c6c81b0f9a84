"""Whether recordings that were to be of one arm are of several, or of one that was changed between them.

No effect explains such recordings together, but numbers of the arm and of its known friction do that each recording has
for itself: what the whole leaves is then hardly there in any of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.recalibration import FinalFit
from elastic_arm.diagnosis.selection.gram_fits import regularised

Array = NDArray[np.float64]

RANK = 1e-9  # relative eigenvalue below which a combination of columns is not determined; numerical
WIDE = 1e3  # of a known effect's own size: prior standard deviation of how it differs; hardly any


@dataclass(frozen=True)
class Mixture:
    """Recordings that no one arm explains.

    Parameters
    ----------
    share
        Of what one arm leaves, that arms of their own take away.
    what, joint
        The number that differs most, in standard deviations.
    sources
        The recording in which it is another one than in the first.
    """

    share: float
    what: str
    joint: str
    sources: tuple[str, str]


def mixture(fit: FinalFit) -> Mixture | None:
    """Return in what recordings differ; None where one arm does for all of them, or several explain no more.

    Parameters
    ----------
    fit
        Residuals and columns beside everything that was found.
    """
    problem, library = fit.problem, fit.found.library
    given = list(fit.found.given)
    recordings = sorted({*problem.numbers[0], *problem.numbers[1]})
    if len(recordings) < 2:
        return None
    of_rows = fit.recordings_of_rows
    own = [k for k, p in enumerate(problem.parameters) if p.recording is None]
    names = [(problem.parameters[k].what, problem.parameters[k].joint) for k in own]
    names += [(c.feature.effect.id, c.feature.joint or "the whole arm") for c in given for _ in c.index]
    index = np.concatenate([np.zeros(1, dtype=int), *(candidate.index for candidate in given)])
    matrix = np.vstack([library.matrix(which, index) for which in (0, 1)])
    numbers = np.hstack([np.vstack(library.nuisance.white)[:, own], matrix[:, 1:]])
    priors = np.concatenate([np.ones(len(own)), np.full(len(index) - 1, WIDE**-2.0)])
    # Of all recordings in common, and what each further one has beside.
    columns = np.hstack([numbers, *(numbers * (of_rows == r)[:, None] for r in recordings[1:])])
    precision = np.tile(priors, len(recordings))
    centre = np.concatenate([library.nuisance.centre[own], np.zeros(columns.shape[1] - len(own))])
    gram = columns.T @ columns + np.diag(precision)
    values, stds = regularised(gram, columns.T @ matrix[:, 0] + precision * centre, RANK)
    alike = numbers @ _common(numbers, matrix[:, 0], priors, centre)
    before, after = (_mean_square(fit, matrix[:, 0] - found) for found in (alike, columns @ values))
    share = (before - after) / max(before - 1.0, 1e-12)
    if before <= problem.settings.search.bent or share < 1.0 - problem.settings.judgement.explained:
        return None
    apart = np.abs(values / (np.sqrt(max(after, 1.0)) * stds))[len(numbers.T) :]
    worst = int(np.argmax(apart))
    name, other = names[worst % len(names)], recordings[1 + worst // len(names)]
    return Mixture(share, *name, (problem.sources[recordings[0]], problem.sources[other]))


def _common(numbers: Array, residual: Array, priors: Array, centre: Array) -> Array:
    """Return the numbers (m,) that explain all recordings best together."""
    target = numbers.T @ residual + priors * centre[: len(priors)]
    return regularised(numbers.T @ numbers + np.diag(priors), target, RANK)[0]


def _mean_square(fit: FinalFit, left: Array) -> float:
    """Return the mean square of what is left in whitened rows, 1 for noise, whatever the scales of the rows."""
    library, scales = fit.found.library, fit.problem.scales
    if scales is not None:
        left = left * np.concatenate([np.repeat(scales, len(N) // len(scales)) for N in library.nuisance.white])
    return float(left @ left) / sum(data.freedom for data in library.sets)
