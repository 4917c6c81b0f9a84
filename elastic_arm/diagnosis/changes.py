"""Changes between recordings of one arm: sizes that are not the same in all of them."""

from dataclasses import dataclass
from functools import partial
from operator import eq

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.diagnosis.estimates import estimated
from elastic_arm.diagnosis.result import Change
from elastic_arm.evidence.explanation import Explanation
from elastic_arm.evidence.fit import Fit
from elastic_arm.evidence.problem import Problem
from elastic_arm.evidence.terms.change import ChangeTerm
from elastic_arm.evidence.terms.effect import EffectTerm
from elastic_arm.evidence.terms.known import StatedTerm
from elastic_arm.evidence.terms.number import NumberTerm


def changes_between(explanation: Explanation, problem: Problem) -> tuple[Change, ...]:
    """Return the causes and known effects whose size probably differs between fitted
    recordings."""
    found = []
    for term in (t for t in explanation.best.optional if isinstance(t, ChangeTerm)):
        probability = explanation.probability(partial(eq, term.key))
        if probability > 0.5:
            found.append(_change(explanation, problem, explanation.best, term, probability))
    return tuple(found)


@dataclass(frozen=True)
class SizedTerm:
    """The size of a term in each recording: values (n,) and covariance (n, n)."""

    effect: str
    joint: str | None
    parameter: str
    unit: str
    values: Array
    covariance: Array

    @property
    def stds(self) -> Array:
        """Standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def sizes_of(explanation: Explanation, problem: Problem, fit: Fit, term: ChangeTerm) -> SizedTerm:
    """Return the sizes of the term that changes by a term of a fit."""
    common = term.common(fit.terms)
    assert common is not None
    base = fit.slices[common.ident].start
    own = fit.slices[term.ident].start
    size = term.count // len(problem.sources)
    parameters, _ = estimated(fit, common, problem.numbers, explanation.linear.values)
    name, first = next(iter(parameters.items()))
    scale = 1.0
    at = 0.0
    if isinstance(common, NumberTerm):
        k = int(np.flatnonzero(common.along[:, 0])[0])
        ordinary = float(explanation.linear.values[k] + (fit.numbers - fit.far_off)[k])
        at = problem.numbers[k].value(ordinary)
        scale = problem.numbers[k].slope(ordinary)
    elif isinstance(common, EffectTerm) and common.bends:
        at = common.theta[0]
    elif isinstance(common, EffectTerm):
        at = common.feature.linear[0].neutral or 0.0
    together = np.zeros((len(problem.observed[0]), len(fit.found.x)))
    together[:, base] = 1.0
    for more in fit.terms:  # the deviation of a stated size
        if isinstance(more, StatedTerm) and more.key == common.key:
            together[:, fit.slices[more.ident].start] = 1.0
    for k in range(len(together)):
        together[k, own + k * size] = 1.0
    values = at + scale * (together @ fit.found.x)
    covariance = scale**2 * (together @ fit.found.S @ together.T)
    return SizedTerm(common.key[0], common.key[1], name, first.unit, values, covariance)


def _change(
    explanation: Explanation, problem: Problem, fit: Fit, term: ChangeTerm, confidence: float
) -> Change:
    sized = sizes_of(explanation, problem, fit, term)
    sources = [one.source for one in problem.observed[0]]
    values = tuple(zip(sources, sized.values.tolist(), sized.stds.tolist(), strict=True))
    return Change(sized.effect, sized.joint, sized.parameter, sized.unit, values, confidence)
