"""The diagnosis from recordings to result: where, which, how far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.diagnosis.assembly import assemble
from elastic_arm.diagnosis.calibration.calibrate import is_commissioned
from elastic_arm.diagnosis.calibration.mixture import mixture
from elastic_arm.diagnosis.calibration.recalibration import recalibrated
from elastic_arm.diagnosis.calibration.slow_channels import beside_low_passes
from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis, estimate
from elastic_arm.diagnosis.inference.excess import select_band, statistics_in_bands
from elastic_arm.diagnosis.inference.judgement import Judgement, judge, measured_beside
from elastic_arm.diagnosis.inference.sticking import sticking_misfits
from elastic_arm.diagnosis.inference.wrong_units import beside_wrong_signs
from elastic_arm.diagnosis.laws.better_laws import better_laws
from elastic_arm.diagnosis.noise.colour import NoiseColours, noise_colours
from elastic_arm.diagnosis.noise.scales import leaves_more, mean_squares, noise_scales
from elastic_arm.diagnosis.preparation import (
    PreparedData,
    as_described,
    prepare,
    with_candidates,
    without_sticking_friction,
)
from elastic_arm.diagnosis.question import Question
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.beyond_ordinary import freed, with_effects_beyond_ordinary
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key, misfit
from elastic_arm.diagnosis.selection.library_building import scaling
from elastic_arm.diagnosis.selection.stepwise import StepwiseSearch
from elastic_arm.diagnosis.settings import DiagnosisSettings, SearchSettings
from elastic_arm.diagnosis.texts.notes import PRIORS_UNUSED, mixture_note
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.model import Effect, SensorEffect
from elastic_arm.errors import DiagnosisError, require_kind
from elastic_arm.recording import Recording
from elastic_arm.recording.recording import recordings_of


@dataclass(frozen=True)
class Searched:
    """Data with the best hypothesis of a search.

    Parameters
    ----------
    prepared
        Data and regressors.
    stepwise
        The search.
    hypothesis
        Its best: the set of effects with the highest log-likelihood on motion that its fit has not seen.
    """

    prepared: PreparedData
    stepwise: StepwiseSearch
    hypothesis: Hypothesis


@dataclass(frozen=True)
class Estimated:
    """Data with the causes that passed, and their parameters.

    Parameters
    ----------
    prepared
        Data and regressors.
    judgement
        Which causes passed.
    estimated
        Their parameters.
    """

    prepared: PreparedData
    judgement: Judgement
    estimated: EstimatedHypothesis

    @property
    def misfit(self) -> float:
        """Mean square of what the causes that passed leave, whitened."""
        return misfit(self.prepared.library, self.judgement.hypothesis.selected)


def diagnose(recordings: Sequence[Recording], question: Question, validate: Sequence[Recording] = ()) -> Diagnosis:
    """Find where recordings and model differ, which effects cause it, and how far the gap shrinks with them.

    Parameters
    ----------
    recordings
        What causes are fitted on.
    question
        Arm, model, known effects, catalogue and thresholds.
    validate
        What judges them; the last third of the recordings where none is given.

    Raises
    ------
    DiagnosisError
        If the recordings allow no diagnosis: no torque, no motion, too short, validation equal to identification data.
    RecordingError
        If a recording lacks a joint, is something else, or holds numbers of no arm.
    """
    recordings, validate = recordings_of(recordings), recordings_of(validate, "validate")
    require_kind(question, Question, "question", DiagnosisError, "Give Question(robot).")
    return beside_wrong_signs(_diagnosis(recordings, question, validate), recordings, question)


def _diagnosis(recordings: Sequence[Recording], question: Question, validate: Sequence[Recording]) -> Diagnosis:
    """Return the diagnosis of recordings whose torques have the right signs."""
    # Whitened residuals of both data sets, and the columns of every effect at every place where it can show.
    found = _beside_largest_cause(prepare(recordings, validate, question))
    if question.refit:
        return _diagnosed(found)
    effects = [found.hypothesis.selected[k].feature.effect for k in found.hypothesis.causes]
    off = question.effects is None and _calibrated(effects) > question.settings.search.few_calibrated
    again = _commissioned(recordings, question, validate) if off else None
    # Where it leaves open what its causes are, those that last of the search's may be fewer.
    sure = again is not None and all(cause.confidence > 0.5 for cause in again.causes)
    if again and sure and _explains_with_many_off(again, question.settings) and len(again.causes) < len(effects):
        return again
    exact = _diagnosed(found)
    if question.effects is None and not _is_simple(exact, question.settings.search):
        again = again if off else _commissioned(recordings, question, validate)
        if again is not None and _is_likelier(again, exact, question.settings):
            return again
    unused = question.settings.priors.model_fields_set
    return replace(exact, notes=(*exact.notes, PRIORS_UNUSED)) if unused else exact


def _commissioned(
    recordings: Sequence[Recording], question: Question, validate: Sequence[Recording]
) -> Diagnosis | None:
    """Return the diagnosis with a description that is nearly right; None where it is too far off for that."""
    prepared = prepare(recordings, validate, question.of_commissioned_arm())
    if not is_commissioned(prepared.calibration, prepared.found.values):
        return None
    return _diagnosed(_beside_largest_cause(prepared))


def _explains_with_many_off(again: Diagnosis, settings: DiagnosisSettings) -> bool:
    """Whether a description that is nearly right explains the recording, with many of its numbers off.

    Those of real arms are. Of an arm that is built as described few are, in the place of an effect that the catalogue
    lacks.
    """
    numbers = (one for one in again.imperfections if one.recording is None)
    off = sum(one.differs(settings.refit.certain) for one in numbers)
    return again.verdict != "unknown" and off > settings.search.few_calibrated


def _is_likelier(again: Diagnosis, exact: Diagnosis, settings: DiagnosisSettings) -> bool:
    """Whether a description that is nearly right (`again`) is likelier than an exact one."""
    # A link's number that is further off than those of a calibrated arm may be a cause that is not in the catalogue;
    # where an exact description takes many numbers that are off, those of links are, too.
    off = _calibrated(cause.instance.effect for cause in exact.causes) > settings.search.few_calibrated
    ordinary = all(one.ordinary for one in again.imperfections if one.what.startswith("link_"))
    of_links = off or ordinary or _has_ordinary_sensors(again, settings)
    better = exact.verdict == "unknown" or len(again.causes) < len(exact.causes)
    return of_links and better and _explains_with_many_off(again, settings)


def _has_ordinary_sensors(again: Diagnosis, settings: DiagnosisSettings) -> bool:
    """Whether a torque sensor of every joint has a zero, as no effect makes: then all of the arm is an ordinary one."""
    zeros = [one for one in again.imperfections if one.what.endswith("torque_offset") and one.recording is None]
    return {one.joint for one in zeros if one.differs(settings.refit.certain)} == set(again.joints)


def _is_simple(found: Diagnosis, settings: SearchSettings) -> bool:
    """Whether the arm is explained, and but for few numbers and sensors its description is exact."""
    calibrated = _calibrated(cause.instance.effect for cause in found.causes)
    return found.verdict != "unknown" and calibrated <= settings.few_calibrated


def _calibrated(effects: Iterable[Effect]) -> int:
    """How many effects are a number of the arm or of a sensor that is off."""
    return sum(isinstance(effect, SensorEffect) or effect.model_parameter for effect in effects)


def _diagnosed(found: Searched) -> Diagnosis:
    """Judge and estimate the causes of a first search."""
    if sticking_misfits(found.prepared, found.hypothesis):
        # While a joint sticks, its dry friction takes any value, which no law states.
        found = best_hypothesis(without_sticking_friction(found.prepared))
    colours = None
    if found.prepared.calibration.parameters and found.hypothesis.causes:
        # Where the model and its sensors lie beside these causes, the search has less to mistake for another one.
        colours = noise_colours(found.prepared, found.hypothesis)
        beside, there = recalibrated(found.prepared, found.hypothesis, colours.of_sets if colours else None)
        beside, _ = beside_low_passes(beside, [there.selected[k] for k in there.causes])
        found = _beside_faulty_sensors(beside)
    if colours is None and (colours := noise_colours(found.prepared, found.hypothesis)) is not None:
        # Where what no motion explains is not white, that is the noise.
        beside, _ = recalibrated(found.prepared, found.hypothesis, colours.of_sets)
        found = _beside_faulty_sensors(beside)
    scaled = None if colours else _beside_scales(found)
    if scaled is None:
        return _answered(found, colours)
    again, left = _answered(scaled, None), mean_squares(found.prepared, found.hypothesis.selected)
    # Where it leaves more, it is no better place.
    return _answered(found, None) if leaves_more(again, left, found.prepared.settings.refit.passing) else again


def _answered(found: Searched, colours: NoiseColours | None) -> Diagnosis:
    """Judge and estimate the causes of the last search, and compare them with laws that no catalogue states."""
    causes = _estimated_once_more(found.prepared, found.stepwise.with_rivals(found.hypothesis))
    # In the place of the causes and beside them.
    laws = better_laws(causes.prepared, causes.estimated, colours.unlike if colours else {})
    faults = causes.estimated.faults
    judgement = measured_beside(causes.prepared, causes.judgement, faults, laws.refuted(faults))
    # The gap before and after, the verdict, the causes in order, and what is left.
    found_out, final = assemble(causes.prepared, judgement, causes.estimated, laws), causes.estimated.final
    mixed = mixture(final.fit) if final is not None and found_out.verdict == "unknown" else None
    if mixed is None:
        return found_out
    note = mixture_note(mixed.share, mixed.what, mixed.joint, mixed.sources)
    return replace(found_out, notes=(note, *found_out.notes))


def _beside_scales(found: Searched) -> Searched | None:
    """Return the search where each joint and side has its own scale; None where one does for all.

    What one joint lacks would hide the causes of all others. The first scales hold what is only found beside them, and
    the last ones what is left then.
    """
    prepared, hypothesis = found.prepared, found.hypothesis
    scales = noise_scales(prepared, hypothesis) if prepared.calibration.parameters else None
    if scales is None:
        return None
    beside, _ = recalibrated(prepared, hypothesis, scales=scales)
    again = _beside_faulty_sensors(beside)
    last = noise_scales(again.prepared, again.hypothesis)
    even = np.ones(len(prepared.places))
    beside, hypothesis = recalibrated(again.prepared, again.hypothesis, scales=even if last is None else last)
    return Searched(beside, StepwiseSearch(beside.library, beside.given, beside.settings, beside.sizes), hypothesis)


def _estimated_once_more(prepared: PreparedData, hypothesis: Hypothesis) -> Estimated:
    """Judge and estimate the causes of the search, calibrated anew where one of them turns out to be none.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        Of the search, with rivals.
    """
    found = estimated_beyond_ordinary(prepared, hypothesis)
    there = _as_judged(hypothesis, found)
    if not prepared.calibration.parameters or len(there.causes) == len(hypothesis.causes):
        return found
    # Beside what turned out to be no cause, the model lies elsewhere, and with it what is beyond ordinary.
    again, there = recalibrated(prepared, there)
    stepwise = StepwiseSearch(again.library, again.given, again.settings, again.sizes)
    better = estimated_beyond_ordinary(again, stepwise.with_rivals(there))
    # Where it leaves more, it is no better place.
    return better if better.misfit < prepared.settings.refit.worse * found.misfit else found


def _as_judged(hypothesis: Hypothesis, found: Estimated) -> Hypothesis:
    """Return those causes of the search that are still there, with those that were put in the place of others."""
    last = {candidate.feature.key for candidate in found.estimated.hypothesis.selected}
    judged, searched = found.judgement.hypothesis, {candidate.feature.key for candidate in hypothesis.selected}
    instead = [judged.selected[k] for k in judged.causes]
    keys = last - searched - judged.beyond
    there = hypothesis.only(last)
    return replace(there, selected=[*there.selected, *(c for c in instead if c.feature.key in keys)])


def _beside_largest_cause(prepared: PreparedData) -> Searched:
    """Return the search and its best hypothesis, from a calibration beside one cause where that explains far more.

    Calibrated without its causes, an arm with a payload as heavy as itself comes out with gains of two, about which the
    payload's columns are no good. About the description gains are one, and what a payload does is linear in its mass.
    """
    prepared, slow = beside_low_passes(prepared)
    left, settings = misfit(prepared.library, [*prepared.given, *slow]), prepared.settings.search
    if left > settings.bent and prepared.calibration.parameters:
        described = as_described(prepared)
        sensors = _freed_sensors(described)
        start = StepwiseSearch(described.library, described.given, described.settings).largest_cause()
        faulty = [start.selected[k].feature for k in start.causes if start.selected[k].feature.key in sensors]
        # Columns at no effect are far from what a large one does: gravity turned by a right angle is no small tilt.
        start = start.only(()) if faulty else replace(start, selected=described.estimates.polished(start.selected))
        # Its columns alone tell whether the search begins there: those of all that competes take most of the time.
        beside, there = recalibrated(replace(described, candidates=()), start, faulty=faulty, scaled=True)
        if misfit(beside.library, there.selected) < settings.far_better * left:
            causes = [there.selected[k] for k in there.causes]
            return best_hypothesis(with_candidates(replace(beside, candidates=prepared.candidates), causes))
    return best_hypothesis(with_candidates(prepared, slow))


def _beside_faulty_sensors(prepared: PreparedData) -> Searched:
    """Return the search and its best hypothesis, sensors among what competes: their priors hold those of faulty ones.

    A sensor that is far off would bend the model, or another effect would stand in for it, as a spring with a distant
    rest angle for an offset. Where it explains more without its prior, it hardly has one from there on.
    """
    keys = _freed_sensors(prepared)
    found = best_hypothesis(prepared)
    features = [found.hypothesis.selected[k].feature for k in found.hypothesis.causes]
    faulty = [feature for feature in features if feature.key in keys]
    if not faulty:
        return found
    rest = found.hypothesis.only(feature.key for feature in features if feature.key not in keys)
    beside, _ = recalibrated(prepared, rest, faulty=faulty)
    return best_hypothesis(beside)


def _freed_sensors(prepared: PreparedData) -> frozenset[Key]:
    """Let the sensors without their priors compete in searches of these data, and return their keys."""
    library, parameters = prepared.library, enumerate(prepared.calibration.parameters)
    sensors = [
        (k, p, p.cause) for k, p in parameters if p.is_sensor and p.cause is not None and p.cause.effect.searched
    ]
    library.candidates.extend(freed(library, k, p.prior_std, cause) for k, p, cause in sensors)
    library.close()
    return frozenset(cause.key for _, _, cause in sensors)


def best_hypothesis(prepared: PreparedData) -> Searched:
    """Search, and return the best hypothesis; that of no cause where no gap shows by size or by likelihood."""
    library, settings = prepared.library, prepared.settings
    stepwise = StepwiseSearch(library, prepared.given, settings, prepared.sizes)
    residuals = library.validation_residuals(prepared.given)
    by_size = select_band(statistics_in_bands(prepared.validation, residuals, settings), settings.significance)
    if by_size is None and stepwise.strongest() <= settings.significance.detected:
        return Searched(prepared, stepwise, Hypothesis(prepared.given, len(prepared.given)))
    return Searched(prepared, stepwise, stepwise.best())


def estimated_beyond_ordinary(prepared: PreparedData, hypothesis: Hypothesis) -> Estimated:
    """Judge and estimate the causes of the search, and those that keep the model's numbers ordinary."""
    refused: frozenset[Key] = frozenset()
    while True:
        # What the model's own numbers would have to be far from ordinary for.
        beside, extended = beyond_ordinary(prepared, hypothesis, refused)
        judgement, estimated = _judged(beside, extended)
        left = {candidate.feature.key for candidate in estimated.hypothesis.selected}
        lost = [c.feature.key for c in extended.selected if c.feature.key in extended.beyond - left]
        if not lost or len(left) >= len(extended.selected):
            return Estimated(beside, judgement, estimated)
        # What is no cause is in the model's numbers. The last one found gained least.
        refused |= {lost[-1]}
        prepared = replace(beside, found=replace(beside.found, library=beside.library.calibrated_beside(())))


