"""The library of everything that competes: effects by themselves first, then what scales the friction among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.selection.candidates import starting_points
from elastic_arm.diagnosis.selection.marginalisation import NuisanceColumns
from elastic_arm.diagnosis.selection.regressor_library import Candidate, RegressorLibrary, Wanted
from elastic_arm.diagnosis.settings import CandidateSettings
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.known_torques import ActingEffect
from elastic_arm.estimation.whitening import WhitenedData


def build_library(
    identify: WhitenedData,
    validate: WhitenedData,
    features: Sequence[Feature],
    settings: CandidateSettings,
    nuisance: NuisanceColumns | None = None,
) -> RegressorLibrary:
    """Return a library that evaluates every feature on both data sets when what competes is first asked for.

    Parameters
    ----------
    identify, validate
        The data that causes are fitted on, and the data that judges them.
    features
        What competes.
    settings
        The values of nonlinear parameters that are tried.
    nuisance
        Columns that are marginalised.
    """
    library = RegressorLibrary(identify, validate, settings, nuisance)
    library.compete_later(lambda wanted: _competing(library, features, settings, wanted))
    return library


def _competing(
    library: RegressorLibrary, features: Sequence[Feature], settings: CandidateSettings, wanted: Wanted
) -> list[Candidate]:
    """Take the wanted ones of features into a library at all their starting points, and return them.

    Parameters
    ----------
    library
        That they are taken into.
    features, settings
        As of :func:`build_library`.
    wanted
        Feature -> whether it is.
    """
    scaled = [f for f in features if f.effect.scales_friction and wanted(f)]
    points: list[tuple[Feature, tuple[float, ...] | None, bool]] = []
    for feature in features:
        needed = bool(scaled) and feature.effect.friction and not feature.searched
        for point in starting_points(feature, settings, library.sets) if needed or wanted(feature) else ():
            if not feature.effect.scales_friction:
                # What has no free parameter at all has a known size; what is only searched may be scaled meanwhile.
                points.append((feature, point, feature.fixed and not feature.scalable))
    found = library.add_all(points)
    library.close()
    further = library.add_all([(_beside(library, feature, found), (), False) for feature in scaled])
    library.close()
    return [*(one for one in found if wanted(one.feature)), *further]


def beside_friction(library: RegressorLibrary, feature: Feature) -> Feature:
    """Return an effect that scales friction with what a fit of friction alone finds at its place."""
    return _beside(library, feature, library.candidates)


def _beside(library: RegressorLibrary, feature: Feature, candidates: Sequence[Candidate]) -> Feature:
    friction = [c for c in candidates if c.feature.effect.friction and not c.feature.searched]
    found = zip(friction, library.coefficients(friction), strict=True)
    return scaling(feature, [ActingEffect(c.feature, c.searched or (), beta) for c, beta in found])


def scaling(feature: Feature, acting: Sequence[ActingEffect]) -> Feature:
    """Return an effect that scales friction with the friction at its place among effects that act; others as given."""
    if not feature.effect.scales_friction:
        return feature
    wholes = []
    for effect in acting:
        of = effect.feature
        if not feature.scales(of):
            continue
        values = of.parameters([] if of.fixed else [float(b) for b in effect.coefficients], effect.searched)
        flat = [np.atleast_1d(values[p.name]) for p in of.effect.parameters]
        wholes.append((of.whole(), tuple(float(v) for v in np.concatenate(flat))))
    return replace(feature, friction=tuple(wholes))
