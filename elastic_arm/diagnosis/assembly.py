"""From judged and estimated causes to the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from elastic_arm.diagnosis import format as texts
from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.excess import ResidualStatistics, residual_statistics
from elastic_arm.diagnosis.inference.faults import with_faults
from elastic_arm.diagnosis.inference.gap_metric import GapMeasure
from elastic_arm.diagnosis.inference.judgement import Judgement, verdict
from elastic_arm.diagnosis.inference.lack_of_fit import LackOfFit, strongest
from elastic_arm.diagnosis.inference.place_gaps import PlaceGap, place_gaps
from elastic_arm.diagnosis.inference.regimes import regime, shares
from elastic_arm.diagnosis.laws.better_laws import NO_LAWS, BetterLaws, lacks_of_fit
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.result import (
    Alternative,
    Cause,
    Diagnosis,
    ResidualSizes,
    UnexplainedResidual,
    plain_parameters,
)
from elastic_arm.diagnosis.selection.hypothesis import Rival
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RankedCause:
    """A cause with what figures and the next experiment need of it.

    Parameters
    ----------
    cause
        As in the result.
    candidate, rivals
        As it was fitted, and what competes with it.
    alone
        Residuals (N', R) of each validation stretch with this cause alone added, Nm.
    """

    cause: Cause
    candidate: Candidate
    rivals: tuple[Candidate, ...]
    alone: list[Array]

    def against(self, laws: BetterLaws) -> RankedCause:
        """Return it with the confidence that it has against a general law in its place."""
        key, cause = self.candidate.feature.key, self.cause
        if key in laws.filters:
            sure = cause.confidence / (1.0 + laws.filters[key].odds)
            other = _alternative(laws.filters[key], sure, self.candidate)
            cause = replace(cause, confidence=sure, alternatives=(*cause.alternatives, other))
        if key in laws.instead:
            cause = cause.less_sure(float(expit(-laws.instead[key].gain)))
        return replace(self, cause=cause)


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
        General laws that explain more than they do.
    """
    settings, measure, library = prepared.settings, judgement.measure, prepared.library
    hypothesis = estimated.hypothesis
    ranked = ranked_causes(prepared, estimated, judgement)
    ranked = [r.against(laws) for r in (*ranked, *fault_causes(prepared, judgement, estimated, laws))]
    ranked.sort(key=lambda r: -r.cause.shrink)
    shrink, interval = measure.share(hypothesis.selected)
    stands_out = measure.stands_out(hypothesis.selected)
    # Known effects alone are linear: what they leave is what they left before they were polished.
    judged = hypothesis.selected if hypothesis.causes else judgement.hypothesis.selected
    traces = [] if stands_out else judgement.test(judged)
    residuals = library.validation_residuals(hypothesis.selected)
    by_place = _by_place(prepared, judgement, hypothesis.baseline, residuals)
    left = settings.judgement.place_explained
    answer = verdict(
        shrink,
        caused=bool(ranked),
        unexplained=stands_out or bool(traces) or laws.beside is not None,
        open_places=any(place.is_open(left) for place in by_place),
        refuted=bool(laws.instead),
        settings=settings.judgement,
    )
    # An incomplete hypothesis may owe its causes to what it lacks.
    sure = max(shrink, 0.0) if answer == "unknown" else None
    before = measure.before
    rng = settings.resampling.significance_rng()
    after = residual_statistics(prepared.validation, residuals, before.band, settings, rng)
    unexplained = _unexplained(prepared, before, after, residuals, traces, by_place) if answer == "unknown" else []
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
        causes=tuple(r.cause if sure is None else r.cause.less_sure(sure) for r in ranked),
        unexplained=tuple(with_laws(unexplained, prepared, laws) if answer == "unknown" else ()),
        imperfections=estimated.imperfections,
        known=_known(estimated),
        notes=_notes(prepared, judgement, estimated, laws),
        cumulative_shrink=cumulative_shrink(measure, hypothesis.baseline, [r.candidate for r in ranked]),
        context=_context(prepared, judgement, estimated, ranked, residuals),
    )


