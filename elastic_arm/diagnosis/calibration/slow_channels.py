"""Torque channels that came out late: whether a low pass of them leaves less than a delay does.

A lag L and a low pass of time constant T act as L + T to first order, and as (L + T)² / 2 + T² / 2 to second. Beside a
lag that is free, the likelihood is stationary where T is nothing: once a lag holds what a filter does, no column and no
small step shows the filter, however slow it is. So each is calibrated in full.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.calibration.linearisation import linearise
from elastic_arm.diagnosis.calibration.recalibration import recalibrated
from elastic_arm.diagnosis.calibration.torque_filters import is_low_pass, lags_of
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, misfit
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.estimation.effect_columns import Feature


def beside_low_passes(
    prepared: PreparedData, causes: Sequence[Candidate] = ()
) -> tuple[PreparedData, Sequence[Candidate]]:
    """Return the data calibrated beside the low passes that leave less than lags do, and all causes there.

    Where one does, the columns of all that competes are there, too; else nothing changes.

    Parameters
    ----------
    prepared
        Data and regressors.
    causes
        Beside which they were calibrated.
    """
    found, low_passes = prepared, [f for f in prepared.candidates if is_low_pass(f.effect)]
    # The filter of most channels first: those that it holds are late no more.
    for low_pass in sorted(low_passes, key=lambda f: -len(lags_of(prepared.calibration.parameters, f))):
        if _is_filtered(found, low_pass, causes) or not _is_late(found, low_pass):
            continue
        # Without a corner: the lags become its time constant.
        added = Candidate(low_pass.whole(), (np.inf,), slice(0, 0), fixed=True)
        there = Hypothesis([*found.given, *causes, added], len(found.given))
        beside, there = recalibrated(replace(found, candidates=()), there)
        if _gain(found, causes, beside, there) > prepared.settings.significance.detected:
            found, causes = beside, [there.selected[k] for k in there.causes]
    if found is prepared:
        return prepared, causes
    noise = found.library.nuisance.noise
    columns, again = linearise(found.calibration, found.found.expansion, prepared.candidates, causes, noise=noise)
    return replace(found, found=columns, candidates=prepared.candidates), again


def _gain(found: PreparedData, causes: Sequence[Candidate], beside: PreparedData, there: Hypothesis) -> float:
    """Return by how much likelier the data are beside one more low pass, nats over the misfit."""
    before = found.library.squares_left([*found.given, *causes])
    after = beside.library.squares_left(there.selected)
    return 0.5 * (before - after) / misfit(beside.library, there.selected)


def _is_filtered(prepared: PreparedData, low_pass: Feature, causes: Sequence[Candidate]) -> bool:
    """Whether one of the causes filters a channel of a low pass already."""
    parameters = prepared.calibration.parameters
    held = {k for cause in causes if is_low_pass(cause.feature.effect) for k in lags_of(parameters, cause.feature)}
    return not held.isdisjoint(lags_of(parameters, low_pass))


def _is_late(prepared: PreparedData, low_pass: Feature) -> bool:
    """Whether all channels of a low pass are about as late as a filter may make them, and later than is ordinary."""
    parameters, values = prepared.calibration.parameters, prepared.found.values
    late = [(parameters[k], float(values[k])) for k in lags_of(parameters, low_pass)]
    if not late:
        return False
    settings, (cutoff,) = prepared.settings.refit, low_pass.effect.parameters
    least, lags = 1.0 / (2.0 * np.pi * cutoff.high), [p.prior_std * value for p, value in late]
    beyond = all(value * p.widened > settings.beyond_ordinary for p, value in late)
    return beyond and min(lags) > max(least, (1.0 - settings.alike) * max(lags))
