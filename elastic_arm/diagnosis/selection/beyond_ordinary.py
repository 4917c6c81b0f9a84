"""Causes that the nuisance parameters could hold as well, were they far from their priors.

A payload changes the inertial parameters of the last link, which are nuisance parameters: with them at many standard
deviations of their priors nothing is left to explain, and held-out data see no difference. The priors do: such an
effect is a cause where the likelihood of all data, priors included, gains by it what no chance gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Rival
from elastic_arm.diagnosis.selection.refine import refine
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary, starting_points
from elastic_arm.diagnosis.selection.stepwise import misfit, plausible
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.estimation.effect_columns import Feature


def with_effects_beyond_ordinary(
    library: RegressorLibrary, hypothesis: Hypothesis, features: Sequence[Feature], settings: DiagnosisSettings
) -> Hypothesis:
    """Return a hypothesis with the effects that bring nuisance parameters back to what is ordinary.

    Parameters
    ----------
    library
        Of all columns.
    hypothesis
        Of the search.
    features
        What may stand for nuisance parameters far from their priors.
    settings
        Least gain, and how complete the hypothesis has to be: what is unexplained bends nuisance parameters.
    """
    if not len(library.nuisance) or misfit(library, hypothesis.selected) > settings.search.complete:
        return hypothesis
    starts = [
        library.add(f, point, fixed=f.fixed) for f in features for point in starting_points(f, settings.candidates)
    ]
    library.close()
    open_ = [candidate for candidate in starts if library.held_by_nuisance(candidate) > settings.search.held]
    while open_:
        ranked = _ranked(library, hypothesis.selected, open_, settings)
        if not ranked or ranked[0][0] < settings.significance.detected:
            break
        first, best = ranked[0]
        rivals = [Rival(other, float(np.exp(gain - first))) for gain, other in ranked[1:]]
        rivals = [rival for rival in rivals if rival.odds > settings.search.least_odds]
        hypothesis = replace(
            hypothesis,
            selected=(*hypothesis.selected, best),
            rivals={**hypothesis.rivals, len(hypothesis.selected): rivals},
            beyond=hypothesis.beyond | {best.feature.key},
        )
        open_ = [candidate for candidate in open_ if candidate.feature.key != best.feature.key]
    return hypothesis


def _ranked(
    library: RegressorLibrary, selected: Sequence[Candidate], further: Sequence[Candidate], settings: DiagnosisSettings
) -> list[tuple[float, Candidate]]:
    """Return by how much each candidate raises the likelihood of all data, nats over the misfit, the best first."""
    scale, without = misfit(library, selected), library.both(selected)
    rough = sorted(((library.both([*selected, c]) - without, c) for c in further), key=lambda pair: -pair[0])
    found: list[tuple[float, Candidate]] = []
    for gain, candidate in rough:
        if gain < settings.significance.detected * scale:
            break
        best = refine(library, [*selected, candidate], candidate, settings.refinement)
        trial = [*selected, best]
        if plausible(library, trial, settings.search.ratio_factor):
            found.append(((library.both(trial) - without) / scale, best))
    return sorted(found, key=lambda pair: -pair[0])
