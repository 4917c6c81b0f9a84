"""Causes that the nuisance parameters could hold as well, were they far from their priors.

A payload changes the inertial parameters of the last link, which are nuisance parameters: with them at many standard
deviations of their priors nothing is left to explain, and held-out data see no difference. The priors do: such an
effect is a cause where the likelihood of all data, priors included, gains by it what no chance gives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.selection.candidates import starting_points
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Key, Rival, misfit
from elastic_arm.diagnosis.selection.plausible_hypothesis import plausible
from elastic_arm.diagnosis.selection.refine import refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.estimation.effect_columns import Feature


def with_effects_beyond_ordinary(
    library: RegressorLibrary,
    hypothesis: Hypothesis,
    features: Sequence[Feature],
    sensors: Sequence[Feature],
    numbers: Sequence[Candidate],
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
    numbers
        Of the arm, :func:`freed`, each of which stands for an effect of several where it alone explains hardly less.
    settings
        Least gain, and how complete the hypothesis has to be: what is unexplained bends nuisance parameters.
    refused
        Keys of effects that are not looked for.
    """
    if not len(library.nuisance) or misfit(library, hypothesis.selected) > settings.search.bent:
        return hypothesis
    beyond = _found_beyond(library, hypothesis, settings)
    against = {k: _rivals_by_all_data(library, hypothesis, k, beyond) for k in hypothesis.rivals}
    hypothesis = replace(hypothesis, rivals=against, beyond=hypothesis.beyond | beyond)
    taken = {candidate.feature.key for candidate in hypothesis.selected} | refused
    free = _held(library, [*features, *sensors], taken, settings)
    faults = {feature.key for feature in sensors}
    faulty: list[Candidate] = []
    while free:
        selected = [*hypothesis.selected, *faulty]
        ranked = _ranked(library, selected, free, settings, settings.significance.detected, hypothesis.baseline)
        if not ranked:
            break
        first = next((pair for pair in ranked if pair[1].feature.key not in faults), None)
        # What a sensor's fault explains better, or one number nearly as well, is reported as that, by its nuisance
        # parameter: it stands here only so that other effects are judged beside it.
        if first is None or first[0] < ranked[0][0] - settings.search.exchange_gain:
            aside: Candidate | None = ranked[0][1]
        else:
            aside = _alone(library, selected, first, numbers, settings)
        if aside is not None:
            faulty.append(aside)
            free = [candidate for candidate in free if candidate.feature.key != aside.feature.key]
            continue
        assert first is not None
        gain, best = first
        others = [(g, c) for g, c in ranked if c.feature.key != best.feature.key and c.feature.effect.searched]
        rivals = [Rival(c, float(np.exp(min(g - gain, 0.0)))) for g, c in others]
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


def _held(
    library: RegressorLibrary, features: Sequence[Feature], taken: Collection[Key], settings: DiagnosisSettings
) -> list[Candidate]:
    """Return what nuisance parameters could hold of the candidates and of further features, but for what is taken."""
    there = {candidate.feature.key for candidate in library.candidates}
    for feature in (feature for feature in features if feature.key not in there):
        points = starting_points(feature, settings.candidates, library.sets)
        library.candidates.extend([library.add(feature, point) for point in points])
    library.close()
    starts = [candidate for candidate in library.candidates if candidate.feature.key not in taken]
    return [candidate for candidate in starts if library.held_by_nuisance(candidate) > settings.search.held]


def _alone(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    best: tuple[float, Candidate],
    numbers: Sequence[Candidate],
    settings: DiagnosisSettings,
) -> Candidate | None:
    """Return the one number of an effect that explains hardly less than all of them; None where it takes more.

    Parameters
    ----------
    library
        Of all columns.
    selected
        What was found before.
    best
        The effect with what it gains, nats over the misfit.
    numbers
        Single numbers, :func:`freed`.
    settings
        Gains from which one of two explanations counts as the better.
    """
    gain, whole = best
    scale, without = misfit(library, selected), library.both(selected)
    # Every further number gains by chance: a nat each (Akaike 1974). By itself it has to be a cause, too.
    least = max(gain - (_numbers(whole) - 1) - settings.search.exchange_gain, settings.significance.detected)
    own = (number for number in numbers if number.feature.key == whole.feature.key)
    return next((n for n in own if (library.both([*selected, n]) - without) / scale > least), None)


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


