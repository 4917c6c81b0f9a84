"""The diagnosis from recordings to result: where, which, how far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.data.preprocessing import needs_motion, standing, usable
from elastic_arm.diagnosis.data.split import independent, split
from elastic_arm.diagnosis.inference.model_refit import refitted
from elastic_arm.diagnosis.inquiry import Inquiry
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.candidates import feature_of, features
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary, build_library
from elastic_arm.dynamics import build_model
from elastic_arm.effects import EFFECTS, Effect, EffectInstance, robot_effects
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation, observe, widest_band
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot

Array = NDArray[np.float64]

ONE_ENCODER = 5.0  # Hz: above, the drives' deflection that a single encoder does not show changes the motion too much


@dataclass(frozen=True)
class Question:
    """What is asked of the recordings.

    Parameters
    ----------
    robot
        The nominal arm.
    model
        mod1, mod2 or mod3.
    refit
        Fit the model's own parameters first.
    given
        Effects that the user knows: like those of the arm file they count as part of the model, their sizes are fitted.
    effects
        The catalogue that may explain the gap.
    """

    robot: Robot
    model: str = "mod3"
    refit: bool = False
    given: tuple[EffectInstance, ...] = ()
    effects: tuple[Effect, ...] = field(default_factory=lambda: tuple(EFFECTS.values()))


def diagnose(recordings: Sequence[Recording], question: Question, validate: Sequence[Recording] = ()) -> Diagnosis:
    """Say where recordings and model part, which effects cause it, and how far the gap shrinks with them.

    Parameters
    ----------
    recordings
        What causes are fitted on.
    validate
        What judges them; the last third of the recordings where none is given.

    Raises
    ------
    DiagnosisError
        If nothing can be said: no torque, no motion, too short, validation equal to identification data.
    RecordingError
        If a recording lacks a joint.
    """
    names = question.robot.joint_names
    fitted, judging = split(*([usable(r.select(names)) for r in part] for part in (recordings, validate)))
    model = build_model(question.robot, question.model)
    seen = [[observe(r) for r in part] for part in (fitted, judging)]
    layout, band = _common(seen[0] + seen[1], model.n, elastic=model.robot.elastic)
    effects = question.effects
    if question.refit:
        model = refitted(model, seen[0], layout, band)
        # Of errors of the model's own parameters nothing is left.
        effects = tuple(e for e in effects if not e.model_parameter)
    identify, judge = (WhitenedData(model, part, layout, band) for part in seen)
    for part, data in zip(("fit", "judge"), (identify, judge), strict=True):
        if not data.parts:
            raise DiagnosisError(f"too little motion is left to {part} after filtering", "Record longer without gaps")
    equations = ArmEquations(question.robot, question.model)
    still = [joint for joint in names if all(joint in standing(r) for r in fitted)]
    able = [f for f in features(equations, effects) if f.joint not in still or not needs_motion(f)]
    library = build_library(identify, judge, able)
    known = (*robot_effects(question.robot), *question.given)
    given = [_given(library, equations, active) for active in known if feature_of(active, equations).acts]
    inquiry = Inquiry(model, library, given, (tuple(seen[0]), tuple(seen[1])), held_back=not validate)
    notes = list(dict.fromkeys(note for part in seen for o in part for note in o.notes))
    if question.refit:
        notes.append(
            "The model's own numbers were refitted; an arm file with the causes keeps those of the description "
            "(`elastic-arm identify` writes an arm that has them)."
        )
    notes += [f"{joint} stands still: nothing can be said of what its motion would show." for joint in still]
    return inquiry.answer(
        identify=tuple(r.source for r in fitted),
        validate=tuple(r.source for r in judging),
        independent_motion=independent(fitted, judging),
        notes=notes,
    )


def _common(observations: Sequence[Observation], n: int, *, elastic: bool) -> tuple[EquationSet, Band]:
    """Return equations and band that all recordings allow."""
    layouts = [EquationSet.direct(o.pieces[0].recorded, n) for o in observations]
    if any(layout.sides != layouts[0].sides for layout in layouts):
        raise DiagnosisError(
            "the recordings do not hold the same channels", "Diagnose those with equal channels together"
        )
    rate = min(o.rate for o in observations)
    if max(o.rate for o in observations) > 1.01 * rate:
        raise DiagnosisError("the recordings have different sample rates", "Diagnose those of one rate together")
    cutoff = widest_band(rate) if len(layouts[0].sides) > 1 or not elastic else min(widest_band(rate), ONE_ENCODER)
    return layouts[0], Band(cutoff, rate)


def _given(library: RegressorLibrary, equations: ArmEquations, active: EffectInstance) -> Candidate:
    feature = feature_of(active, equations)
    searched = np.concatenate([np.atleast_1d(active.parameters[p.name]) for p in feature.searched] or [np.zeros(0)])
    candidate = library.add(feature, tuple(float(v) for v in searched), fixed=feature.fixed)
    library.close()
    return candidate
