"""Causes that the nuisance parameters could hold as well, were they far from their priors.

A payload changes the inertial parameters of the last link, which are nuisance parameters: with them at many standard
deviations of their priors nothing is left to explain, and held-out data see no difference. The priors do: such an
effect is a cause where the likelihood of all data, priors included, gains by it what no chance gives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.selection.candidates import starting_points
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key, Rival
from elastic_arm.diagnosis.selection.plausible_hypothesis import plausible
from elastic_arm.diagnosis.selection.refine import refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.selection.stepwise import misfit
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.estimation.effect_columns import Feature


def with_effects_beyond_ordinary(
    library: RegressorLibrary,
    hypothesis: Hypothesis,
    features: Sequence[Feature],
    sensors: Sequence[Feature],
    settings: DiagnosisSettings,
    refused: frozenset[Key] = frozenset(),
) -> Hypothesis:
    """Return a hypothesis with the effects that bring nuisance parameters back to what is ordinary.

    Parameters
    ----------
    library
        Of all columns.
    hypothesis
        Of the search.
    features
        What may stand for nuisance parameters far from their priors, besides the candidates of the search.
    sensors
        Faults of sensors: the nuisance parameters themselves, with which those compete.
    settings
        Least gain, and how complete the hypothesis has to be: what is unexplained bends nuisance parameters.
    refused
        Keys of effects that are not looked for.
    """
    if not len(library.nuisance) or misfit(library, hypothesis.selected) > settings.search.bent:
        return hypothesis
    hypothesis = replace(hypothesis, beyond=hypothesis.beyond | _found_beyond(library, hypothesis, settings))
    taken = {candidate.feature.key for candidate in hypothesis.selected} | refused
    starts = [candidate for candidate in library.candidates if candidate.feature.key not in taken]
    for feature in (*features, *sensors):
        starts += [library.add(feature, point) for point in starting_points(feature, settings.candidates)]
    library.close()
    free = [candidate for candidate in starts if library.held_by_nuisance(candidate) > settings.search.held]
    faults = {feature.key for feature in sensors}
    faulty: list[Candidate] = []
    while free:
        ranked = _ranked(library, [*hypothesis.selected, *faulty], free, settings, settings.significance.detected)
        if not ranked:
            break
        first = next((pair for pair in ranked if pair[1].feature.key not in faults), None)
        # What a sensor's fault explains better is reported as that, by its nuisance parameter: it stands here only so
        # that other effects are judged beside it.
        if first is None or first[0] < ranked[0][0] - settings.search.exchange_gain:
            faulty.append(ranked[0][1])
            free = [candidate for candidate in free if candidate.feature.key != faulty[-1].feature.key]
            continue
        gain, best = first
        rivals = [Rival(c, float(np.exp(min(g - gain, 0.0)))) for g, c in ranked if c.feature.key != best.feature.key]
        hypothesis = replace(
            hypothesis,
            selected=(*hypothesis.selected, best),
            rivals={
                **hypothesis.rivals,
                len(hypothesis.selected): [rival for rival in rivals if rival.odds > settings.search.least_odds],
            },
            beyond=hypothesis.beyond | {best.feature.key},
        )
        free = [candidate for candidate in free if candidate.feature.key != best.feature.key]
    return hypothesis


def _found_beyond(library: RegressorLibrary, hypothesis: Hypothesis, settings: DiagnosisSettings) -> frozenset[Key]:
    """Return the keys of those causes of the search that nuisance parameters could hold, far from their priors."""
    scale, whole = misfit(library, hypothesis.selected), library.both(hypothesis.selected)
    found = set()
    for k in hypothesis.causes:
        candidate = hypothesis.selected[k]
        gain = whole - library.both(hypothesis.without(k))
        held = library.held_by_nuisance(candidate) > settings.search.held
        if held and gain > settings.significance.detected * scale:
            found.add(candidate.feature.key)
    return frozenset(found)


def rivals_of_number(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    number: Feature,
    features: Sequence[Feature],
    settings: DiagnosisSettings,
) -> list[Rival]:
    """Return what could stand in the place of a number of a link that is beyond ordinary.

    Parameters
    ----------
    library
        Of all columns, with ordinary priors of the nuisance parameters.
    selected
        The known effects and the causes.
    number
        The effect of the number.
    features
        Of the links' inertial parameters, the number's own among them.
    settings
        How much a value that was tried costs.
    """
    starts = [library.add(f, point) for f in features for point in starting_points(f, settings.candidates)]
    library.close()
    ranked = _ranked(library, selected, starts, settings, least=0.0)
    own = next((gain for gain, candidate in ranked if candidate.feature.key == number.key), 0.0)
    return [Rival(c, float(np.exp(gain - own))) for gain, c in ranked if c.feature.key != number.key]


def _ranked(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    further: Sequence[Candidate],
    settings: DiagnosisSettings,
    least: float,
) -> list[tuple[float, Candidate]]:
    """Return by how much each feature raises the likelihood of all data, nats over the misfit, the best first.

    Those that raise it by less than the least are left out; of values tried each is worth that much less.
    """
    scale, without = misfit(library, selected), library.both(selected)
    tried = Counter(candidate.feature.key for candidate in further)
    rough = sorted(((library.both([*selected, c]) - without, c) for c in further), key=lambda pair: -pair[0])
    found: dict[Key, tuple[float, Candidate]] = {}
    for gain, candidate in rough:
        key = candidate.feature.key
        # Columns that span a neighbourhood to first order lack what goes with the square, as a payload's inertia.
        weak = gain < least * scale and candidate.searched is not None
        if weak or key in found:
            continue
        best = refine(library, [*selected, candidate], candidate, settings.refinement)
        trial = [*selected, best]
        if plausible(library, trial, settings.search.ratio_factor):
            found[key] = ((library.both(trial) - without) / scale - float(np.log(tried[key])), best)
    return sorted((pair for pair in found.values() if pair[0] > least), key=lambda pair: -pair[0])
