"""Rows where a joint sticks: its dry friction takes any value there, which no law of friction states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.estimation.residuals import AROUND, stuck_rows
from elastic_arm.estimation.whitening import EDGE, WhitenedData


def sticking_misfits(prepared: PreparedData, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis with friction leaves much more where a joint sticks than elsewhere.

    An arm whose friction follows its law at any speed leaves no more there, and all its rows count.

    Parameters
    ----------
    prepared
        Data with all rows.
    hypothesis
        The known effects and the causes.
    """
    library, selected = prepared.library, hypothesis.selected
    if prepared.calibration.sticking_removed or not any(candidate.feature.effect.friction for candidate in selected):
        return False
    sticks = sticking_rows(library.sets[0])
    if sticks.all() or not sticks.any():
        return False
    left = library.remainder(0, selected, library.fit(0, selected))
    squares = library.sets[0].in_time(left[:, None])[:, 0] ** 2
    return bool(squares[sticks].mean() > prepared.settings.preprocessing.sticking * squares[~sticks].mean())


def sticking_rows(data: WhitenedData) -> NDArray[np.bool_]:
    """Return which instants (instants,) of whitened residuals hold the friction of a joint that sticks."""
    around = AROUND + 1.0 / data.band.cutoff
    return in_whitened_order([stuck_rows(part.stretch, data.layout, around) for part in data.parts])


def in_whitened_order(values: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return values (N', R, …) of all stretches in the order of :meth:`WhitenedData.in_time`, (instants, …)."""
    inner = np.concatenate([part[EDGE:-EDGE] for part in values])
    return inner.swapaxes(0, 1).reshape(-1, *inner.shape[2:])
