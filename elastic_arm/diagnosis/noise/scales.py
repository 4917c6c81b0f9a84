"""How much more some joints and sides scatter than others, where a hypothesis leaves much more than noise.

What one joint lacks would otherwise decide on all others: as a common mean square it hides what takes far less of
theirs, and makes every deviation as large as its own. With a scale of its own each residual counts by what is left
there: generalized least squares with variances of groups, estimated from a first fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate

Array = NDArray[np.float64]


def noise_scales(prepared: PreparedData, hypothesis: Hypothesis) -> Array | None:
    """Return by how many times more each whitened row (R,) scatters than noise, beside the others.

    The mean square of what is left stays what it is. None where next to nothing is left, or of one size everywhere.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        The best hypothesis of the search.
    """
    library, settings, live = prepared.library, prepared.settings.search, prepared.validation.layout.live
    if misfit(library, hypothesis.selected) <= settings.bent:
        return None
    beta = library.fit(0, hypothesis.selected)
    left = [library.remainder(which, hypothesis.selected, beta).reshape(len(live), -1) for which in (0, 1)]
    squares = np.sum([np.sum(part**2, axis=1) for part in left], axis=0)
    # No row has less than noise alone.
    noise = sum(data.freedom for data in library.sets) / np.count_nonzero(live)
    before = prepared.calibration.scales
    power = np.maximum(squares / noise * (1.0 if before is None else before**2), 1.0)
    if np.max(power[live]) <= settings.unequal * np.median(power[live]):
        return None
    return np.where(live, np.sqrt(power / np.mean(power[live])), 1.0)


def mean_squares(prepared: PreparedData, selected: Sequence[Candidate]) -> Array:
    """Return the mean square (R,) of each residual of the validation data that candidates leave, Nm²."""
    return _mean_squares(prepared.library.validation_residuals(selected))


def leaves_more(found: Diagnosis, than: Array, ratio: float) -> bool:
    """Whether a diagnosis leaves more of the validation data than another hypothesis, joint by joint.

    Parameters
    ----------
    found
        With the residuals that its causes leave.
    than
        Mean squares (R,) of the other, from :func:`mean_squares`.
    ratio
        Of the mean squares, as a geometric mean over all joints and sides, from which it leaves more.
    """
    assert found.context is not None
    live = found.context.validate.layout.live
    left = _mean_squares(found.context.after)[live]
    return bool(np.exp(np.mean(np.log(left / than[live]))) > ratio)


def _mean_squares(residuals: Sequence[Array]) -> Array:
    return np.asarray(np.mean(np.concatenate(residuals) ** 2, axis=0))
