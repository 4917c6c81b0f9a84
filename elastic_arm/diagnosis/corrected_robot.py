"""The arm with its causes in it: what the simulator needs to behave like the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.result import Cause, Diagnosis
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.model import SensorEffect
from elastic_arm.robot import Robot


def repaired_robot(robot: Robot, diagnosis: Diagnosis) -> Robot:
    """Return the arm with the effects that the diagnosis found, besides those that counted as known.

    Where the model was refitted, its numbers are the refitted ones; else those of the description.

    A number beyond ordinary, a cause of its own, is among the refitted ones. What only stands in for something else is
    left out, and what a model variant has: take that variant. Known are those of the arm file and of the user, at the
    sizes that were fitted or, where no recorded equation shows them, as stated, and what is ordinary, such as lags of a
    sample; but not an ordinary drift, which is of the recording: a simulated zero would run away with it.
    """
    context = diagnosis.context
    known = robot.effects if context is None else _known(context)
    found = [cause.instance.to_dict() for cause in diagnosis.causes if cause.held_as == "effect"]
    numbers = robot if context is None else context.fitted.robot
    return numbers.with_(effects=(*known, *found))


def _known(context: DiagnosisContext) -> list[dict[str, Any]]:
    """Return what counts as part of the model, without ordinary drifts."""
    known = (*context.known, *context.unseen)
    return [instance.to_dict() for instance in known if instance.effect.ordinary is None or not _drifts(instance)]


def _drifts(instance: EffectInstance) -> bool:
    """Whether a sensor's error grows with time."""
    return isinstance(instance.effect, SensorEffect) and instance.effect.in_time


def holds_any(causes: Sequence[Cause]) -> bool:
    """Whether the corrected arm holds any of these causes, so that it is worth a file."""
    return any(cause.held_as in ("effect", "number") for cause in causes)


def deviations(diagnosis: Diagnosis) -> dict[tuple[str, str | None, str], float]:
    """Return the standard deviations of the causes' scalar parameters, by effect, joint and parameter."""
    return {
        (cause.effect, cause.joint, name): float(estimate.std)
        for cause in diagnosis.causes
        for name, estimate in cause.parameters.items()
        if np.ndim(estimate.std) == 0 and estimate.std is not None
    }
