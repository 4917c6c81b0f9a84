"""Faults: sensors and numbers of the arm further off than ordinary ones, nuisance parameters that became causes.

A nuisance parameter takes what its sensor or its number does in every hypothesis, so no candidate can gain by it. What
lies far outside its prior is reported as a cause under the id of its effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from elastic_arm.diagnosis.calibration.calibrate import posterior
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.selection.hypothesis import misfit
from elastic_arm.diagnosis.selection.plausible_size import typical_torques
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects.model import EffectInstance, Scope
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LargeImperfection:
    """An effect of a sensor, or a number of the arm, beyond what is ordinary.

    Parameters
    ----------
    feature
        Effect, joint (None where all joints have it alike) and channels.
    value, std
        Deviation of its first parameter from what means no effect, with standard deviation: the coefficient of its
        column, as that is made of predicted torques.
    contribution
        What it does to the residuals (N', R) of each validation stretch, Nm.
    confidence
        Probability that it is beyond ordinary; of what matters though it is ordinary, that it is there.
    """

    feature: Feature
    value: float
    std: float
    contribution: list[Array]
    confidence: float = 1.0

    @property
    def size(self) -> float:
        """Value of its first parameter."""
        return (self.feature.linear[0].neutral or 0.0) + self.value

    @property
    def gain(self) -> float:
        """Log-likelihood that it gains over none, nats: of a Gaussian estimate."""
        return 0.5 * (self.value / self.std) ** 2

    def is_believable(self, ratio_factor: float) -> bool:
        """Whether an arm may have it; what none has points to a wrong model or mapping.

        Parameters
        ----------
        ratio_factor
            How far outside its range in the catalogue a ratio may be.
        """
        return self.feature.linear[0].believable(self.size, ratio_factor, self.std)

    def of_size(self, value: float, std: float) -> LargeImperfection:
        """Return it with another deviation and standard deviation; what it does is linear in the deviation."""
        contribution = [columns * (value / self.value) for columns in self.contribution]
        return replace(self, value=value, std=std, contribution=contribution)

    @property
    def instance(self) -> EffectInstance:
        """The fault as the simulator takes it."""
        feature = self.feature
        return EffectInstance(feature.effect, feature.joint, {**feature.choices, feature.linear[0].name: self.size})


def faults_beside(
    prepared: PreparedData, selected: Sequence[Candidate], *, named: bool = True
) -> tuple[LargeImperfection, ...]:
    """Return the sensors and the numbers of the arm that are further off than ordinary ones.

    Parameters
    ----------
    prepared
        Data, regressors and nuisance parameters.
    selected
        The known effects and the causes.
    named
        Whether those that may be causes are returned, or those of which the effect is withheld.
    """
    parameters, library = prepared.calibration.parameters, prepared.library
    if not parameters:
        return ()
    values, stds = posterior(library, selected, prepared.settings)
    settings, found = prepared.settings.refit, []
    # What is unexplained bends nuisance parameters: then their priors hold them, and nothing else.
    fits = misfit(library, selected) <= prepared.settings.search.bent
    shown, every = [], []
    for p, value, std in zip(parameters, prepared.found.values + values, stds, strict=True):
        own, own_std = float(value * p.prior_std), float(std * p.prior_std)
        known = fits and 1.0 - std**2 >= settings.least_known
        bare = p.without_prior(own, own_std)
        alone, uncertain = bare if known else (own, own_std)
        beyond = p.is_beyond(alone, uncertain, settings) if known else not p.is_ordinary(own, own_std, settings)
        shown.append((alone, uncertain, beyond))
        if p.cause is not None:
            every.append((p.cause, *bare))
    # Of a link that turns about one axis only an inertia shows, which is its mass's as well as its tensor's: with both
    # uncertain, the mass is less clear.
    turned = {p.joint for p, (*_, beyond) in zip(parameters, shown, strict=True) if p.is_of_inertia and beyond}
    for k, (p, (alone, uncertain, beyond)) in enumerate(zip(parameters, shown, strict=True)):
        if p.cause is None or p.cause.effect.searched != named:
            continue
        by_inertia = p.is_of_link and p.joint in turned
        if abs(alone) < (1.0 if by_inertia else 2.0) * settings.certain * uncertain:
            continue
        # In the torques as they were recorded, before they were divided by the gains found.
        parts = zip(library.nuisance.validation, prepared.validation.parts, strict=True)
        columns = [N[:, :, k] * (alone / p.prior_std * part.gain(p.cause)) for N, part in parts]
        # Of an ordinary arm the distance is Gaussian; where it begins to count, either is as likely.
        more = 0.5 * (p.distance(alone, uncertain) ** 2 - settings.beyond_ordinary**2)
        fault = LargeImperfection(p.cause, alone, uncertain, columns, float(expit(more)))
        extraordinary = (beyond or (by_inertia and more > 0.0)) and not _is_usual(prepared, fault)
        # A channel ahead of the others is no effect: it remains an imperfection.
        if fault.is_believable(prepared.settings.search.ratio_factor) and (extraordinary or _matters(prepared, fault)):
            found.append(fault if extraordinary else replace(fault, confidence=1.0))
    return tuple(_common(prepared, found, every))


def _matters(prepared: PreparedData, fault: LargeImperfection) -> bool:
    """Whether an ordinary lag, or a link encoder's error, makes a good part of the torque of a joint."""
    if fault.feature.effect.ordinary is None and "q" not in fault.feature.sensed:
        return False
    power = np.mean(np.concatenate(fault.contribution) ** 2, axis=0)
    return is_large(prepared, np.asarray(np.sqrt(power)))


def is_large(prepared: PreparedData, contribution: Array) -> bool:
    """Whether what a sensor does to the residuals (R,) Nm is a good part of the torque of their joint."""
    typical = np.tile(typical_torques(prepared.validation), len(contribution) // prepared.model.n)
    return bool(np.any(contribution > prepared.settings.judgement.large_share * typical))


def _is_usual(prepared: PreparedData, fault: LargeImperfection) -> bool:
    """Whether it is an effect that every arm has some of, such as a lag below a sample."""
    ordinary, clear = fault.feature.effect.ordinary, prepared.settings.refit.certain * fault.std
    return ordinary is not None and abs(fault.value) <= ordinary.most(prepared.rate) + clear


def _common(
    prepared: PreparedData, faults: Sequence[LargeImperfection], every: Sequence[tuple[Feature, float, float]]
) -> list[LargeImperfection]:
    """Return faults that all joints have alike as one.

    A joint of which the recording shows little beside the others has it, too, unless it shows that it has none: a
    wrist's late torque, next to nothing, comes out as less late than it is, as the column of its lag is mostly noise.
    The contribution is that of the joints that show it.

    Parameters
    ----------
    prepared
        Data and nuisance parameters.
    faults
        Of single joints.
    every
        Effect, deviation and standard deviation of all that might be a fault.
    """
    robot, kept, settings = prepared.model.robot, list(faults), prepared.settings.refit
    groups: dict[tuple[object, ...], list[LargeImperfection]] = {}
    for fault in faults:
        if fault.feature.effect.scope is Scope.EACH_OR_ARM:
            groups.setdefault((fault.feature.effect.id, fault.feature.key[2]), []).append(fault)
    for key, group in groups.items():
        values, stds = (np.array([getattr(f, name) for f in group]) for name in ("value", "std"))
        telling, own = settings.deciding * float(np.max(stds**-2.0)), {fault.feature.key for fault in group}
        shown = stds**-2.0 > telling
        others = [one for one in every if (one[0].effect.id, one[0].key[2]) == key and one[0].key not in own]
        mean = float(np.average(values, weights=stds**-2.0))
        apart = max(settings.alike * abs(mean), settings.certain * float(stds[shown].max()))
        # Had it the fault, such a joint would show it for certain; or it tells as much as those that have it.
        seen = abs(mean) / (2.0 * settings.certain)
        clear = any(
            std**-2.0 > telling or (std < seen and abs(value) < 2.0 * settings.certain * std)
            for _, value, std in others
        )
        if shown.sum() < min(2, robot.n) or len(group) + len(others) < robot.n or clear:
            continue
        if np.abs(values - mean)[shown].max() > apart:
            continue
        first = group[0].feature
        common = replace(group[0], value=mean).instance
        whole = feature_of(EffectInstance(first.effect, None, common.parameters), first.equations)
        contribution = [np.sum(parts, axis=0) for parts in zip(*(f.contribution for f in group), strict=True)]
        kept = [fault for fault in kept if fault not in group]
        surest = max(fault.confidence for fault in group)
        kept.append(LargeImperfection(whole, mean, float(np.sum(stds**-2.0) ** -0.5), contribution, surest))
    return kept


def with_faults(residuals: Sequence[Array], faults: Sequence[LargeImperfection]) -> list[Array]:
    """Return residuals (N', R) of each stretch with what faults of sensors do to them."""
    return [r + sum((f.contribution[k] for f in faults), np.zeros_like(r)) for k, r in enumerate(residuals)]
