"""Everything beside the causes that passed: residuals made anew there, causes, nuisance parameters and faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.calibrate import posterior
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.calibration.recalibration import FinalFit, final_fit, is_of
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.joint_estimates import JointEstimates
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.selection.tangents import tangents
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FinalEstimates:
    """Everything beside the causes that passed.

    Parameters
    ----------
    fit
        Residuals and columns.
    estimates
        Of the causes.
    deviations, stds
        (k,) of the nuisance parameters from the description, in their units.
    """

    fit: FinalFit
    estimates: JointEstimates
    deviations: Array
    stds: Array

    def measured(self, fault: LargeImperfection) -> LargeImperfection:
        """Return a fault of a sensor as it comes out here."""
        own = [is_of(p, fault.feature) for p in self.fit.problem.parameters]
        value = float(np.average(self.deviations[own], weights=self.stds[own] ** -2.0))
        return fault.of_size(value, float(self.stds[own].min()))

    def is_nothing(self, fault: LargeImperfection) -> bool:
        """Whether a fault, as it came out here, may be none."""
        return abs(fault.value) < self.fit.problem.settings.refit.certain * fault.std

    def is_no_fault(self, fault: LargeImperfection) -> bool:
        """Whether it may be none, or is within its prior here; of lags and link encoders, what they do decides."""
        if self.is_nothing(fault):
            return True
        if fault.feature.effect.ordinary is not None or "q" in fault.feature.sensed:
            return False
        return self._parameter(fault).is_ordinary(fault.value, fault.std, self.fit.problem.settings.refit)

    def wider(self, faults: Sequence[Feature]) -> dict[int, float]:
        """Return how much wider than ordinary the priors of faults are, by number of the nuisance parameter."""
        parameters = enumerate(self.fit.problem.parameters)
        return {k: p.widened for k, p in parameters if any(is_of(p, fault) for fault in faults)}

    def is_gone(self, fault: LargeImperfection, values: Array, stds: Array) -> bool:
        """Whether a fault is none with other values of the nuisance parameters.

        One beyond ordinary is none if it may be ordinary with them; one of ordinary size, as a lag, if it may be zero.

        Parameters
        ----------
        fault
            A sensor or a number of the arm.
        values, stds
            (k,) relative to where the model stands, in standard deviations of the priors.
        """
        scale = np.array([p.prior_std for p in self.fit.problem.parameters])
        other = replace(self, deviations=(self.fit.found.values + values) * scale, stds=stds * scale).measured(fault)
        own, settings = self._parameter(fault), self.fit.problem.settings.refit
        # An encoder's error or a lag that matters is a cause though it is ordinary.
        if own.is_ordinary(fault.value, fault.std, settings):
            return self.is_nothing(other)
        ordinary = replace(own, prior_std=own.ordinary_std, widened=1.0)
        return ordinary.is_ordinary(other.value, other.std, settings)

    def _parameter(self, fault: LargeImperfection) -> NuisanceParameter:
        """Return the nuisance parameter that a fault is; of one that all joints have, that with the widest prior."""
        own = [parameter for parameter in self.fit.problem.parameters if is_of(parameter, fault.feature)]
        return max(own, key=lambda parameter: parameter.ordinary_std)


def final_estimates(
    prepared: PreparedData, selected: Sequence[Candidate], faults: Sequence[LargeImperfection]
) -> FinalEstimates:
    """Return the final estimates beside causes and faults.

    Parameters
    ----------
    prepared
        Data and regressors.
    selected
        Known effects and causes.
    faults
        Nuisance parameters beyond ordinary.
    """
    fit = final_fit(prepared, selected, [fault.feature for fault in faults])
    library = fit.found.library
    joint = JointEstimates(library, prepared.settings.judgement)
    polished = joint.polished(fit.selected)
    values, stds = posterior(library, [*polished, *tangents(library, polished)], prepared.settings)
    scale = np.array([p.prior_std for p in fit.problem.parameters])
    return FinalEstimates(fit, joint, (fit.found.values + values) * scale, stds * scale)
