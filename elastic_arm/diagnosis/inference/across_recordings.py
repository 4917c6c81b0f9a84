"""Whether causes hold over several recordings: each refitted on every recording alone, and the values compared.

A cause of the arm has the same size wherever the arm moves. One whose size changes from recording to recording stands
in for something else, or the arm itself has changed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2

from elastic_arm.diagnosis.context import DiagnosisContext
from elastic_arm.diagnosis.inference.estimates import Agreement, RecordingEstimate, estimates, polish
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import AgreementSettings
from elastic_arm.effects.model import Effect
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.observation import Observation
from elastic_arm.estimation.whitening import WhitenedData

Array = NDArray[np.float64]
# Scatters over which sizes are marginalised, and the largest as a multiple of the size; they resolve a factor of 1.2.
SCATTERS, MOST_SCATTER = 30, 3.0


def agreements(context: DiagnosisContext) -> tuple[Agreement, ...]:
    """Refit all causes on every recording alone, and compare; empty for a single recording.

    Nuisance parameters that are causes were compared beside all others.

    Recordings that judged count like those that were fitted. The last thirds of recordings, where these judged, are
    part of them.
    """
    recordings = _recordings(context)
    if len(recordings) < 2 or not context.selected:
        return ()
    everything = context.everything
    found = [refitted(context, group, everything) for group in recordings]
    return tuple(
        context.faults.get(candidate.feature.key)
        or compared(candidate.feature, [of_one[k] for of_one in found], context.settings.agreement)
        for k, candidate in enumerate(everything)
        if candidate not in context.given
        # Calibrated, each recording has zeros of its own.
        and not (context.validate.predicted and candidate.feature.effect.set_at_start)
    )


def _recordings(context: DiagnosisContext) -> list[list[Observation]]:
    """Return the observations of each recording."""
    fitted, judging = context.seen
    if context.held_back:
        return [list(pair) for pair in zip(fitted, judging, strict=True)]
    return [[one] for one in (*fitted, *judging)]


def refitted(
    context: DiagnosisContext, group: Sequence[Observation], selected: Sequence[Candidate]
) -> list[RecordingEstimate]:
    """Fit candidates on some recordings alone.

    Parameters
    ----------
    context
        Model, equations and thresholds.
    group
        The recordings, or parts of one.
    selected
        Known effects and causes.
    """
    judged = context.validate
    # The laws take the same torques as those of the diagnosis: with --refit those that the model predicts.
    data = WhitenedData(
        context.model,
        group,
        judged.layout,
        judged.band,
        predicted=judged.predicted,
        sticking_removed=judged.sticking_removed,
        acting=judged.acting,
        scales=judged.scales,
    )
    library = RegressorLibrary(data, data, context.settings.candidates)
    judgement = context.settings.judgement
    own = [library.add(candidate.feature, candidate.searched, fixed=candidate.fixed) for candidate in selected]
    library.close()
    own = polish(library, own, judgement)
    beta = library.fit(0, own)
    whole = library.gain(0, own, beta)
    found = []
    for k, values in enumerate(estimates(library, own, judgement)):
        others = [*own[:k], *own[k + 1 :]]
        gain = whole - library.gain(0, others, library.fit(0, others))
        found.append(RecordingEstimate(group[0].source, values, gain))
    return found


def compared(feature: Feature, findings: Sequence[RecordingEstimate], settings: AgreementSettings) -> Agreement:
    """Compare a cause's sizes in several recordings.

    Parameters
    ----------
    feature
        The cause.
    findings
        One a recording.
    settings
        What counts as the same.
    """
    effect, joint = feature.effect, feature.joint
    present = all(finding.gain > 0.0 for finding in findings)
    whole = {p.name: _whole_size(effect, findings) if p.name in effect.magnitude else 0.0 for p in effect.parameters}
    by_name = {p.name: _components(p, findings, whole[p.name], settings) for p in effect.parameters}
    tried = [numbers for components in by_name.values() for numbers in components]
    if not tried:
        return Agreement(effect.id, joint, tuple(findings), None, 0, None, None, present)
    # Of the numbers that differ by more than counts as the same, the one that differs with most certainty.
    scatter, spread, _ = max([numbers for numbers in tried if numbers[1] >= settings.alike] or tried)
    probability = min(1.0, len(tried) * float(chi2.sf(scatter, len(findings) - 1)))
    agrees = present and (probability > settings.alpha or spread < settings.alike)
    comparable = not agrees or spread < settings.comparable
    freedom, odds = len(findings) - 1, 0.0
    if not agrees:
        # Only of a size it is known what is much of it.
        odds = max((own for name in effect.magnitude for _, _, own in by_name[name]), default=0.0)
    return Agreement(effect.id, joint, tuple(findings), scatter, freedom, probability, spread, agrees, comparable, odds)


def _whole_size(effect: Effect, findings: Sequence[RecordingEstimate]) -> float:
    """Return the size of an effect, in the median of the recordings: of the vector where several numbers are it.

    Of a tilt about y, x is nearly zero: a small difference of x is a small part of the tilt all the same.
    """
    if len(effect.magnitude) < 2 or any(name not in f.parameters for f in findings for name in effect.magnitude):
        return 0.0
    parts = [[np.ravel(f.parameters[name].value) for name in effect.magnitude] for f in findings]
    return float(np.median([np.linalg.norm(np.concatenate(one)) for one in parts]))


def _components(
    parameter: Parameter, findings: Sequence[RecordingEstimate], least: float, settings: AgreementSettings
) -> list[tuple[float, float, float]]:
    """Return chi-square, relative spread and odds of different sizes of each number that every recording determines.

    Parameters
    ----------
    parameter
        One of the effect's.
    findings
        One a recording.
    least
        Size of the effect, of which a number that is nearly zero beside it is a part.
    settings
        What counts as the same.
    """
    found = []
    for j in range(parameter.size):
        given = [f.parameters.get(parameter.name) for f in findings]
        pairs = [(np.atleast_1d(e.value)[j], np.atleast_1d(e.std)[j]) for e in given if e is not None]
        if len(pairs) < len(findings) or not all(std for _, std in pairs):
            continue
        values, stds = (np.array(column, dtype=float) for column in zip(*pairs, strict=True))
        if parameter.role is Role.PHASE:
            values = values[0] + np.angle(np.exp(1j * (values - values[0])))
        mean = np.average(values, weights=stds**-2.0)
        size = 1.0 if parameter.role is Role.PHASE else max(abs(mean - (parameter.neutral or 0.0)), least)
        scatter = float(np.sum(((values - mean) / stds) ** 2))
        spread = float(np.abs(values - mean).max() / max(size, 1e-300))
        found.append((scatter, spread, odds_of_different_sizes(values, stds, size, settings)))
    return found


def odds_of_different_sizes(values: Array, stds: Array, size: float, settings: AgreementSettings) -> float:
    """Return the odds that sizes differ from recording to recording by a good part of themselves.

    A law that fits its effect roughly has nearly one size wherever it is fitted; one that stands in for another has a
    size of its own in every recording. The likelihood of the scatter is the restricted one, in which the mean is
    marginalised (D. Harville, J. Am. Stat. Assoc. 72 (1977) 320); as likely beforehand are no scatter and any one, on a
    logarithmic scale from what counts as the same to several times the size.

    Parameters
    ----------
    values, stds
        (k,) sizes, and their standard deviations.
    size
        Of the effect.
    settings
        What counts as the same, and as comparable.
    """

    def log_likelihood(scatter: float) -> float:
        weights = 1.0 / (stds**2 + scatter**2)
        mean = weights @ values / weights.sum()
        return float(0.5 * (np.log(weights).sum() - np.log(weights.sum()) - weights @ (values - mean) ** 2))

    scatters = size * np.geomspace(settings.alike, MOST_SCATTER, SCATTERS)
    likelihoods = np.array([log_likelihood(scatter) for scatter in scatters]) - np.log(SCATTERS)
    apart = scatters > settings.comparable * size
    nearly_one = np.append(likelihoods[~apart], log_likelihood(0.0))
    return float(np.exp(np.clip(logsumexp(likelihoods[apart]) - logsumexp(nearly_one), -700.0, 700.0)))
