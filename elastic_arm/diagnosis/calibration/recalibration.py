"""The calibration once more: beside the causes that were found, and of sensors that are beyond ordinary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.calibrate import calibrate
from elastic_arm.diagnosis.calibration.expansion import Expansion, expand
from elastic_arm.diagnosis.calibration.linearisation import Linearised, linearise
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter, drift_curves
from elastic_arm.diagnosis.calibration.problem import CalibrationProblem
from elastic_arm.diagnosis.calibration.torque_filters import filters_for_lags
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.settings import RefitSettings
from elastic_arm.effects.model import SensorEffect
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.noise_colour import Colour

Array = NDArray[np.float64]


def recalibrated(
    prepared: PreparedData,
    hypothesis: Hypothesis,
    colours: Sequence[Colour] | None = None,
    faulty: Sequence[Feature] = (),
    *,
    scaled: bool = False,
    scales: Array | None = None,
) -> tuple[PreparedData, Hypothesis]:
    """Return the data where the model and its sensors lie most probably beside the causes of a hypothesis.

    Beside it that hypothesis there, without rivals. Its causes are among the candidates as they were found.

    Parameters
    ----------
    prepared
        Data and regressors.
    hypothesis
        The known effects and the causes.
    colours
        Of the torque sensors' noise on identification and validation data; as it was where None.
    faulty
        Nuisance parameters beyond ordinary.
    scaled
        As of :func:`~elastic_arm.diagnosis.calibration.calibrate.calibrate`.
    scales
        (R,) by how many times more each whitened row scatters than noise, beside the others; as it was where None.
    """
    refit = prepared.settings.refit
    causes, noise = [hypothesis.selected[k] for k in hypothesis.causes], 1.0
    problem, expansion = _with_wide_priors(prepared.calibration, prepared.found.expansion, faulty)
    values, causes = filters_for_lags(problem.parameters, expansion.values, causes)
    if np.any(values != expansion.values):
        expansion = expand(problem, values, expansion, expansion.acting)
    if colours is not None:
        # Found in torques without gain; the recorded ones have the gain again.
        recorded = [
            colour.divided({name: 1.0 / gain for name, gain in part[0].gains.items()})
            for part, colour in zip(prepared.observed, colours, strict=True)
        ]
        observed = [[replace(o, colour=c) for o in part] for part, c in zip(problem.observed, recorded, strict=True)]
        problem = replace(problem, observed=observed)
    if scales is not None:
        problem = replace(problem, scales=scales)
    if colours is not None or scales is not None:
        expansion = expand(problem, expansion.values, expansion, expansion.acting)
    if problem.parameters:
        expansion, noise, causes = calibrate(problem, expansion, causes, scaled=scaled)
        if (own := but_for_common_scale(problem.parameters, expansion.values, faulty, refit)) is not faulty:
            return recalibrated(prepared, hypothesis, colours, own, scaled=scaled, scales=scales)
    found, again = linearise(problem, expansion, prepared.candidates, causes, noise=noise)
    beside = Hypothesis((*found.given, *again), len(found.given), beyond=hypothesis.beyond)
    return replace(prepared, calibration=problem, found=found), beside


@dataclass(frozen=True)
class FinalFit:
    """Residuals and columns beside the causes that passed, and nothing else.

    Parameters
    ----------
    problem
        What was calibrated; what is beyond ordinary has hardly any prior.
    found
        Residuals and columns where the nuisance parameters lie beside the causes.
    selected
        Known effects and causes, in their order.
    """

    problem: CalibrationProblem
    found: Linearised
    selected: tuple[Candidate, ...]

    @property
    def recordings_of_rows(self) -> NDArray[np.intp]:
        """Number of the recording (rows,) to which each whitened row of both data sets belongs."""
        of_sets = zip(self.found.library.sets, self.problem.numbers, strict=True)
        return np.concatenate([d.of_stretches([numbers[part.recording] for part in d.parts]) for d, numbers in of_sets])


def final_fit(
    prepared: PreparedData, selected: Sequence[Candidate], faulty: Sequence[Feature], near: FinalFit | None = None
) -> FinalFit:
    """Return the data on which causes are estimated: what sensors' gains scale, they scale of the causes, too.

    Parameters
    ----------
    prepared
        Data and regressors.
    selected
        Known effects and the causes that passed.
    faulty
        Nuisance parameters beyond ordinary.
    near
        Another one of these effects with some of what is beyond ordinary, where to begin.
    """
    given, refit = selected, prepared.settings.refit
    if near is not None:
        problem, start = _with_wide_priors(near.problem, near.found.expansion, faulty)
        selected = near.selected
    else:
        problem, start = _with_wide_priors(prepared.calibration, prepared.found.expansion, faulty)
        if curves := _curves(prepared, selected):
            problem = problem.extended(curves)
            start = expand(problem, np.append(start.values, np.zeros(len(curves))), None, start.acting)
    expansion, noise, causes = calibrate(problem, start, selected[len(prepared.given) :], scaled=True)
    if (own := but_for_common_scale(problem.parameters, expansion.values, faulty, refit)) is not faulty:
        return final_fit(prepared, given, own, near)
    found, again = linearise(problem, expansion, (), causes, noise=noise)
    return FinalFit(problem, found, (*found.given, *again))


def _with_wide_priors(
    problem: CalibrationProblem, start: Expansion, faulty: Sequence[Feature]
) -> tuple[CalibrationProblem, Expansion]:
    """Return a calibration in which what is beyond ordinary has hardly any prior, and where it begins."""
    # What was found to be faulty before is so already.
    wide = np.array([p.widened == 1.0 and any(is_of(p, fault) for fault in faulty) for p in problem.parameters])
    if not wide.any():
        return problem, start
    width = problem.settings.refit.fault_width
    parameters = tuple(p.of_fault(width) if w else p for p, w in zip(problem.parameters, wide, strict=True))
    factors = np.where(wide, width, 1.0)
    return replace(problem, parameters=parameters, directions=problem.directions * factors), start.widened(factors)


def but_for_common_scale(
    parameters: Sequence[NuisanceParameter], values: Array, faulty: Sequence[Feature], settings: RefitSettings
) -> Sequence[Feature]:
    """Return what is beyond ordinary without gains that came out alike on most torque channels; it where none is.

    Torques, masses, stiffnesses and friction times a factor are the same motion: no recording shows a common scale, but
    the ordinary priors of all gains do. Without most of them it goes where what nothing explains is least unlikely, and
    takes the gains along that still have theirs.

    Parameters
    ----------
    parameters
        The nuisance parameters.
    values
        (k,) where they came out, in standard deviations of the priors.
    faulty
        Beyond ordinary.
    settings
        How far an ordinary number may be off.
    """
    gains = [(p, 1.0 + float(v) * p.prior_std) for p, v in zip(parameters, values, strict=True) if p.is_gain]
    most = settings.beyond_ordinary
    near = [[abs(gain / other - 1.0) <= most * p.ordinary_std for p, gain in gains] for _, other in gains]
    alike = np.array(max(near, key=sum, default=[]), dtype=bool)
    shared = [pair for pair, one in zip(gains, alike, strict=True) if one]
    # A gain that kept its prior and yet is another one than these tells the scale: then they are off.
    told = any(p.widened == 1.0 for (p, _), one in zip(gains, alike, strict=True) if not one)
    if told or len(shared) < max(2, len(gains) // 2 + 1):
        return faulty
    weights = np.array([p.ordinary_std**-2.0 for p, _ in shared])
    scale = float(np.average([gain for _, gain in shared], weights=weights))
    left = [fault for fault in faulty if not any(is_of(p, fault) for p, _ in shared)]
    is_ordinary = abs(scale - 1.0) <= most * weights.sum() ** -0.5
    return faulty if is_ordinary or len(left) == len(faulty) else left


def _curves(prepared: PreparedData, selected: Sequence[Candidate]) -> list[NuisanceParameter]:
    """Return how the zeros that drift wander beside their mean rates."""
    found: list[NuisanceParameter] = []
    for candidate, beta in zip(selected, prepared.library.coefficients(selected), strict=True):
        feature = candidate.feature
        if isinstance(feature.effect, SensorEffect) and feature.effect.in_time:
            # The rate is a coefficient, or a searched number of the whole law.
            values = feature.parameters([float(v) for v in beta], candidate.searched or ())
            by_rate = Feature(feature.effect, feature.joint, feature.choices, feature.equations, feature.friction)
            found += drift_curves(by_rate, float(values[by_rate.linear[0].name]), prepared.settings.refit)
    return found


def is_of(parameter: NuisanceParameter, fault: Feature) -> bool:
    """Whether a nuisance parameter is a fault, on its joint or on all of them."""
    own = parameter.cause
    if own is None or fault.joint not in (None, own.joint):
        return False
    return (own.key[0], own.key[2]) == (fault.key[0], fault.key[2])
