"""Torque channels that are the model's torques but for a factor that no sensor has: a unit, a sign or a gear ratio."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.texts.notes import wrong_unit_note
from elastic_arm.effects.model import SensorEffect

Array = NDArray[np.float64]


def wrong_unit_notes(prepared: PreparedData, selected: Sequence[Candidate], rows_left: Collection[int]) -> list[str]:
    """Return a note on each torque channel of a joint that a gain which no sensor has would explain by itself.

    No search names such a gain, and without it a channel in another unit ends as a gap without any cause.

    Parameters
    ----------
    prepared
        Data and regressors.
    selected
        What counts as part of the model, and the causes: beside friction that is still to be found, any gain would do.
    rows_left
        Numbers of the residuals at which much is left.
    """
    before = _power(prepared, selected)
    notes = []
    for candidate in prepared.library.candidates:
        feature = candidate.feature
        if feature.joint is None or not isinstance(feature.effect, SensorEffect) or not feature.linear:
            continue
        parameter = feature.linear[0]
        if parameter.unit != "1" or not parameter.neutral:
            continue
        rows = [row for row, place in enumerate(prepared.places) if place in _places(candidate)]
        if not set(rows) & set(rows_left):
            continue
        others = [one for one in selected if one.feature.key != feature.key]
        gain = parameter.value_of(float(prepared.library.coefficients([*others, candidate])[-1][0]))
        left = _power(prepared, [*others, candidate])[rows] / before[rows]
        if (left < prepared.settings.judgement.explained).all() and not prepared.sizes.allows(
            feature, parameter, np.array([gain])
        ):
            notes.append(wrong_unit_note(feature, gain, float(1.0 - left.max())))
    return notes


def _places(candidate: Candidate) -> list[tuple[str, str]]:
    feature = candidate.feature
    return [(str(feature.joint), side) for side in feature.sides]


def _power(prepared: PreparedData, selected: Sequence[Candidate]) -> Array:
    """Return the sum of squares (R,) of what candidates leave of the validation data."""
    return np.sum([np.sum(part**2, axis=0) for part in prepared.library.validation_residuals(selected)], axis=0)
