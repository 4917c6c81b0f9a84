"""Torque channels that are the model's torques but for a factor that no sensor has: a unit, a sign or a gear ratio."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.texts.notes import wrong_unit_note
from elastic_arm.effects import robot_effects
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.described_gravity import CHANCE, opposed_joints
from elastic_arm.recording.inspection.outliers import without_outliers

Array = NDArray[np.float64]


def wrong_unit_notes(prepared: PreparedData, selected: Sequence[Candidate], rows_left: Collection[int]) -> list[str]:
    """Return a note on each torque channel of a joint that a gain which no sensor has would explain by itself.

    No search names such a gain, and without it a channel in another unit ends as a gap without any cause.

    Parameters
    ----------
    prepared
        Data and regressors.
    selected
        What counts as part of the model, and the causes.
    rows_left
        Numbers of the residuals at which much is left.
    """
    notes, library, live = [], prepared.library, prepared.validation.layout.live

    def rows_of(feature: Feature) -> list[int]:
        return [row for row, place in enumerate(prepared.places) if place in _places(feature) and live[row]]

    for candidate in library.among(lambda feature: _is_gain(feature) and bool(set(rows_of(feature)) & set(rows_left))):
        feature = candidate.feature
        parameter, rows = feature.linear[0], rows_of(feature)
        others = [one for one in selected if one.feature.key != feature.key]
        # In the place of friction that is still to be found any gain would do.
        others += _frictions(prepared, str(feature.joint), others)
        gain = parameter.value_of(float(library.coefficients([*others, candidate])[-1][0]))
        before, after = (_squares(library.validation_residuals(own)) for own in (others, [*others, candidate]))
        # A torque divided by a hundred leaves little, whatever it is: less than what it then is has to be left.
        torque = _squares([part[:, :, 0] for part in prepared.validation.plain(feature, ())]) / gain**2
        most = np.minimum(before, torque)[rows]
        is_explained = (after[rows] < prepared.settings.judgement.explained * most).all()
        if is_explained and not prepared.sizes.allows(feature, parameter, np.array([gain])):
            notes.append(wrong_unit_note(feature, gain, float(1.0 - np.max(after[rows] / most))))
    return notes


def beside_wrong_signs(found: Diagnosis, recordings: Sequence[Recording], question: Question) -> Diagnosis:
    """Return a diagnosis whose causes stand in for torques of the wrong sign where the described gravity shows one.

    A spring that pulls twice as hard as gravity, the other way, explains nearly all of such a torque, and leaves what
    it does not. One that is there leaves nothing: then the torque is as it should be. So is that of joints at which a
    load is known, and of an arm that is known, or was found, to be mounted otherwise.

    Parameters
    ----------
    found
        The diagnosis.
    recordings
        That causes were fitted on.
    question
        Arm and known effects.
    """
    known = (*robot_effects(question.robot, question.catalogue), *question.given)
    loads = [one for one in known if one.effect.sides == ("link",) and not one.effect.is_friction]
    tilted = any(one.effect.id == TILT for one in loads) or any(c.effect == TILT and c.refitted for c in found.causes)
    if found.verdict != "unknown" or tilted:
        return found
    opposed = {joint for one in recordings for joint in opposed_joints(without_outliers(one), question.robot)}
    opposed -= {one.joint for one in loads}
    # One sign is mostly that of all joints: where one of them leaves something, the causes of all are in doubt.
    if not opposed & {one.joint for one in found.unexplained}:
        return found
    causes = [one.against(1.0 / CHANCE) if one.joint is None or one.joint in opposed else one for one in found.causes]
    return replace(found, causes=tuple(causes))


def _frictions(prepared: PreparedData, joint: str, beside: Sequence[Candidate]) -> list[Candidate]:
    """Return the frictions of a joint that are linear in all their numbers, but for those that are there."""
    keys = {one.feature.key for one in beside}

    def is_wanted(feature: Feature) -> bool:
        own = feature.joint == joint and feature.key not in keys
        return own and feature.effect.is_friction and not feature.searched

    return prepared.library.among(is_wanted)


def _is_gain(feature: Feature) -> bool:
    """Whether a feature is the gain of a sensor at a joint."""
    if feature.joint is None or not isinstance(feature.effect, SensorEffect) or not feature.linear:
        return False
    parameter = feature.linear[0]
    return parameter.unit == "1" and bool(parameter.neutral)


def _places(feature: Feature) -> list[tuple[str, str]]:
    return [(str(feature.joint), side) for side in feature.sides]


def _squares(parts: Sequence[Array]) -> Array:
    """Return the squares (R,) about their means of what stretches (N', R) hold.

    A constant is a zero that is off: where the torque hardly changes, any gain would explain it.
    """
    return np.sum([len(part) * np.var(part, axis=0) for part in parts], axis=0)
