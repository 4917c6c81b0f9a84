"""The parameters of a judged hypothesis, and its effects as the simulator takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from elastic_arm.diagnosis.calibration.calibrate import imperfections
from elastic_arm.diagnosis.calibration.recalibration import is_of
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.faults import LargeImperfection, faults_beside
from elastic_arm.diagnosis.inference.final_estimates import FinalEstimates, final_estimates
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.result import Imperfection
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key
from elastic_arm.diagnosis.selection.plausible_hypothesis import turns_over
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.selection.tangents import tangents
from elastic_arm.diagnosis.texts.notes import crude_note, differing_note, known_effect_note
from elastic_arm.effects import EffectInstance

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimatedHypothesis:
    """A hypothesis at the joint optimum of all its parameters.

    Parameters
    ----------
    hypothesis
        The candidates, polished.
    parameters
        Of each candidate, with standard deviations.
    instances
        Each candidate as the simulator takes it.
    notes
        On what is far off and yet no cause, and what known effects came out as.
    imperfections
        What the recordings determine of each nuisance parameter.
    faults
        As they came out beside the causes.
    optimum
        The candidates where their parameters were determined, with the derivatives by these.
    final
        Where that was; None where nothing is calibrated, which is where the search was.
    impossible
        Notes on the causes, by key, with numbers there that no such arm has.
    crude
        Odds, by key, of a description that is further off than ordinary ones, against causes that load the links.
    """

    hypothesis: Hypothesis
    parameters: tuple[dict[str, ParameterEstimate], ...]
    instances: tuple[EffectInstance, ...]
    notes: tuple[str, ...]
    imperfections: tuple[Imperfection, ...] = ()
    faults: tuple[LargeImperfection, ...] = ()
    optimum: tuple[Candidate, ...] = ()
    final: FinalEstimates | None = None
    impossible: Mapping[Key, str] = field(default_factory=dict)
    crude: Mapping[Key, float] = field(default_factory=dict)


def estimate(
    prepared: PreparedData, hypothesis: Hypothesis, faults: Sequence[LargeImperfection] = ()
) -> EstimatedHypothesis:
    """Bring all parameters to their joint optimum, with standard deviations.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        Known effects and the causes that passed.
    faults
        Nuisance parameters beyond ordinary.
    """
    joint = prepared.estimates
    imperfect: tuple[Imperfection, ...] = ()
    last: FinalEstimates | None = None
    notes: list[str] = []
    library, selected = prepared.library, list(hypothesis.selected)
    if prepared.calibration.parameters:
        hypothesis, last, faults, notes = _that_last(prepared, hypothesis, faults)
        joint, library, selected = last.estimates, last.fit.found.library, list(last.fit.selected)
        imperfect = imperfections(last.fit.problem, last.deviations, last.stds)
    crude = {} if last is None else _odds_of_crude_description(last, hypothesis)
    notes += [crude_note(c.feature) for c in hypothesis.selected if crude.get(c.feature.key, 0.0) > 1.0]
    polished = prepared.estimates.polished(hypothesis.selected)
    own, parameters = joint.polished(selected), joint.parameters(selected)
    fitted = zip(own, library.coefficients(own), strict=True)
    # Of effects that count as part of the model only the kind was given: their sizes are worth a note.
    known = list(zip(own, parameters, strict=True))[: len(prepared.given)]
    return EstimatedHypothesis(
        Hypothesis(polished, hypothesis.given, hypothesis.rivals, hypothesis.beyond),
        tuple(parameters),
        tuple(c.feature.instance([float(v) for v in beta], c.searched or ()) for c, beta in fitted),
        (*notes, *(known_effect_note(c.feature, values) for c, values in known if not _is_of_mounting(prepared, c))),
        imperfect,
        tuple(faults),
        (*own, *tangents(library, own)),
        last,
        prepared.sizes.notes(hypothesis, parameters),
        crude,
    )


def _odds_of_crude_description(found: FinalEstimates, hypothesis: Hypothesis) -> dict[Key, float]:
    """Return the odds of a description that is further off than ordinary ones, against causes that load the links."""
    features = [hypothesis.selected[k].feature for k in hypothesis.causes]
    return {
        feature.key: found.odds_of_crude_description_against(feature)
        for feature in features
        if feature.effect.sides == ("link",) and not feature.effect.is_friction
    }


def _is_of_mounting(prepared: PreparedData, candidate: Candidate) -> bool:
    """Whether it is the tilt of an arm that is mounted otherwise than described: that is a cause."""
    return prepared.tilt is not None and candidate.feature.key == prepared.tilt.feature.key


def _that_last(
    prepared: PreparedData, hypothesis: Hypothesis, faults: Sequence[LargeImperfection]
) -> tuple[Hypothesis, FinalEstimates, list[LargeImperfection], list[str]]:
    """Return the causes and faults that are still there beside one another at last, with the final estimates.

    The last are notes on what is far off and yet no fault.
    """
    slowest, ratio_factor = prepared.library.nuisance.turned_over, prepared.settings.search.ratio_factor
    # A cause is one of many that were tried: what that costs in the search, it costs here.
    level = float(chi2.cdf(2.0 * prepared.settings.search.least_gain, 1))
    # What has no name is beyond ordinary all the same: held by its prior it would bend what has one.
    unnamed = faults_beside(prepared, hypothesis.selected, named=False)
    notes: dict[Key, str] = {}
    while True:
        found, kept = _beside_faults(prepared, hypothesis.selected, [*faults, *unnamed])
        selected, last = found.fit.selected, found.estimates
        gone = last.insignificant(selected, level) - found.needed()
        lost = [k for k in hypothesis.causes if k in gone or turns_over(last.polished(selected)[k], slowest)]
        there = [fault for fault in kept if fault.is_believable(ratio_factor) and not found.is_nothing(fault)]
        # Held by its prior, what is no fault of its own bends nothing that is one.
        notes |= {fault.feature.key: why for fault in there if (why := _refused(found, fault))}
        there = [fault for fault in there if fault.feature.key not in notes]
        if not lost and len(there) == len(kept):
            return hypothesis, found, [found.weighed(fault) for fault in kept], list(notes.values())
        faults = there
        # Without one of them another of the same joint may be clear: the last found, which gained least, goes first.
        last_found = {hypothesis.selected[k].feature.joint: k for k in lost}
        for k in sorted(last_found.values(), reverse=True):
            hypothesis = hypothesis.drop(k)


def _refused(found: FinalEstimates, fault: LargeImperfection) -> str:
    """Return why what is beyond ordinary is no fault of its own; empty where it is one."""
    agreement = found.agreement(fault)
    if agreement is not None and agreement.odds > 1.0:
        return differing_note(agreement)
    return crude_note(fault.feature) if found.odds_of_crude_description(fault) > 1.0 else ""


def _beside_faults(
    prepared: PreparedData, selected: Sequence[Candidate], faults: Sequence[LargeImperfection]
) -> tuple[FinalEstimates, list[LargeImperfection]]:
    """Return the final estimates, and the faults that may be causes: not those that the worst of all drew along."""
    parameters = prepared.calibration.parameters
    own = [max(p.ordinary_std for p in parameters if is_of(p, fault.feature)) for fault in faults]
    # By how unlikely what the recording shows is of an ordinary arm.
    order = np.argsort([-abs(fault.value) / np.hypot(fault.std, std) for fault, std in zip(faults, own, strict=True)])
    worst = [faults[k] for k in order[:1]]
    found = final_estimates(prepared, selected, worst)
    further = [found.measured(faults[k]) for k in order[1:]]
    kept = [fault for fault in further if not found.is_no_fault(fault)]
    if kept:
        found = final_estimates(prepared, selected, [*worst, *kept], near=found)
        kept = [fault for fault in kept if found.is_freed(fault)]
    last = [found.measured(fault) for fault in (*worst, *kept)]
    return found, [fault for fault in last if fault.feature.effect.searched]
