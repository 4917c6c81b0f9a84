"""Everything beside the causes that passed: residuals made anew there, causes, nuisance parameters and faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from elastic_arm.diagnosis.calibration.calibrate import effective_noise, posterior
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.calibration.recalibration import FinalFit, final_fit, is_of
from elastic_arm.diagnosis.inference.across_recordings import compared
from elastic_arm.diagnosis.inference.estimates import Agreement, ParameterEstimate, RecordingEstimate
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.joint_estimates import JointEstimates
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.gram_fits import RANK, orthonormal_basis, regularised
from elastic_arm.diagnosis.selection.hypothesis import Key, misfit
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
    optimum
        Known effects and causes where they were determined, with the derivatives by their searched parameters.
    """

    fit: FinalFit
    estimates: JointEstimates
    deviations: Array
    stds: Array
    optimum: tuple[Candidate, ...]

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

    def agreement(self, fault: LargeImperfection) -> Agreement | None:
        """Return how a fault comes out in each recording beside everything else, which is common to all of them.

        None where there is one recording alone, and where each has its own fault anyway.
        """
        problem, feature = self.fit.problem, fault.feature
        recordings = sorted({*problem.numbers[0], *problem.numbers[1]})
        if len(recordings) < 2 or feature.effect.set_at_start:
            return None
        values, stds = self._by_recording(feature, recordings)
        parameter, neutral = feature.linear[0], feature.linear[0].neutral or 0.0
        findings = [
            RecordingEstimate(
                problem.sources[number],
                {parameter.name: ParameterEstimate(neutral + value, std, feature.unit(parameter))},
                0.5 * (value / std) ** 2,
            )
            for number, value, std in zip(recordings, values.tolist(), stds.tolist(), strict=True)
        ]
        return compared(feature, findings, problem.settings.agreement)

    def _by_recording(self, feature: Feature, recordings: Sequence[int]) -> tuple[Array, Array]:
        """Return deviations and standard deviations (r,) of a fault, had it another size in each recording."""
        problem, library = self.fit.problem, self.fit.found.library
        noise, residual, columns = self._noise, *self._regression
        own = np.array([is_of(p, feature) for p in problem.parameters])
        scale = np.array([p.prior_std for p in problem.parameters])
        of_rows = self.fit.recordings_of_rows
        white = np.vstack(library.nuisance.white)
        alone = np.sum(white[:, own] / scale[own], axis=1)[:, None] * (of_rows[:, None] == np.array(recordings))
        together = np.hstack([alone, white[:, ~own], columns])
        stands, count = float(np.mean((self.fit.found.values * scale)[own])), len(recordings)
        sizes = [count, int(np.count_nonzero(~own)), columns.shape[1]]
        precision = noise * np.repeat([scale[own].max() ** -2.0, 1.0, 0.0], sizes)
        centre = np.concatenate([np.full(count, -stands), library.nuisance.centre[~own], np.zeros(sizes[2])])
        gram = together.T @ together + np.diag(precision)
        values, stds = regularised(gram, together.T @ residual + precision * centre, RANK)
        return stands + values[:count], np.sqrt(noise) * stds[:count]

    def needed(self) -> set[int]:
        """Return the numbers of candidates that the likelihood requires where much is left unexplained.

        Standard deviations are then those of what is left, of one joint for all others, and a cause that takes most of
        its joint's torque may seem uncertain beside the friction that another joint lacks. Of several frictions of one
        joint the deviations say that the recordings hardly tell one from another: no other joint has a part in that.
        """
        library, selected, settings = self.fit.found.library, self.fit.selected, self.fit.problem.settings
        left = misfit(library, selected)
        if left <= settings.search.bent:
            return set()
        whole, least = library.both(selected), settings.significance.detected * left
        features = [candidate.feature for candidate in selected]
        kinds = [("" if one.effect.is_friction else one.effect.id, one.joint) for one in features]
        single = [k for k, kind in enumerate(kinds) if kinds.count(kind) == 1]
        return {k for k in single if whole - library.both([*selected[:k], *selected[k + 1 :]]) > least}

    def weighed(self, fault: LargeImperfection) -> LargeImperfection:
        """Return a fault with the confidence that it has where the whole description may be off instead."""
        return replace(fault, confidence=fault.confidence / (1.0 + self.odds_of_crude_description(fault)))

    def odds_of_crude_description(self, fault: LargeImperfection) -> float:
        """Return the odds that the whole description is further off than ordinary ones, against one number that is.

        Both may be: where all numbers have wider priors, this one is compared with and without a prior like theirs. The
        number was chosen among many, for which it pays. A torque sensor's then has its ordinary prior; zero of others.
        """
        number, torque = bool(fault.feature.effect.number), fault.feature.read_torque is not None
        if not (number or torque):
            return 0.0
        parameters, crude = self.fit.problem.parameters, np.array(self.fit.problem.settings.refit.crude)
        own = np.array([is_of(p, fault.feature) for p in parameters])
        described = np.array([p.is_described for p in parameters])
        ordinary = np.where(own, [1.0 / p.widened for p in parameters], 1.0)
        evidence, equations = self._evidence, self._without_causes
        together = [evidence(np.where(described, factor, 1.0) * ordinary, *equations) for factor in crude]
        alone = [evidence(np.where(described & ~own, factor, 1.0), *equations) for factor in (1.0, *crude)]
        chosen = np.log(sum((p.is_described or not number) and p.cause is not None for p in parameters))
        return _odds(logsumexp(together) - logsumexp(alone) + chosen)

    def odds_of_crude_description_against(self, cause: Feature) -> float:
        """Return the odds that the whole description is further off than ordinary ones, against a cause of the links.

        A payload, a spring or a tilt loads the links as other masses would. Its numbers pay as in Schwarz' criterion.
        """
        parameters, sets = self.fit.problem.parameters, self.fit.found.library.sets
        described = np.array([p.is_described for p in parameters])
        wider = [np.where(described, factor, 1.0) for factor in (1.0, *self.fit.problem.settings.refit.crude)]
        numbers = sum(int(np.sum(c.free)) for c in self.optimum if c.feature.key == cause.key)
        without, beside = self._normal_equations(cause.key), self._without_causes
        instead = [self._evidence(each, *without) for each in wider[1:]]
        there = [self._evidence(each, *beside) for each in wider]
        price = 0.5 * numbers * np.log(sum(data.freedom for data in sets))
        return _odds(logsumexp(instead) - logsumexp(there) + price)

    def _evidence(self, wider: Array, noise: float, gram: Array, target: Array, left: float) -> float:
        """Return the marginal likelihood, nats, where each prior (k,) is so many times wider, up to a constant.

        Parameters
        ----------
        wider
            By how much.
        noise, gram, target, left
            As of :meth:`_normal_equations`.
        """
        centre = self.fit.found.library.nuisance.centre / wider
        precision = gram * np.outer(wider, wider) + noise * np.eye(len(wider))
        shown = target * wider + noise * centre
        gained = shown @ np.linalg.solve(precision, shown) - noise * centre @ centre
        return float(0.5 * (gained - left) / noise - 0.5 * np.linalg.slogdet(precision / noise)[1])

    @cached_property
    def _without_causes(self) -> tuple[float, Array, Array, float]:
        return self._normal_equations()

    def _normal_equations(self, without: Key | None = None) -> tuple[float, Array, Array, float]:
        """Return the noise's variance, and the nuisance parameters' normal equations beside causes of any size.

        They are gram (k, k), target (k,), and the squares that those causes leave.

        Parameters
        ----------
        without
            Key of a cause that is left out.
        """
        residual, columns = self._regression if without is None else self._regressed(without)
        basis = orthonormal_basis(columns, RANK)
        white = np.vstack(self.fit.found.library.nuisance.white)
        white, left = white - basis @ (basis.T @ white), residual - basis @ (basis.T @ residual)
        return self._noise, white.T @ white, white.T @ residual, float(left @ left)

    @cached_property
    def _noise(self) -> float:
        """Variance at which whitened residuals count as white noise."""
        library = self.fit.found.library
        return effective_noise(misfit(library, self.optimum), library.sets[0].band, self.fit.problem.settings)

    @cached_property
    def _regression(self) -> tuple[Array, Array]:
        """Residuals (rows,) of both data sets, and the columns (rows, m) of known effects and causes that are free."""
        return self._regressed()

    def _regressed(self, without: Key | None = None) -> tuple[Array, Array]:
        library, optimum = self.fit.found.library, [c for c in self.optimum if c.feature.key != without]
        free = np.concatenate([np.zeros(0, dtype=bool), *(c.free for c in optimum)])
        index = np.concatenate([np.zeros(1, dtype=int), *(c.index for c in optimum)])
        matrix = np.vstack([library.matrix(which, index) for which in (0, 1)])
        return matrix[:, 0] - matrix[:, 1:][:, ~free].sum(axis=1), matrix[:, 1:][:, free]

    def wider(self, faults: Sequence[Feature]) -> dict[int, float]:
        """Return how much wider than ordinary the priors of faults are, by number of the nuisance parameter."""
        parameters = enumerate(self.fit.problem.parameters)
        return {k: p.widened for k, p in parameters if any(is_of(p, fault) for fault in faults)}

    def is_freed(self, fault: LargeImperfection) -> bool:
        """Whether a fault hardly has a prior here; a gain that is off by what all torque channels share has its own."""
        return any(wider > 1.0 for wider in self.wider([fault.feature]).values())

    def is_gone(self, fault: LargeImperfection, values: Array, stds: Array) -> bool:
        """Whether a fault is none with other values of the nuisance parameters.

        One beyond ordinary is none if it may be ordinary with them, or if they take most of it away: what has another
        size beside each law is no size of a sensor. One of ordinary size, as a lag, is none if it may be zero.

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
        unstable = abs(other.value) < settings.stable * abs(fault.value)
        return unstable or ordinary.is_ordinary(other.value, other.std, settings)

    def ordinary_std(self, fault: LargeImperfection) -> float:
        """Return the standard deviation that a fault has on ordinary arms, in its own unit."""
        return self._parameter(fault).ordinary_std

    def _parameter(self, fault: LargeImperfection) -> NuisanceParameter:
        """Return the nuisance parameter that a fault is; of one that all joints have, that with the widest prior."""
        own = [parameter for parameter in self.fit.problem.parameters if is_of(parameter, fault.feature)]
        return max(own, key=lambda parameter: parameter.ordinary_std)


def _odds(nats: float) -> float:
    return float(np.exp(np.clip(nats, -700.0, 700.0)))


def final_estimates(
    prepared: PreparedData,
    selected: Sequence[Candidate],
    faults: Sequence[LargeImperfection],
    near: FinalEstimates | None = None,
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
    near
        Other ones of these causes with some of the faults, from which they are nearer.
    """
    fit = final_fit(prepared, selected, [fault.feature for fault in faults], near.fit if near else None)
    library = fit.found.library
    joint = JointEstimates(library, prepared.settings.judgement)
    polished = joint.polished(fit.selected)
    optimum = (*polished, *tangents(library, polished))
    values, stds = posterior(library, optimum, prepared.settings)
    scale = np.array([p.prior_std for p in fit.problem.parameters])
    return FinalEstimates(fit, joint, (fit.found.values + values) * scale, stds * scale, optimum)