def _judged(prepared: PreparedData, hypothesis: Hypothesis) -> tuple[Judgement, EstimatedHypothesis]:
    """Judge and estimate causes until none has a number that no such arm has, beside everything else."""
    impossible: dict[Key, str] = {}
    while True:
        # Without the effects that are too small, uncertain in resampled blocks, or compatible with no effect.
        judgement = judge(prepared, hypothesis, impossible)
        # All parameters at their joint optimum, with standard deviations.
        estimated = estimate(prepared, judgement.hypothesis, judgement.faults)
        if estimated.impossible.keys() <= impossible.keys():
            return judgement, estimated
        # A curve that bends at no speed reached, or at one that is not determined, is the law without a bend.
        impossible |= estimated.impossible


def beyond_ordinary(
    prepared: PreparedData, hypothesis: Hypothesis, refused: frozenset[Key] = frozenset()
) -> tuple[PreparedData, Hypothesis]:
    """Return a hypothesis with the effects that keep the model's numbers ordinary, and data to measure them on.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        Of the search.
    refused
        Keys of effects that turned out to be no causes.
    """
    library, acting = prepared.library, prepared.found.expansion.acting
    own = [p.feature for p in prepared.calibration.parameters if p.feature is not None and p.recording is None]
    equations = ArmEquations(prepared.model.robot, prepared.model.name)
    sensors = [scaling(feature.at(equations), acting) for feature in own]
    carried = [feature for feature in prepared.carried if feature.key not in refused]
    for k in reversed(hypothesis.causes):
        if hypothesis.selected[k].feature.key in refused:
            hypothesis = hypothesis.drop(k)
    parameters = enumerate(prepared.calibration.parameters)
    keys = {feature.key for feature in carried}
    numbers = [
        freed(library, k, p.prior_std, p.cause)
        for k, p in parameters
        if p.is_inertial and p.cause is not None and p.cause.key in keys
    ]
    found = with_effects_beyond_ordinary(library, hypothesis, carried, sensors, numbers, prepared.settings, refused)
    if not found.beyond:
        return prepared, hypothesis
    # Else a cause that nuisance parameters could hold would leave no residual without it.
    beside = replace(prepared.found, library=library.calibrated_beside(found.selected))
    return replace(prepared, found=beside), found
