"""From judged and estimated causes to the result."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis
from elastic_arm.diagnosis.inference.estimates import Agreement, ParameterEstimate
from elastic_arm.diagnosis.inference.excess import ResidualStatistics, residual_statistics
from elastic_arm.diagnosis.inference.faults import LargeImperfection, with_faults
from elastic_arm.diagnosis.inference.gap_metric import cumulative_shrink, gap_measure
from elastic_arm.diagnosis.inference.judgement import Judgement
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFit, strongest
from elastic_arm.diagnosis.inference.place_gaps import PlaceGap, place_gaps, shares_of_causes
from elastic_arm.diagnosis.inference.regimes import regime, shares
from elastic_arm.diagnosis.inference.wrong_units import wrong_unit_notes
from elastic_arm.diagnosis.laws.better_laws import NO_LAWS, BetterLaws, lacks_of_fit
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.ranked_causes import RankedCause, listed_causes
from elastic_arm.diagnosis.result import Diagnosis, Imperfection, ResidualSizes, UnexplainedResidual, plain_parameters
from elastic_arm.diagnosis.selection.hypothesis import Key
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.settings import JudgementSettings
from elastic_arm.diagnosis.texts.notes import (
    REPEATED_MOTION,
    general_law_note,
    imperfection_notes,
    impossible_size_note,
    refuted_note,
    unlike_noise_note,
)

Array = NDArray[np.float64]


def assemble(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws = NO_LAWS
) -> Diagnosis:
    """Measure the gap before and after, rank the causes, and name what is left.

    Parameters
    ----------
    prepared
        Data and regressors.
    judgement
        The causes that passed, and the measure of the gap.
    estimated
        Their parameters.
    laws
        What the catalogue lacks.
    """
    settings, measure, library = prepared.settings, judgement.measure, prepared.library
    ranked = _that_help(prepared, judgement, estimated, laws)
    hypothesis = estimated.hypothesis.only(r.candidate.feature.key for r in ranked)
    shrink, interval = measure.share(hypothesis.selected)
    stands_out = measure.stands_out(hypothesis.selected)
    # Known effects alone are linear: what they leave is what they left before they were polished.
    judged = hypothesis.selected if estimated.hypothesis.causes else judgement.hypothesis.baseline
    traces = [] if stands_out else judgement.test(judged)
    residuals = with_faults(library.validation_residuals(judged), laws.refuted(estimated.faults))
    by_place = _by_place(prepared, judgement, hypothesis.baseline, residuals)
    still_open = _open_rows(prepared, judgement, estimated, hypothesis.baseline, residuals, by_place)
    kept = [*still_open, *laws.unlike_noise, *_rows_beyond_ordinary(prepared, estimated, ranked)]
    answer = verdict(
        _share_as_mounted(prepared, judgement, laws.refuted(estimated.faults), hypothesis.selected),
        caused=bool(ranked),
        unexplained=stands_out or bool(traces) or laws.beside is not None or bool(kept),
        open_places=bool(still_open),
        refuted=bool(laws.instead) or (prepared.mounting is None and laws.outweigh(judgement, estimated)),
        settings=settings.judgement,
    )
    if answer == "unknown":
        there = shares_of_causes(prepared, hypothesis, by_place)
        ranked = [one.less_sure(max(shrink, there.get(one.candidate.feature.key, 0.0))) for one in ranked]
    before, seed = measure.before, settings.resampling.significance_seed
    after = residual_statistics(prepared.validation, residuals, before.band, settings, seed)
    unexplained = _unexplained(prepared, before, after, residuals, traces, kept) if answer == "unknown" else []
    first = wrong_unit_notes(prepared, hypothesis.selected, still_open) if answer == "unknown" else []
    return Diagnosis(
        model=prepared.model.name,
        robot=prepared.model.robot.name,
        joints=prepared.model.robot.joint_names,
        prismatic=tuple(prepared.model.robot.units.prismatic),
        identify=prepared.sources[0],
        validate=prepared.sources[1],
        independent_motion=prepared.independent_motion,
        band=before.band,
        verdict=answer,
        noise=_by_live_place(prepared, before.noise),
        before=_sizes(prepared, before),
        after=_sizes(prepared, after),
        shrink=None if answer == "none" else shrink,
        shrink_interval=None if answer == "none" else interval,
        shrink_by_place={prepared.places[p.row]: p.shrink for p in by_place if prepared.validation.layout.live[p.row]},
        measured_by=measure.name,
        log_likelihood=judgement.log_likelihood,
        causes=tuple(r.cause for r in ranked),
        unexplained=tuple(with_laws(unexplained, prepared, laws, after) if answer == "unknown" else ()),
        imperfections=estimated.imperfections,
        known=_known(prepared, estimated),
        notes=(*first, *_notes(prepared, judgement, estimated, laws)),
        cumulative_shrink=cumulative_shrink(measure, hypothesis.baseline, [r.candidate for r in ranked]),
        context=_context(prepared, judgement, estimated, ranked, residuals),
    )


def _that_help(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws
) -> list[RankedCause]:
    """Return the causes with which the gap is smaller, the whole or that where they act: others explain nothing.

    Faults of sensors and another mounting stay: each was measured by itself.
    """
    ranked = listed_causes(prepared, judgement, estimated, laws)
    hypothesis = estimated.hypothesis.only(r.candidate.feature.key for r in ranked)
    if judgement.measure.share(hypothesis.selected)[0] > 0.0:
        return ranked
    left = prepared.library.validation_residuals(hypothesis.selected)
    residuals = with_faults(left, laws.refuted(estimated.faults))
    by_place = _by_place(prepared, judgement, hypothesis.baseline, residuals)
    there = shares_of_causes(prepared, hypothesis, by_place)
    found = {hypothesis.selected[k].feature.key for k in hypothesis.causes if by_place}
    helpless = {key for key in found if not there.get(key, 0.0) > 0.0}
    return [one for one in ranked if one.candidate.feature.key not in helpless]


def _share_as_mounted(
    prepared: PreparedData,
    judgement: Judgement,
    refuted: Sequence[LargeImperfection],
    selected: Sequence[Candidate],
) -> float:
    """Return the share of the gap that candidates take away, of the arm as its torques show it mounted."""
    measure = judgement.measure
    if prepared.mounting is not None:
        found = judgement.hypothesis, judgement.test, judgement.faults, refuted
        measure = gap_measure(prepared, *found, mounted=True)
    return measure.share(selected)[0]


def verdict(
    shrink: float,
    *,
    caused: bool,
    unexplained: bool,
    settings: JudgementSettings,
    open_places: bool = False,
    refuted: bool = False,
) -> str:
    """Return whether the causes explain the gap: "none", "explained" or "unknown".

    Where the gap is faint, the excess that is left is known to a part of it only: then it must look like noise.

    Parameters
    ----------
    shrink
        Share of the gap that the causes take away.
    caused
        Whether there are causes.
    unexplained
        Whether what is left is more than noise.
    settings
        How much of the gap may be left.
    open_places
        Whether some joint and side keeps too much of its own gap.
    refuted
        Whether some cause stands in for a law that no catalogue has, or such a law explains more than all of them.
    """
    if open_places or refuted:
        return "unknown"
    if caused and shrink >= 1.0 - settings.explained:
        return "explained"
    if unexplained:
        return "unknown"
    return "explained" if caused else "none"


def with_laws(
    places: Sequence[UnexplainedResidual], prepared: PreparedData, laws: BetterLaws, after: ResidualStatistics
) -> list[UnexplainedResidual]:
    """Return the places where something is left, those first where a law that no catalogue states shows most.

    What is left is measured with what only stands in for a law: there the law itself, if that is larger, is listed.

    Parameters
    ----------
    places
        Where residuals or general shapes show it.
    prepared
        Data and regressors.
    laws
        Laws that no catalogue states.
    after
        What is left.
    """
    lacks = strongest(lacks_of_fit(prepared, laws.all))
    instead = {one.row for one in lacks_of_fit(prepared, list(laws.instead.values()))}
    left = {one.row: float(after.rmse[one.row]) for one in lacks}
    left |= {one.row: max(one.rmse, left[one.row]) for one in lacks if one.row in instead}
    first = [UnexplainedResidual(*prepared.places[one.row], one.regime, left[one.row]) for one in lacks]
    own = {(one.joint, one.side) for one in first}
    return [*first, *(one for one in places if (one.joint, one.side) not in own)]


def _notes(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws
) -> tuple[str, ...]:
    """Return what the reader should know, in the order of the steps."""
    imperfect = imperfection_notes(estimated.imperfections) + [
        impossible_size_note(p.cause, p.cause.linear[0].name, ParameterEstimate(one.value, one.std, one.unit))
        for p, one in _impossible_numbers(prepared, estimated)
        if p.cause is not None
    ]
    repeated = () if prepared.independent_motion else (REPEATED_MOTION,)
    found = (*imperfect, *judgement.notes, *estimated.notes, *_law_notes(prepared, laws, estimated.faults))
    return (*prepared.notes, *found, *repeated)


def _impossible_numbers(
    prepared: PreparedData, estimated: EstimatedHypothesis
) -> list[tuple[NuisanceParameter, Imperfection]]:
    """Return each number beyond ordinary that is no cause, as no arm has it."""
    numbers, factor = [p for p in prepared.calibration.parameters if p.is_number], prepared.settings.search.ratio_factor
    return [
        (p, one)
        for p, one in zip(numbers, estimated.imperfections, strict=False)
        if p.cause is not None and not one.ordinary and not p.cause.linear[0].believable(one.value, factor, one.std)
    ]


def _law_notes(prepared: PreparedData, laws: BetterLaws, faults: Sequence[LargeImperfection]) -> list[str]:
    """Return a note on each general law that explains more than the causes, and on where more is left than noise."""
    names, unlisted = prepared.model.robot.joint_names, [fault.feature.key for fault in faults]
    notes = [
        refuted_note(*key[:2], names[fit.law.joint], fit.law, fit.gain, listed=key not in unlisted)
        for key, fit in laws.instead.items()
    ]
    if laws.beside is not None and not notes:
        notes = [general_law_note(names[laws.beside.law.joint], laws.beside.law, laws.beside.gain)]
    return notes + [unlike_noise_note(*prepared.places[row], power) for row, power in laws.unlike_noise.items()]


def _known(prepared: PreparedData, estimated: EstimatedHypothesis) -> tuple[dict[str, Any], ...]:
    """Return what known effects came out as; the tilt of an arm that is mounted otherwise is a cause."""
    tilt = prepared.tilt
    given = estimated.hypothesis.given
    return tuple(
        {
            "effect": instance.effect.id,
            "joint": instance.joint,
            "sides": list(instance.sides),
            "parameters": plain_parameters(parameters),
        }
        for instance, parameters in zip(estimated.instances[:given], estimated.parameters[:given], strict=True)
        if tilt is None or instance.effect is not tilt.feature.effect
    )


def _by_place(
    prepared: PreparedData,
    judgement: Judgement,
    baseline: Sequence[Candidate],
    left: Sequence[Array],
    *,
    mounted: bool = False,
) -> list[PlaceGap]:
    """Return the gap of each joint and side by itself, of the arm as described or as it is mounted.

    Nothing where no residual shows it.
    """
    if judgement.measure.name != "excess":
        return []
    residuals_of = prepared.library.validation_residuals if mounted else prepared.described_residuals
    before = with_faults(residuals_of(baseline), judgement.faults)
    return place_gaps(prepared.validation, before, left, prepared.settings)


def _open_rows(
    prepared: PreparedData,
    judgement: Judgement,
    estimated: EstimatedHypothesis,
    baseline: Sequence[Candidate],
    left: Sequence[Array],
    by_place: Sequence[PlaceGap],
) -> list[int]:
    """Return the rows of the residuals that keep much of their own gap, of the arm as its torques show it mounted.

    Beside what a wrong mounting does, any other gap is small. A torque of which the gain would have to be one that no
    arm has keeps its gap, too, whatever causes explain beside that gain.
    """
    if prepared.mounting is not None:
        by_place = _by_place(prepared, judgement, baseline, left, mounted=True)
    scaled = {p.joint for p, _ in _impossible_numbers(prepared, estimated) if p.is_torque_gain}
    kept = [place.row for place in by_place if place.is_open(prepared.settings.judgement.place_explained)]
    return kept + _live_rows(prepared, scaled)


def _rows_beyond_ordinary(
    prepared: PreparedData, estimated: EstimatedHypothesis, ranked: Sequence[RankedCause]
) -> list[int]:
    """Return the rows of the residuals of joints with a number beyond ordinary, for which no cause is named."""
    named = {r.cause.joint for r in ranked}
    if None in named:  # of the whole arm, these joints among them
        return []
    numbers = [one for one in estimated.imperfections if one.recording is None]
    return _live_rows(prepared, {one.joint for one in numbers if not one.ordinary} - named)


def _live_rows(prepared: PreparedData, joints: Collection[str]) -> list[int]:
    """Return the first row of the residuals of each of some joints."""
    names, live, n = list(prepared.model.robot.joint_names), prepared.validation.layout.live, prepared.model.n
    return [next(row for row in range(joint, len(live), n) if live[row]) for joint in map(names.index, sorted(joints))]


def _unexplained(
    prepared: PreparedData,
    before: ResidualStatistics,
    after: ResidualStatistics,
    residuals: Sequence[Array],
    traces: Sequence[LackOfFit],
    kept: Sequence[int],
) -> list[UnexplainedResidual]:
    """Return where something is left: what follows a regime, else the residuals that keep much of a gap.

    That is much of the whole gap; `kept` are the rows where something is left all the same.
    """
    places, settings = prepared.places, prepared.settings
    if traces:
        return [UnexplainedResidual(*places[trace.row], trace.regime, trace.rmse) for trace in traces]
    least = settings.judgement.least_shrink * before.excess[before.significant].sum()
    much = before.significant & (after.excess > least)
    much[list(kept)] = True
    rows = [int(r) for r in np.argsort(-after.excess) if much[r]]
    followed = [
        shares(prepared.validation, residuals, row, prepared.gear_ratios(row), settings.regimes) for row in rows
    ]
    return [
        UnexplainedResidual(*places[row], regime(found, settings.regimes), float(after.rmse[row]))
        for row, found in zip(rows, followed, strict=True)
    ]


def _sizes(prepared: PreparedData, statistics: ResidualStatistics) -> ResidualSizes:
    return ResidualSizes(_by_live_place(prepared, statistics.rmse), _by_live_place(prepared, statistics.peak))


def _by_live_place(prepared: PreparedData, values: Array) -> dict[tuple[str, str], float]:
    """Return numbers (R,) by joint and side, without those of equations that a joint lacks."""
    layout = prepared.validation.layout
    return dict(zip(layout.places(prepared.model.robot.joint_names), values[layout.live].tolist(), strict=True))


def _context(
    prepared: PreparedData,
    judgement: Judgement,
    estimated: EstimatedHypothesis,
    ranked: Sequence[RankedCause],
    after: list[Array],
) -> DiagnosisContext:
    library, hypothesis = prepared.library, estimated.hypothesis
    before = prepared.described_residuals(judgement.hypothesis.baseline)
    rows = range(len(prepared.places))
    ratios = [prepared.gear_ratios(row) for row in rows]
    regimes = prepared.settings.regimes
    return DiagnosisContext(
        model=prepared.model,
        fitted=prepared.model if estimated.final is None else estimated.final.fit.found.expansion.model,
        validate=prepared.validation,
        before=before,
        after=after,
        selected=tuple(r.candidate for r in ranked),
        alone=tuple(r.alone for r in ranked),
        regimes=tuple(shares(prepared.validation, before, row, ratios[row], regimes) for row in rows),
        library=library,
        seen=prepared.observed,
        faults=_agreements_of_faults(estimated),
        late=prepared.found.expansion.late,
        held_back=prepared.calibration.held_back,
        given=tuple(hypothesis.baseline),
        known=estimated.instances[: hypothesis.given],
        unseen=prepared.unseen,
        rivals=tuple(r.rivals for r in ranked),
        settings=prepared.settings,
    )


def _agreements_of_faults(estimated: EstimatedHypothesis) -> dict[Key, Agreement]:
    """Return how the faults came out in each recording, by key; nothing of a single recording."""
    final = estimated.final
    compared = () if final is None else ((fault.feature.key, final.agreement(fault)) for fault in estimated.faults)
    return {key: one for key, one in compared if one is not None}
