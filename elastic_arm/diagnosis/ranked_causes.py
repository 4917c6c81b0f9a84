"""The causes as they are reported: ranked by what each takes off the gap, with the confidence that is left to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.faults import LargeImperfection, with_faults
from elastic_arm.diagnosis.inference.judgement import Judgement
from elastic_arm.diagnosis.laws.better_laws import BetterLaws
from elastic_arm.diagnosis.mounted_arm import cause_of_mounting
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.result import Alternative, Cause
from elastic_arm.diagnosis.selection.beyond_ordinary import freed, rivals_of_number
from elastic_arm.diagnosis.selection.hypothesis import Rival
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects import Effect
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]

MOST_NATS = 700.0  # of which the exponential is a number
_SAME_EFFECT = "motion in which these joints move one at a time"
_OTHERWISE = "motion that covers more of the joint's range, speeds and loads, slowly and fast"


@dataclass(frozen=True)
class RankedCause:
    """A cause with what figures and the next experiment need of it.

    Parameters
    ----------
    cause
        As in the result.
    candidate, rivals
        As it was fitted, and its alternatives in their order.
    alone
        Residuals (N', R) of each validation stretch with this cause alone added, Nm.
    """

    cause: Cause
    candidate: Candidate
    rivals: tuple[Candidate, ...]
    alone: list[Array]

    def less_sure(self, share: float) -> RankedCause:
        """Return it with the confidences of its cause reduced to a share."""
        return replace(self, cause=self.cause.less_sure(share))

    def against(self, laws: BetterLaws) -> RankedCause:
        """Return it with the confidence that it has against a general law in its place."""
        key, cause = self.candidate.feature.key, self.cause
        if key in laws.filters:
            filtered = laws.filters[key]
            if filtered.odds > 1.0:
                cause = _as_low_pass(cause, filtered)
            else:
                feature = filtered.candidate.feature
                same = [a for a in cause.alternatives if (a.effect, a.joint) == (feature.effect.id, feature.joint)]
                # What the search gave to both is shared anew: it was decided by other columns.
                sure = (cause.confidence + sum(a.confidence for a in same)) / (1.0 + filtered.odds)
                kept = [a for a in cause.alternatives if a not in same]
                other = _alternative(filtered, sure, self.candidate)
                cause = replace(cause, confidence=sure, alternatives=(*kept, other))
        if key in laws.instead:
            cause = cause.against(float(np.exp(min(laws.instead[key].gain, MOST_NATS))))
        return replace(self, cause=cause)


def _as_low_pass(cause: Cause, low_pass: Rival) -> Cause:
    """Return a delay as the low pass that is likelier, with the delay for an alternative.

    Parameters
    ----------
    cause
        The delay T; to first order, a low pass of 1 / (2 pi T) is as late.
    low_pass
        With its odds against the delay.
    """
    feature, (delay,) = low_pass.candidate.feature, cause.parameters.values()
    (cutoff,) = low_pass.candidate.searched or (np.inf,)
    size = ParameterEstimate(cutoff, cutoff * delay.std / delay.value, "Hz")
    separated = separated_by(feature.effect, cause.instance.effect, feature.joint, cause.joint)
    sure = cause.confidence * low_pass.odds / (1.0 + low_pass.odds)
    delayed = Alternative(cause.effect, cause.joint, cause.confidence / (1.0 + low_pass.odds), separated)
    return replace(
        cause,
        effect=feature.effect.id,
        parameters={feature.effect.parameters[0].name: size},
        confidence=sure,
        alternatives=(*cause.alternatives, delayed),
        instance=feature.instance([], (cutoff,)),
    )


def listed_causes(
    prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis, laws: BetterLaws
) -> list[RankedCause]:
    """Return all causes, main ones first.

    Parameters
    ----------
    prepared
        Data and regressors.
    judgement
        The measure of the gap.
    estimated
        The causes and faults with their parameters.
    laws
        General laws that explain more than they do.
    """
    causes = [*_found_causes(prepared, estimated, judgement), *_fault_causes(prepared, judgement, estimated, laws)]
    causes += _mounting_causes(prepared, judgement, estimated)
    ranked = [cause.against(laws) for cause in causes]
    kept = [one for one in ranked if is_listed(one, laws, prepared.settings.judgement.least_listed)]
    return sorted(kept, key=lambda one: -one.cause.shrink)


def is_listed(ranked: RankedCause, laws: BetterLaws, least: float) -> bool:
    """Whether a cause is worth its line beside the general laws.

    One that is nothing like the law in its place is not, nor is a small term of friction in the place of a law: such a
    term is listed only where it is there beyond doubt.

    Parameters
    ----------
    ranked
        The cause, with the confidence that it has against them.
    laws
        General laws that explain more than causes do.
    least
        Confidence from which a cause is listed in any case.
    """
    key, cause = ranked.candidate.feature.key, ranked.cause
    if cause.minor and key in laws.instead:
        return False
    return cause.confidence >= least or key in laws.approximated


def _found_causes(prepared: PreparedData, estimated: EstimatedHypothesis, judgement: Judgement) -> list[RankedCause]:
    """Return the causes of the hypothesis."""
    hypothesis, measure, found = estimated.hypothesis, judgement.measure, []
    for k in hypothesis.causes:
        candidate, rivals = hypothesis.selected[k], hypothesis.rivals.get(k, ())
        alone = [*hypothesis.baseline, candidate]
        others = _others(prepared, rivals, candidate.feature)
        # Alone, neither the faults nor the mounting are added.
        residuals = with_faults(prepared.described_residuals(alone), judgement.faults)
        together = measure.name == "excess" and (bool(judgement.faults) or prepared.mounting is not None)
        share = measure.share_left(residuals) if together else measure.share(alone)[0]
        cause = _cause(prepared, estimated, k, share, rivals, others)
        cause = cause.against(estimated.crude.get(candidate.feature.key, 0.0))
        cause = replace(cause, minor=candidate.feature.key in judgement.minor)
        found.append(RankedCause(cause, candidate, tuple(other.candidate for other in others), residuals))
    return found


def _fault_causes(
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
    least = prepared.settings.judgement.least_listed
    left = prepared.described_residuals(estimated.hypothesis.baseline)
    for fault in (each for each in estimated.faults if each.feature.key not in laws.instead):
        feature = fault.feature
        alone = with_faults(left, [other for other in estimated.faults if other is not fault])
        share = judgement.measure.share_of_fault(fault, alone)
        name, unit = feature.linear[0].name, feature.unit(feature.linear[0])
        candidate = library.add(feature, ())
        library.close()
        rivals = _of_links(prepared, estimated, fault)
        others = _others(prepared, rivals, feature)
        share_of_all = fault.confidence / (1.0 + sum(r.odds for r in rivals))
        cause = Cause(
            effect=feature.effect.id,
            joint=feature.joint,
            sides=tuple(side for side in feature.sides if side in sides) or feature.sides,
            regime=feature.effect.regime,
            parameters={name: ParameterEstimate(fault.size, fault.std, unit)},
            shrink=share,
            confidence=float(np.clip(share_of_all, least, 1.0 - least)),
            alternatives=tuple(_alternative(r, share_of_all, candidate) for r in others),
            instance=fault.instance,
            refitted=bool(feature.effect.number),
        )
        # The next experiment takes all columns of an effect, not that of one number.
        wholes = tuple(c if c.searched else library.add(c.feature, ()) for c in (other.candidate for other in others))
        library.close()
        found.append(RankedCause(cause, candidate, wholes, alone))
    return found


def _mounting_causes(prepared: PreparedData, judgement: Judgement, estimated: EstimatedHypothesis) -> list[RankedCause]:
    """Return the tilt of an arm that is mounted otherwise than described."""
    mounting, candidate, baseline = prepared.mounting, prepared.tilt, estimated.hypothesis.baseline
    if mounting is None or candidate is None:
        return []
    rest = estimated.parameters[list(prepared.given).index(candidate)]
    sure = 1.0 - prepared.settings.judgement.least_listed
    alone = with_faults(prepared.library.validation_residuals(baseline), estimated.faults)
    cause = cause_of_mounting(mounting, candidate.feature, rest, judgement.measure.share_left(alone), sure)
    own = next(one for one in baseline if one.feature.key == candidate.feature.key)
    return [RankedCause(cause, own, (), alone)]


def _of_links(prepared: PreparedData, estimated: EstimatedHypothesis, fault: LargeImperfection) -> list[Rival]:
    """Return the payloads, masses of other links and the like that could stand in the place of a link's mass."""
    if fault.feature.effect.sides != ("link",) or not fault.feature.effect.number:
        return []
    library, keys = prepared.library, {other.feature.key for other in estimated.faults}
    numbers = [
        freed(library, k, p.ordinary_std, p.cause)
        for k, p in enumerate(prepared.calibration.parameters)
        if p.cause is not None and (p.cause.key in keys or p.cause.effect.id == fault.feature.effect.id)
    ]
    library.close()
    own = next(number for number in numbers if number.feature.key == fault.feature.key)
    faults = [number for number in numbers if number.feature.key in keys and number is not own]
    others = [number for number in numbers if number.feature.key not in keys]
    beside = replace(estimated.hypothesis, selected=[*estimated.hypothesis.selected, *faults])
    return rivals_of_number(library, beside, own, others, prepared.settings)


def _cause(
    prepared: PreparedData,
    estimated: EstimatedHypothesis,
    k: int,
    share: float,
    rivals: Sequence[Rival],
    others: Sequence[Rival],
) -> Cause:
    feature = estimated.hypothesis.selected[k].feature
    share_of_all = 1.0 / (1.0 + sum(r.odds for r in rivals))
    # The same effect on the other side of the drive, or in other channels too, is no other cause.
    same = [r for r in rivals if _is_same(r, feature)]
    doubtful = [r.candidate.feature for r in same if r.odds > prepared.settings.judgement.same_odds]
    return Cause(
        effect=feature.effect.id,
        joint=feature.joint,
        sides=_sides(prepared, [feature, *doubtful]),
        regime=feature.effect.regime,
        parameters=estimated.parameters[k],
        shrink=share,
        confidence=share_of_all * (1.0 + sum(r.odds for r in same)),
        alternatives=tuple(_alternative(r, share_of_all, estimated.hypothesis.selected[k]) for r in others),
        instance=estimated.instances[k],
    )


def _others(prepared: PreparedData, rivals: Sequence[Rival], feature: Feature) -> list[Rival]:
    """Return the other effects worth listing in the place of a cause, each on its likeliest side, with all its odds."""
    found: dict[tuple[str, str | None], Rival] = {}
    for rival in sorted((r for r in rivals if not _is_same(r, feature)), key=lambda r: -r.odds):
        key = (rival.candidate.feature.effect.id, rival.candidate.feature.joint)
        found[key] = replace(found[key], odds=found[key].odds + rival.odds) if key in found else rival
    least = prepared.settings.judgement.least_listed * (1.0 + sum(r.odds for r in rivals))
    return [other for other in found.values() if other.odds >= least]


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
    motion = separated_by(own.effect, other.effect, own.joint, other.joint)
    return Alternative(other.effect.id, other.joint, rival.odds * confidence, motion)


def separated_by(effect: Effect, other: Effect, joint: str | None, other_joint: str | None) -> str:
    """Return the motion that would discriminate between two effects, from the catalogue where it holds one.

    Parameters
    ----------
    effect, other
        The two.
    joint, other_joint
        Where they act; None for the whole arm.
    """
    for one, two in ((effect, other), (other, effect)):
        for confusion in one.confusions:
            if confusion.effect == two.id:
                return confusion.separated_by
    return _SAME_EFFECT if effect.id == other.id and joint != other_joint else _OTHERWISE
