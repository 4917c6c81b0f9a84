"""Which table of a file is the derivative of which."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elastic_arm.recording.foreign.tables import JointTable, TimeArray
from elastic_arm.recording.sides import Array

# Above this correlation one array counts as the derivative of another.
ALIKE = 0.9
# Seconds over which differences and velocities are averaged before they are compared.
AVERAGED = 0.05


def integral(table: JointTable, candidates: Sequence[JointTable], times: TimeArray | None) -> JointTable | None:
    """Return the table whose derivative this one is, by correlation; None where there is none, or are no times."""
    if times is None:
        return None
    return next((c for c in candidates if c is not table and slope(c, table, times)[0] > ALIKE), None)


def integrals(tables: Sequence[JointTable], rates: Sequence[JointTable], times: TimeArray | None) -> list[JointTable]:
    """Return the tables of which a rate is the derivative, and which are the derivative of none of themselves."""
    sources = [t for t in tables if any(integral(rate, [t], times) for rate in rates if rate is not t)]
    return [t for t in sources if integral(t, sources, times) is None]


def is_no_rate(table: JointTable, positions: Sequence[JointTable], times: TimeArray | None) -> bool:
    """Return whether a table follows the derivative of no position, where there are such to compare with.

    That of a rotor follows the joint's, by the ratio.
    """
    return bool(positions) and times is not None and integral(table, positions, times) is None


def slope(source: JointTable, rate: JointTable, times: TimeArray) -> tuple[float, float]:
    """Return correlation and slope of a table's derivative over another table: medians over the moving joints."""
    width = max(round(AVERAGED * times.rate), 3)
    dt = np.maximum(np.gradient(times.seconds), 1e-9)[:, None]
    derivative = np.gradient(source.values, axis=0) / dt
    # Where angles wrap, the difference is no velocity.
    derivative[np.abs(derivative) > 50 * np.median(np.abs(derivative), axis=0) + 1e-12] = 0.0
    d, v = (_averaged(values, width) for values in (derivative, rate.values))
    power = np.sqrt((d * d).sum(axis=0) * (v * v).sum(axis=0))
    moving = power > 0
    if not moving.any():
        return 0.0, 0.0
    both = (d * v).sum(axis=0)[moving]
    return float(np.median(both / power[moving])), float(np.median(both / (v * v).sum(axis=0)[moving]))


def _averaged(values: Array, width: int) -> Array:
    total = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return (total[width:] - total[:-width]) / width