def with_laws(
    places: Sequence[UnexplainedResidual], prepared: PreparedData, laws: BetterLaws
) -> list[UnexplainedResidual]:
    """Return the places where something is left, those first where a law that no catalogue states shows most.

    Parameters
    ----------
    places
        Where residuals or general shapes show it.
    prepared
        Data and regressors.
    laws
        Laws that no catalogue states.
    """
    lacks = strongest(lacks_of_fit(prepared, laws.all))
    first = [UnexplainedResidual(*prepared.places[one.row], one.regime, one.rmse) for one in lacks]
    own = {(one.joint, one.side) for one in first}
    return [*first, *(one for one in places if (one.joint, one.side) not in own)]


def _notes(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws
) -> tuple[str, ...]:
    """Return what the reader should know, in the order of the steps."""
    imperfect = texts.imperfection_notes(estimated.imperfections)
    repeated = () if prepared.independent_motion else (texts.REPEATED_MOTION,)
    found = (*imperfect, *judgement.notes, *estimated.notes, *_law_notes(prepared, laws))
    return (*prepared.notes, *found, *repeated)


def _law_notes(prepared: PreparedData, laws: BetterLaws) -> list[str]:
    """Return a note on each general law that explains more than the causes."""
    names = prepared.model.robot.joint_names
    notes = [
        texts.refuted_note(effect, joint, names[fit.law.joint], fit.law, fit.gain)
        for (effect, joint, _), fit in laws.instead.items()
    ]
    if laws.beside is not None and not notes:
        notes = [texts.general_law_note(names[laws.beside.law.joint], laws.beside.law, laws.beside.gain)]
    return notes


def _known(estimated: EstimatedHypothesis) -> tuple[dict[str, Any], ...]:
    """Return what known effects came out as."""
    given = estimated.hypothesis.given
    return tuple(
        {
            "effect": instance.effect.id,
            "joint": instance.joint,
            "sides": list(instance.sides),
            "parameters": plain_parameters(parameters),
        }
        for instance, parameters in zip(estimated.instances[:given], estimated.parameters[:given], strict=True)
    )


def ranked_causes(prepared: PreparedData, estimated: EstimatedHypothesis, judgement: Judgement) -> list[RankedCause]:
    """Return the causes, those first that shrink the gap most alone.

    Parameters
    ----------
    prepared
        Data and regressors.
    estimated
        The causes with their parameters.
    judgement
        The measure of the gap, and which causes are minor.
    """
    hypothesis, measure, found = estimated.hypothesis, judgement.measure, []
    for k in hypothesis.causes:
        candidate, rivals = hypothesis.selected[k], hypothesis.rivals.get(k, ())
        alone = [*hypothesis.baseline, candidate]
        cause = _cause(prepared, estimated, k, measure.share(alone)[0], rivals)
        cause = replace(cause, minor=candidate.feature.key in judgement.minor)
        residuals = prepared.library.validation_residuals(alone)
        found.append(RankedCause(cause, candidate, tuple(r.candidate for r in rivals), residuals))
    return sorted(found, key=lambda one: -one.cause.shrink)


def fault_causes(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws
) -> list[RankedCause]:
    """Return the causes that are faults: sensors and numbers of the arm beyond ordinary.

    Parameters
    ----------
    prepared
        Data and regressors.
    judgement
        The gap without any of them.
    estimated
        The faults as they came out, and what counts as part of the model.
    laws
        General laws; what is ordinary beside one of them is no fault.
    """
    found, library, sides = [], prepared.library, prepared.validation.layout.sides
    left = library.validation_residuals(estimated.hypothesis.baseline)
    for fault in (each for each in estimated.faults if each.feature.key not in laws.instead):
        feature = fault.feature
        alone = with_faults(left, [other for other in estimated.faults if other is not fault])
        share = judgement.measure.share_of_fault(fault, alone)
        name, unit = feature.linear[0].name, feature.unit(feature.linear[0])
        cause = Cause(
            effect=feature.effect.id,
            joint=feature.joint,
            sides=tuple(side for side in feature.sides if side in sides) or feature.sides,
            regime=feature.effect.regime,
            parameters={name: ParameterEstimate(fault.size, fault.std, unit)},
            shrink=share,
            confidence=1.0 - prepared.settings.judgement.least_listed,
            alternatives=(),
            instance=fault.instance,
            refitted=bool(feature.effect.number),
        )
        candidate = library.add(feature, ())
        library.close()
        found.append(RankedCause(cause, candidate, (), alone))
    return found


