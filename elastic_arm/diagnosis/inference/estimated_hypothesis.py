"""The parameters of a judged hypothesis, and its effects as the simulator takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.diagnosis import format as texts
from elastic_arm.diagnosis.calibration.calibrate import imperfections, posterior
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate, tangents
from elastic_arm.diagnosis.inference.joint_estimates import JointEstimates
from elastic_arm.diagnosis.inference.sensor_faults import SensorFault
from elastic_arm.diagnosis.preparation import FinalFit, PreparedData, final_fit, is_of
from elastic_arm.diagnosis.result import Imperfection
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects import EffectInstance


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
        What known effects came out as.
    imperfections
        What the recordings determine of each nuisance parameter.
    faults
        Faulty sensors, as they came out beside the causes.
    """

    hypothesis: Hypothesis
    parameters: tuple[dict[str, ParameterEstimate], ...]
    instances: tuple[EffectInstance, ...]
    notes: tuple[str, ...]
    imperfections: tuple[Imperfection, ...] = ()
    faults: tuple[SensorFault, ...] = ()


def estimate(prepared: PreparedData, hypothesis: Hypothesis, faults: Sequence[SensorFault] = ()) -> EstimatedHypothesis:
    """Bring all parameters to their joint optimum, with standard deviations.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        Known effects and the causes that passed.
    faults
        Of sensors: nuisance parameters beyond ordinary.
    """
    polished = prepared.estimates.polished(hypothesis.selected)
    library, own, joint = prepared.library, polished, prepared.estimates
    imperfect: tuple[Imperfection, ...] = ()
    selected: Sequence[Candidate] = hypothesis.selected
    if prepared.calibration.parameters:
        fit = final_fit(prepared, hypothesis.selected, [fault.feature for fault in faults])
        library, selected = fit.found.library, fit.selected
        joint = JointEstimates(library, prepared.settings.judgement)
        own = joint.polished(selected)
        free = tangents(library, own)
        imperfect, faults = _imperfect(fit, [*own, *free], faults)
    parameters = joint.parameters(selected)
    fitted = zip(own, library.coefficients(own), strict=True)
    # Of effects that count as part of the model only the kind was given: their sizes are worth a note.
    known = list(zip(own, parameters, strict=True))[: len(prepared.given)]
    return EstimatedHypothesis(
        Hypothesis(polished, hypothesis.given, hypothesis.rivals, hypothesis.beyond),
        tuple(parameters),
        tuple(c.feature.instance([float(v) for v in beta], c.searched or ()) for c, beta in fitted),
        tuple(texts.known_effect_note(c.feature, values) for c, values in known),
        imperfect,
        tuple(faults),
    )


def _imperfect(
    fit: FinalFit, selected: Sequence[Candidate], faults: Sequence[SensorFault]
) -> tuple[tuple[Imperfection, ...], tuple[SensorFault, ...]]:
    """Return what the recordings determine of all nuisance parameters, and of the faulty sensors among them."""
    problem, found = fit.problem, fit.found
    values, stds = posterior(found.library, selected, problem.settings)
    scale = np.array([p.prior_std for p in problem.parameters])
    deviations, stds = (found.values + values) * scale, stds * scale
    again = []
    for fault in faults:
        own = [is_of(p, fault.feature) for p in problem.parameters]
        weights = stds[own] ** -2.0
        value = float(np.average(deviations[own], weights=weights))
        again.append(replace(fault, value=value, std=float(stds[own].min())))
    return imperfections(problem, deviations, stds), tuple(again)
