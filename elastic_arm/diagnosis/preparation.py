"""Recordings and a question become two sets of whitened residuals and a library of regressors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from elastic_arm.codegen.parallel import share_out
from elastic_arm.diagnosis.calibration.calibrate import calibrate
from elastic_arm.diagnosis.calibration.expansion import expand
from elastic_arm.diagnosis.calibration.linearisation import Linearised, linearise
from elastic_arm.diagnosis.calibration.problem import CalibrationProblem, Observations
from elastic_arm.diagnosis.calibration.problem import problem_of as calibration_problem
from elastic_arm.diagnosis.data.common_equations import common_equations, has_one_encoder
from elastic_arm.diagnosis.data.encoder_zeros import with_common_zeros
from elastic_arm.diagnosis.data.preprocessing import needs_motion, standing, usable
from elastic_arm.diagnosis.data.split import independent, split
from elastic_arm.diagnosis.inference.joint_estimates import JointEstimates
from elastic_arm.diagnosis.mounted_arm import as_mounted, change_by_mounting
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.selection.candidates import feature_of, features, recorded_features
from elastic_arm.diagnosis.selection.plausible_size import PlausibleSizes
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.diagnosis.texts.notes import (
    COMMISSIONED,
    LOW_PASSED,
    REFITTED,
    STICKING,
    bare_note,
    standing_note,
    unseen_notes,
)
from elastic_arm.dynamics import Model, build_model
from elastic_arm.effects import Effect, EffectInstance, robot_effects
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.library.base_tilt import TILT
from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.motion import Motion
from elastic_arm.estimation.observation import Observation, continued, observe
from elastic_arm.estimation.whitening import WhitenedData
from elastic_arm.identification.batch.mounting import Mounting
from elastic_arm.identification.batch.turning import turning_speeds
from elastic_arm.recording import Recording
from elastic_arm.recording.inspection.plausibility import smoothed_torques
from elastic_arm.recording.inspection.two_encoders import by_motor_encoders

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PreparedData:
    """What search and judgement work on.

    Parameters
    ----------
    calibration
        How the model's own numbers and its sensors are determined; without parameters where they are taken as stated.
    found
        Model, columns of known effects and of what competes, where the calibration puts them.
    candidates
        Every effect at every place where the motion can show it.
    carried
        Errors of the links' own numbers.
    unseen
        Known effects that act in no recorded equation.
    sources
        Where the recordings of either part come from.
    independent_motion
        Whether the validation motion is another one.
    notes
        What the reader should know of the data.
    settings
        All thresholds.
    mounting
        How the arm is mounted, where that is not as described.
    """

    calibration: CalibrationProblem
    found: Linearised
    candidates: tuple[Feature, ...]
    carried: tuple[Feature, ...]
    unseen: tuple[EffectInstance, ...]
    sources: tuple[tuple[str, ...], tuple[str, ...]]
    independent_motion: bool
    notes: tuple[str, ...]
    settings: DiagnosisSettings
    mounting: Mounting | None = None

    @property
    def model(self) -> Model:
        """The nominal model, or the calibrated one."""
        return self.found.expansion.model

    @property
    def library(self) -> RegressorLibrary:
        """The columns of all candidates on identification and validation data."""
        return self.found.library

    @property
    def given(self) -> tuple[Candidate, ...]:
        """Candidates that count as part of the model: effects of the arm file and of the user."""
        return self.found.given

    @property
    def observed(self) -> tuple[Observations, Observations]:
        """The recordings that causes are fitted on, and those that judge, late channels moved back."""
        return self.found.expansion.observed

    @property
    def validation(self) -> WhitenedData:
        """The data that judge."""
        return self.library.sets[1]

    @cached_property
    def sizes(self) -> PlausibleSizes:
        """The largest plausible sizes of effects on this arm."""
        gains = [p.prior_std for p in self.calibration.parameters if p.is_torque_gain]
        return PlausibleSizes(self.model.robot, self.library.sets, max(gains, default=0.0))

    @cached_property
    def estimates(self) -> JointEstimates:
        """The parameters of sets of candidates."""
        return JointEstimates(self.library, self.settings.judgement)

    @cached_property
    def tilt(self) -> Candidate | None:
        """The known effect that holds the tilt from where the arm is mounted; None where that is as described."""
        mounted = self.given if self.mounting is not None else ()
        return next((candidate for candidate in mounted if candidate.feature.effect.id == TILT), None)

    @cached_property
    def _undone(self) -> list[Array]:
        """What the description of an arm that is mounted otherwise lacks of each stretch."""
        if self.mounting is None or self.tilt is None:
            return []
        return change_by_mounting(self.mounting, self.tilt.feature, self.validation)

    def described_residuals(self, selected: Sequence[Candidate]) -> list[Array]:
        """Return what candidates leave of the validation data (N', R) of each stretch, of the arm as it is described.

        Else it is the arm as its torques show it mounted.
        """
        left = self.library.validation_residuals(selected)
        return [a + b for a, b in zip(left, self._undone, strict=True)] if self._undone else left

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
    """Split, observe, whiten and calibrate the recordings, beside the known effects alone: :func:`with_candidates`.

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
    chosen = [[by_motor_encoders(r.select(names), question.robot) for r in part] for part in (recordings, validate)]
    cleared = share_out(lambda r: usable(r, settings.preprocessing), chain.from_iterable(chosen))
    selected = [cleared[: len(recordings)], cleared[len(recordings) :]]
    alike = with_common_zeros([*selected[0], *selected[1]], question.robot)
    parts = split(alike[: len(recordings)], alike[len(recordings) :], settings.split)
    observed = _observed(parts, held_back=not validate)
    question, mounting = as_mounted(question, observed[0])
    question = _with_motor_inertia(question, observed[0])
    observed = _turning_over(question, parts[0], observed)
    currents = sorted({channel for part in parts for recording in part for channel in recording.currents})
    settings = replace(settings, priors=settings.priors.of_currents(currents))
    nominal = build_model(question.robot, question.model)
    layout, band = common_equations([*observed[0], *observed[1]], nominal, settings.preprocessing)
    still = [joint for joint in names if all(joint in standing(r) for r in parts[0])]
    equations = ArmEquations(question.robot, question.model)
    known, unseen = _known_effects(question, equations, layout)
    problem = calibration_problem(
        question.robot,
        question.model,
        observed,
        layout,
        band,
        _calibrated_effects(question),
        known,
        settings,
        refit=question.refit,
        held_back=not validate,
    )
    candidates = _candidates(question, equations, still, problem, observed[0][0].pieces[0])
    expansion, noise = expand(problem, np.zeros(len(problem.parameters))), 1.0
    if problem.parameters:
        expansion, noise, _ = calibrate(problem, expansion)
    found, _ = linearise(problem, expansion, (), noise=noise)
    notes = list(dict.fromkeys(note for part in observed for o in part for note in o.notes))
    notes += [*_low_passed(parts), *_certainty_notes(question), *(standing_note(joint) for joint in still)]
    bare = [names[j] for j in layout.without_rows]
    notes += [*([bare_note(bare)] if bare else []), *unseen_notes(unseen, bare)]
    notes += _currents_notes(currents, settings) if problem.parameters else []
    return PreparedData(
        calibration=problem,
        found=found,
        candidates=tuple(candidates),
        carried=tuple(_carried(question, equations)) if question.refit else (),
        unseen=unseen,
        sources=(tuple(r.source for r in parts[0]), tuple(r.source for r in parts[1])),
        independent_motion=independent(*parts, settings.split),
        notes=tuple(notes),
        settings=settings,
        mounting=mounting,
    )


def _known_effects(
    question: Question, equations: ArmEquations, layout: EquationSet
) -> tuple[tuple[EffectInstance, ...], tuple[EffectInstance, ...]]:
    """Return the effects of the arm file and of the user that act in a recorded equation, and those that do not."""
    own = {(instance.effect.id, instance.joint) for instance in question.given}
    stated = [i for i in robot_effects(question.robot, question.catalogue) if (i.effect.id, i.joint) not in own]
    known = [i for i in (*stated, *question.given) if feature_of(i, equations).acts]
    unseen = tuple(instance for instance in known if not _is_seen(feature_of(instance, equations), layout))
    return tuple(instance for instance in known if instance not in unseen), unseen


def _observed(parts: Sequence[Sequence[Recording]], *, held_back: bool) -> list[list[Observation]]:
    """Return the motion of both parts; where the second was held back from the first, it continues it."""
    together = share_out(observe, chain.from_iterable(parts))
    observed = [together[: len(parts[0])], together[len(parts[0]) :]]
    if not held_back:
        return observed
    cuts = [(rest.start_ns - first.start_ns) * 1e-9 for first, rest in zip(*parts, strict=True)]
    joined = [continued(*each) for each in zip(*observed, cuts, strict=True)]
    return [[first for first, _ in joined], [rest for _, rest in joined]]


def _with_motor_inertia(question: Question, observed: Sequence[Observation]) -> Question:
    """Return the question with motor inertia to be refitted where motor torques were recorded and none is described."""
    motored = all(piece.tau_m is not None for one in observed for piece in one.pieces)
    uncertain = question.refit and not question.commissioned
    return replace(question, robot=question.robot.with_armatures()) if uncertain and motored else question


def _turning_over(
    question: Question, recordings: Sequence[Recording], observed: Sequence[Sequence[Observation]]
) -> list[list[Observation]]:
    """Return the observations with the speeds at which dry friction turns over, where the arm is refitted.

    Friction that turns over more gradually than its law is taken for another law, or for a lag of the torque. Arms with
    elastic joints show it beside their motors' own motion, and torques that were low-passed show their filter: there
    the velocity's noise decides.
    """
    uncertain = question.refit and not question.commissioned and not question.robot.elastic
    whole = all(o.torque_band == np.inf for part in observed for o in part)
    speeds = turning_speeds(recordings, question.robot) if uncertain and whole else None
    return [[replace(o, turning=speeds) for o in part] for part in observed]


def _certainty_notes(question: Question) -> list[str]:
    """Return a note on what was determined together with the causes."""
    if question.commissioned:
        return [COMMISSIONED]
    return [REFITTED] if question.refit else []


def _currents_notes(channels: Sequence[str], settings: DiagnosisSettings) -> list[str]:
    """Return a note on torque channels that are currents."""
    gains = ", ".join(f"{100 * settings.priors.sensors[f'{channel}_gain']:.2g} % of {channel}" for channel in channels)
    return [f"Torques are currents times a torque constant, believed to {gains}."] if channels else []


def _low_passed(parts: Sequence[Sequence[Recording]]) -> list[str]:
    """Return a note where torques hold not even noise at high frequencies; that on the first recording is enough."""
    found = [words for part in parts for recording in part for words in smoothed_torques(recording)]
    return [f"{words}: {LOW_PASSED}." for words in found[:1]]


def with_candidates(prepared: PreparedData, causes: Sequence[Candidate] = ()) -> PreparedData:
    """Return the data with the columns of all that competes, and of causes that were found beside them."""
    expansion, noise = prepared.found.expansion, prepared.library.nuisance.noise
    found, _ = linearise(prepared.calibration, expansion, prepared.candidates, causes, noise=noise)
    return replace(prepared, found=found)


def as_described(prepared: PreparedData) -> PreparedData:
    """Return the data as the description and exact sensors have them, before any calibration."""
    problem = prepared.calibration
    found, _ = linearise(problem, expand(problem, np.zeros(len(problem.parameters))), prepared.candidates)
    return replace(prepared, found=found)


def without_sticking_friction(prepared: PreparedData) -> PreparedData:
    """Return the data without what friction may be while a joint sticks."""
    problem = replace(prepared.calibration, sticking_removed=True)
    found, _ = linearise(problem, expand(problem, prepared.found.values), prepared.candidates)
    return replace(prepared, calibration=problem, found=found, notes=(*prepared.notes, STICKING))


def _calibrated_effects(question: Question) -> tuple[Effect, ...]:
    """Return the effects of sensors and numbers that an ordinary arm has some of, but those that the user knows."""
    given = {instance.effect.id for instance in question.given}
    return tuple(e for e in question.catalogue.values() if (e.prior is not None or e.number) and e.id not in given)


def _is_seen(feature: Feature, layout: EquationSet) -> bool:
    """Whether an effect acts in a recorded equation.

    What brakes a motor is not seen by a joint torque sensor, and what acts in void rows alone is not seen at all.
    """
    if feature.choices.get("side") == "motor" and set(layout.sides) <= {"link", "drive"}:
        return False
    whole = bool(layout.live.all()) or feature.effect.regressor is not None
    return whole or bool(layout.transform[:, feature.rows].any())


def _carried(question: Question, equations: ArmEquations) -> list[Feature]:
    """Return errors of the links' own numbers.

    Those of drives are nuisance parameters by predicted torques: regressed on measured ones, they would gain by noise.
    """
    effects = question.catalogue.values() if question.effects is None else question.effects
    return features(equations, [e for e in effects if e.searched and e.model_parameter and e.sides == ("link",)])


def _candidates(
    question: Question,
    equations: ArmEquations,
    still: Sequence[str],
    problem: CalibrationProblem,
    motion: Motion,
) -> list[Feature]:
    """Return every effect at every place where motion and channels can show it.

    What the nuisance parameters hold is in every hypothesis already, and competes with none.
    """
    held = {(p.feature.effect.id, p.joint) for p in problem.parameters if p.feature is not None}
    wholly = {effect for effect, _ in held}
    shown = recorded_features(features(equations, question.candidates), motion)
    free = [f for f in shown if (f.effect.id, f.joint) not in held and not (f.joint is None and f.effect.id in wholly)]
    if question.effects is None and has_one_encoder(problem.layout, problem.robot):
        # Slowly, bearings and damping do less than what following the load neglects.
        free = [f for f in free if f.effect.regime != "frequency" or isinstance(f.effect, SensorEffect)]
    seen = (f for f in free if _is_seen(f, problem.layout))
    return [f for f in seen if f.joint not in still or not needs_motion(f)]
