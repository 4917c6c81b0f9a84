"""Recordings and a question become two sets of whitened residuals and a library of regressors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from elastic_arm.diagnosis import format as texts
from elastic_arm.diagnosis.data.preprocessing import needs_motion, standing, usable
from elastic_arm.diagnosis.data.split import independent, split
from elastic_arm.diagnosis.inference.model_refit import refitted
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.selection.candidates import feature_of, features
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary, build_library
from elastic_arm.diagnosis.settings import DiagnosisSettings, PreprocessingSettings
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects import EffectInstance, robot_effects
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.errors import DiagnosisError
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import Observation, observe, widest_band
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.recording import Recording

Observations = tuple[Observation, ...]


@dataclass(frozen=True)
class PreparedData:
    """What search and judgement work on.

    Parameters
    ----------
    model
        The nominal model, or the refitted one.
    library
        The columns of all candidates on identification and validation data.
    given
        Candidates that count as part of the model: effects of the arm file and of the user.
    observed
        The recordings, observed, that causes are fitted on, and those that judge.
    sources
        Where the recordings of either part come from.
    held_back
        Whether the last third of each recording judges.
    independent_motion
        Whether the validation motion is another one.
    notes
        What the reader should know of the data.
    settings
        All thresholds.
    """

    model: Model
    library: RegressorLibrary
    given: tuple[Candidate, ...]
    observed: tuple[Observations, Observations]
    sources: tuple[tuple[str, ...], tuple[str, ...]]
    held_back: bool
    independent_motion: bool
    notes: tuple[str, ...]
    settings: DiagnosisSettings

    @property
    def validation(self) -> WhitenedData:
        """The data that judge."""
        return self.library.sets[1]

    @property
    def rate(self) -> float:
        """Highest sample rate of the identification data, Hz."""
        return max(o.rate for o in self.observed[0])

    @property
    def places(self) -> list[tuple[str, str]]:
        """Joint and side of each residual."""
        return [(joint, side) for side in self.validation.layout.sides for joint in self.model.robot.joint_names]

    def gear_ratios(self, row: int) -> tuple[float, float]:
        """Return r_hd and r_tot of the joint to which a residual belongs."""
        gear = self.model.robot.joints[row % self.model.n].transmission
        return (gear.harmonic_drive_ratio, gear.r_tot) if gear else (1.0, 1.0)


def prepare(recordings: Sequence[Recording], validate: Sequence[Recording], question: Question) -> PreparedData:
    """Split, observe and whiten the recordings, and evaluate every candidate on them.

    Parameters
    ----------
    recordings
        What causes are fitted on.
    validate
        What judges them; the last third of the recordings where none is given.
    question
        Arm, model, known effects and catalogue.

    Raises
    ------
    DiagnosisError
        If the recordings allow no diagnosis: no torque, no motion, too short, validation equal to identification data.
    RecordingError
        If a recording lacks a joint.
    """
    names, settings = question.robot.joint_names, question.settings
    selected = [[usable(r.select(names), settings.preprocessing) for r in part] for part in (recordings, validate)]
    parts = split(selected[0], selected[1], settings.split)
    observed = [[observe(r) for r in part] for part in parts]
    model, whitened = _whitened(question, observed)
    still = [joint for joint in names if all(joint in standing(r) for r in parts[0])]
    equations = ArmEquations(question.robot, question.model)
    library = build_library(*whitened, _candidates(question, equations, still), settings.candidates)
    known = (*robot_effects(question.robot, question.catalogue), *question.given)
    given = [_given(library, equations, active) for active in known if feature_of(active, equations).acts]
    notes = list(dict.fromkeys(note for part in observed for o in part for note in o.notes))
    notes += [texts.REFITTED] if question.refit else []
    notes += [texts.standing_note(joint) for joint in still]
    return PreparedData(
        model=model,
        library=library,
        given=tuple(given),
        observed=(tuple(observed[0]), tuple(observed[1])),
        sources=(tuple(r.source for r in parts[0]), tuple(r.source for r in parts[1])),
        held_back=not validate,
        independent_motion=independent(*parts, settings.split),
        notes=tuple(notes),
        settings=settings,
    )


def _whitened(
    question: Question, observed: Sequence[Sequence[Observation]]
) -> tuple[Model, tuple[WhitenedData, WhitenedData]]:
    """Return the model, refitted if asked for, and the whitened residuals of both parts."""
    model = build_model(question.robot, question.model)
    settings = question.settings
    layout, band = _common([*observed[0], *observed[1]], model, settings.preprocessing)
    if question.refit:
        model = refitted(model, observed[0], layout, band, settings.refit)
    identify, judge = (WhitenedData(model, part, layout, band) for part in observed)
    for purpose, data in (("fit", identify), ("judge", judge)):
        if not data.parts:
            raise DiagnosisError(
                f"too little motion is left to {purpose} after filtering", "Record longer without gaps"
            )
    return model, (identify, judge)


def _common(
    observations: Sequence[Observation], model: Model, settings: PreprocessingSettings
) -> tuple[EquationSet, Band]:
    """Return equations and band that all recordings allow."""
    layouts = [EquationSet.direct(o.pieces[0].recorded, model.n) for o in observations]
    if any(layout.sides != layouts[0].sides for layout in layouts):
        raise DiagnosisError(
            "the recordings do not hold the same channels", "Diagnose those with equal channels together"
        )
    rate = min(o.rate for o in observations)
    if max(o.rate for o in observations) > settings.rate_tolerance * rate:
        raise DiagnosisError("the recordings have different sample rates", "Diagnose those of one rate together")
    return layouts[0], common_band(layouts[0], model, rate, settings)


def common_band(layout: EquationSet, model: Model, rate: float, settings: PreprocessingSettings) -> Band:
    """Return the band in which residuals are compared.

    Parameters
    ----------
    layout
        Usable equations.
    model
        The nominal model.
    rate
        Hz, of the recordings.
    settings
        Upper edge where only one encoder is recorded.
    """
    widest = widest_band(rate)
    one_encoder = len(layout.sides) == 1 and model.robot.elastic
    return Band(min(widest, settings.one_encoder_band) if one_encoder else widest, rate)


def _candidates(question: Question, equations: ArmEquations, still: Sequence[str]) -> list[Feature]:
    """Return every effect at every place where the motion can show it."""
    return [f for f in features(equations, question.candidates) if f.joint not in still or not needs_motion(f)]


def _given(library: RegressorLibrary, equations: ArmEquations, active: EffectInstance) -> Candidate:
    """Return a known effect as a candidate, at the values of its nonlinear parameters that were given."""
    feature = feature_of(active, equations)
    values = [np.atleast_1d(active.parameters[p.name]) for p in feature.searched]
    searched = tuple(float(v) for v in np.concatenate([*values, np.zeros(0)]))
    candidate = library.add(feature, searched, fixed=feature.fixed)
    library.close()
    return candidate
