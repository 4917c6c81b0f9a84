"""Made-up regressions, small enough for dense formulas: places, octaves, numbers and terms."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.evidence.fit import LinearModel
from elastic_arm.evidence.grams import Bands
from elastic_arm.evidence.terms.term import Term

Array = NDArray[np.float64]

HARMONICS, RATE = 120, 20.0  # of one place, and Hz: 4 octaves and more


def bands(places: int = 2) -> Bands:
    """Return the bands of a whitened record of some places."""
    data: Any = SimpleNamespace(
        frequencies=np.repeat(np.arange(HARMONICS) * RATE / (2 * HARMONICS), 2),
        of_stretches=lambda values: np.repeat(values, 2 * HARMONICS),
        layout=SimpleNamespace(rows=places),
        shares=lambda: [np.ones((1, places))],
    )
    return Bands(data)


def term(name: str, X: Array, std: float | Array = 1.0, **more: Any) -> Term:
    """Return a term of these columns (rows,) or (rows, k)."""
    columns = X if X.ndim == 2 else X[:, None]
    return Term(
        (name, None, ()),
        columns,
        np.broadcast_to(std, columns.shape[1]).astype(float),
        **more,
    )


def model(y: Array, N: Array | None = None, **more: Any) -> LinearModel:
    """Return the data with the columns of some numbers, all trusted; none where they are not
    given."""
    N = np.zeros((len(y), 0)) if N is None else N
    count = N.shape[1]
    own = np.ones(count, dtype=bool)
    more = {
        "mean": np.zeros(count),
        "kinds": np.zeros(count, dtype=int),
        "moving": own,
        **more,
    }
    return LinearModel(y, N, bands(len(y) // (2 * HARMONICS)), **more)


def quiet(rng: np.random.Generator, places: int = 2) -> Array:
    """Return noise of less than its expected power: nowhere is more of it found than the sensors
    have."""
    return 0.5 * rng.standard_normal(2 * HARMONICS * places)
