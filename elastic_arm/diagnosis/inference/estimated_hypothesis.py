"""The parameters of a judged hypothesis, and its effects as the simulator takes them."""

from __future__ import annotations

from dataclasses import dataclass

from elastic_arm.diagnosis import format as texts
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
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
    """

    hypothesis: Hypothesis
    parameters: tuple[dict[str, ParameterEstimate], ...]
    instances: tuple[EffectInstance, ...]
    notes: tuple[str, ...]


def estimate(prepared: PreparedData, hypothesis: Hypothesis) -> EstimatedHypothesis:
    """Bring all parameters to their joint optimum, with standard deviations."""
    polished = prepared.estimates.polished(hypothesis.selected)
    parameters = prepared.estimates.parameters(hypothesis.selected)
    fitted = zip(polished, prepared.library.coefficients(polished), strict=True)
    # Of effects that count as part of the model only the kind was given: their sizes are worth a note.
    known = list(zip(polished, parameters, strict=True))[: len(prepared.given)]
    return EstimatedHypothesis(
        Hypothesis(polished, hypothesis.given, hypothesis.rivals, hypothesis.beyond),
        tuple(parameters),
        tuple(c.feature.instance([float(v) for v in beta], c.searched or ()) for c, beta in fitted),
        tuple(texts.known_effect_note(c.feature, values) for c, values in known),
    )
