"""An arm that is mounted otherwise than described: diagnosed as mounted, with the gap of the description.

Calibrated about another direction of gravity, masses and gains stand in for it. So the mounting is looked for before
anything else, the rest of the tilt is fitted beside all causes, and both together are the cause `base_tilt`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Cause
from elastic_arm.effects import EffectInstance, robot_effects
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.identification.batch.mounting import Mounting, other_mounting

Array = NDArray[np.float64]

STEP = 1e-4  # rad, of derivatives; numerical


def as_mounted(question: Question, observed: Sequence[Observation]) -> tuple[Question, Mounting | None]:
    """Return the question about the arm as its torques show it mounted, with that; as it is where they show nothing.

    Parameters
    ----------
    question
        What is asked; nothing is looked for where a tilt is known or stated, or may explain nothing.
    observed
        The recordings that causes are fitted on.
    """
    stated = (*robot_effects(question.robot, question.catalogue), *question.given)
    known = any(instance.effect.id == TILT for instance in stated)
    tilt = next((effect for effect in question.candidates if effect.id == TILT), None)
    if known or tilt is None:
        return question, None
    found = other_mounting(question.robot, question.model, [piece for one in observed for piece in one.pieces])
    if found is None:
        return question, None
    rest = EffectInstance(tilt, None, {"x": 0.0, "y": 0.0})
    return replace(question, robot=found.of(question.robot), given=(*question.given, rest)), found


def change_by_mounting(mounting: Mounting, tilt: Feature, data: WhitenedData) -> list[Array]:
    """Return what the residuals (N', R) of each stretch would have more, Nm, of the arm as it is described.

    Parameters
    ----------
    mounting
        As the torques show it.
    tilt
        The feature of the effect.
    data
        Residuals of the arm as mounted.
    """
    return [-columns.sum(axis=2) for columns in data.plain(tilt.whole(), mounting.undone)]


def cause_of_mounting(
    mounting: Mounting, tilt: Feature, rest: Mapping[str, ParameterEstimate], shrink: float, confidence: float
) -> Cause:
    """Return the whole tilt as a cause.

    Parameters
    ----------
    mounting, tilt
        As of :func:`change_by_mounting`.
    rest
        The tilt from there, as it was fitted beside everything else.
    shrink, confidence
        Of the cause.
    """
    small = np.array([rest["x"].value, rest["y"].value])
    std = np.array([rest["x"].std or 0.0, rest["y"].std or 0.0])
    values = mounting.tilted(*small)
    slopes = np.array([mounting.tilted(*(small + step)) for step in STEP * np.eye(2)]) - values
    stds = np.linalg.norm(slopes.T / STEP * std, axis=1)
    parameters = {
        name: ParameterEstimate(float(value), float(own), "rad")
        for name, value, own in zip("xy", values, stds, strict=True)
    }
    return Cause(
        effect=TILT,
        joint=None,
        sides=tilt.sides,
        regime=tilt.effect.regime,
        parameters=parameters,
        shrink=shrink,
        confidence=confidence,
        alternatives=(),
        instance=EffectInstance(tilt.effect, None, dict(zip("xy", values, strict=True))),
        refitted=True,
    )