def _rivals_by_all_data(
    library: RegressorLibrary, hypothesis: Hypothesis, k: int, beyond: Collection[Key]
) -> Sequence[Rival]:
    """Return the rivals of a cause of the search, their odds no larger than by the likelihood of all data and priors.

    Of a cause that nuisance parameters could hold held-out data say nothing: there anything at all is as good.

    Parameters
    ----------
    library
        Of all columns.
    hypothesis
        Of the search.
    k
        Number of the cause.
    beyond
        Keys of those that nuisance parameters could hold.
    """
    rivals = hypothesis.rivals[k]
    if hypothesis.selected[k].feature.key not in beyond:
        return rivals
    scale, whole = misfit(library, hypothesis.selected), library.both(hypothesis.selected)
    without = hypothesis.without(k)
    more = [(library.both([*without, rival.candidate]) - whole) / scale for rival in rivals]
    return [replace(one, odds=min(one.odds, float(np.exp(min(m, 0.0))))) for one, m in zip(rivals, more, strict=True)]


def freed(library: RegressorLibrary, number: int, prior_std: float, feature: Feature) -> Candidate:
    """Return a candidate for a number without its prior, the column of its nuisance parameter; `close` makes it usable.

    Parameters
    ----------
    library
        Of all columns.
    number
        Of the nuisance parameter.
    prior_std
        Of it, to which its column is scaled.
    feature
        The effect as which it is named.
    """
    columns = [white[:, number : number + 1] / prior_std for white in library.nuisance.white]
    return Candidate(feature, (), library.add_columns(columns))


def rivals_of_number(
    library: RegressorLibrary,
    hypothesis: Hypothesis,
    own: Candidate,
    numbers: Sequence[Candidate],
    settings: DiagnosisSettings,
) -> list[Rival]:
    """Return what could stand in the place of a number of a link that is beyond ordinary: what its effect resembles.

    Parameters
    ----------
    library
        Of all columns, with ordinary priors of the nuisance parameters.
    hypothesis
        The known effects, the causes and the other faults.
    own
        The number, :func:`freed`.
    numbers
        The same number of other links.
    settings
        What nuisance parameters could hold, and the least odds.
    """
    selected = hypothesis.selected
    taken = {candidate.feature.key for candidate in (*selected, own, *numbers)}
    alike = {confusion.effect for confusion in own.feature.effect.confusions}
    others = [c for c in library.candidates if c.feature.key not in taken and c.feature.effect.searched]
    held = [c for c in others if c.feature.effect.id in alike and library.held_by_nuisance(c) > settings.search.held]
    gain = (library.both([*selected, own]) - library.both(selected)) / misfit(library, selected)
    most = -float(np.log(settings.search.least_odds))
    ranked = _ranked(library, selected, [*numbers, *held], settings, max(gain - most, 0.0), hypothesis.baseline)
    # Every further number gains by chance: a nat each (Akaike 1974).
    gains = [(other - gain - (_numbers(candidate) - 1), candidate) for other, candidate in ranked]
    return [Rival(candidate, float(np.exp(min(more, most)))) for more, candidate in gains]


def _numbers(candidate: Candidate) -> int:
    """Return how many numbers of a candidate are fitted."""
    return len(candidate.searched or ()) + (0 if candidate.fixed else len(candidate.index))


def _ranked(
    library: RegressorLibrary,
    selected: Sequence[Candidate],
    further: Sequence[Candidate],
    settings: DiagnosisSettings,
    least: float,
    given: Sequence[Candidate],
) -> list[tuple[float, Candidate]]:
    """Return by how much each feature raises the likelihood of all data, nats over the misfit, the best first.

    Those that raise it by less than the least are left out, and those that before refinement raise it by less than a
    share of the best (`shortlist_ratio`); of values tried each is worth that much less.
    """
    scale, without = misfit(library, selected), library.both(selected)
    tried = Counter(candidate.feature.key for candidate in further)
    rough = sorted(((library.both([*selected, c]) - without, c) for c in further), key=lambda pair: -pair[0])
    found: dict[Key, tuple[float, Candidate]] = {}
    asked = least * scale
    for before, candidate in rough:
        key = candidate.feature.key
        # Columns that span a neighbourhood to first order lack what goes with the square, as a payload's inertia.
        weak = before < asked and candidate.searched is not None
        if weak or key in found:
            continue
        best = refine(library, [*selected, candidate], candidate, settings.refinement)
        trial = [*selected, best]
        if plausible(library, trial, settings.search, given=given):
            gain = library.both(trial) - without
            # What is as good as the best one before that was refined may be as good after it.
            asked = max(asked, settings.search.shortlist_ratio * min(before, gain))
            found[key] = (gain / scale - float(np.log(tried[key])), best)
    return sorted((pair for pair in found.values() if pair[0] > least), key=lambda pair: -pair[0])