def _cause(
    prepared: PreparedData, estimated: EstimatedHypothesis, k: int, share: float, rivals: Sequence[Rival]
) -> Cause:
    feature = estimated.hypothesis.selected[k].feature
    share_of_all = 1.0 / (1.0 + sum(r.odds for r in rivals))
    # The same effect on the other side of the drive, or in other channels too, is no other cause.
    same = [r for r in rivals if _is_same(r, feature)]
    doubtful = [r.candidate.feature for r in same if r.odds > prepared.settings.judgement.same_odds]
    listed = [r for r in rivals if r.odds * share_of_all >= prepared.settings.judgement.least_listed and r not in same]
    return Cause(
        effect=feature.effect.id,
        joint=feature.joint,
        sides=_sides(prepared, [feature, *doubtful]),
        regime=feature.effect.regime,
        parameters=estimated.parameters[k],
        shrink=share,
        confidence=share_of_all * (1.0 + sum(r.odds for r in same)),
        alternatives=tuple(_alternative(r, share_of_all, estimated.hypothesis.selected[k]) for r in listed),
        instance=estimated.instances[k],
    )


def _is_same(rival: Rival, feature: Feature) -> bool:
    """Whether a rival is the effect of the cause itself, on the same joint."""
    other = rival.candidate.feature
    return (other.effect.id, other.joint) == (feature.effect.id, feature.joint)


def _sides(prepared: PreparedData, features: Sequence[Feature]) -> tuple[str, ...]:
    """Return the sides on which one of these shows, as far as the recordings have their equations."""
    shown = dict.fromkeys(side for feature in features for side in feature.sides)
    return tuple(side for side in shown if side in prepared.validation.layout.sides) or tuple(shown)


def _alternative(rival: Rival, confidence: float, candidate: Candidate) -> Alternative:
    own, other = candidate.feature, rival.candidate.feature
    motion = texts.separated_by(own.effect, other.effect, own.joint, other.joint)
    return Alternative(other.effect.id, other.joint, rival.odds * confidence, motion)


def cumulative_shrink(
    measure: GapMeasure, baseline: Sequence[Candidate], causes: Sequence[Candidate]
) -> tuple[float, ...]:
    """Return how far the gap shrinks with the first cause, the first two, and so on.

    Parameters
    ----------
    measure
        What the gap is measured by.
    baseline
        What counts as part of the model.
    causes
        Most important first.
    """
    return tuple(measure.share([*baseline, *causes[: k + 1]])[0] for k in range(len(causes)))


def _by_place(
    prepared: PreparedData, judgement: Judgement, baseline: Sequence[Candidate], left: Sequence[Array]
) -> list[PlaceGap]:
    """Return the gap of each joint and side by itself; nothing where no residual shows it."""
    if judgement.measure.name != "excess":
        return []
    before = with_faults(prepared.library.validation_residuals(baseline), judgement.faults)
    return place_gaps(prepared.validation, before, left, prepared.settings)


def _unexplained(
    prepared: PreparedData,
    before: ResidualStatistics,
    after: ResidualStatistics,
    residuals: Sequence[Array],
    traces: Sequence[LackOfFit],
    by_place: Sequence[PlaceGap],
) -> list[UnexplainedResidual]:
    """Return where something is left: what follows a regime, else the residuals that keep much of a gap.

    That is too much of their own gap, or what is much of the whole one.
    """
    places, settings = prepared.places, prepared.settings
    if traces:
        return [UnexplainedResidual(*places[trace.row], trace.regime, trace.rmse) for trace in traces]
    least = settings.judgement.least_shrink * before.excess[before.significant].sum()
    much = before.significant & (after.excess > least)
    much[[place.row for place in by_place if place.is_open(settings.judgement.place_explained)]] = True
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
    before = library.validation_residuals(judgement.hypothesis.baseline)
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
        held_back=prepared.held_back,
        given=tuple(hypothesis.baseline),
        known=estimated.instances[: hypothesis.given],
        rivals=tuple(r.rivals for r in ranked),
        settings=prepared.settings,
    )
