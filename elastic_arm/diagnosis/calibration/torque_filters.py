"""Lags that were found before it was known that the channel is low-passed.

To first order both are one. Calibrated alone, a lag takes a part of a filter's time constant, and keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects.model import Effect
from elastic_arm.estimation.effect_columns import Feature

Array = NDArray[np.float64]


def filters_for_lags(
    parameters: Sequence[NuisanceParameter], values: Array, causes: Sequence[Candidate]
) -> tuple[Array, list[Candidate]]:
    """Return nuisance parameters without the common lag of low-passed channels, and filters that are as much slower.

    Parameters
    ----------
    parameters
        The nuisance parameters.
    values
        (k,) in units of the priors' standard deviations.
    causes
        Effects that were found; others than low passes stay as they are.
    """
    values, found = values.copy(), []
    for cause in causes:
        feature = cause.feature
        if not is_low_pass(feature.effect) or not feature.fixed:
            found.append(cause)
            continue
        chosen, (cutoff,) = lags_of(parameters, feature), cause.searched or (np.inf,)
        # Each channel keeps what it is later than the others: a filter makes all of them late alike.
        lag = min((float(values[k] * parameters[k].prior_std) for k in chosen), default=0.0)
        if lag > 0.0:
            values[chosen] -= [lag / parameters[k].prior_std for k in chosen]
            cause = replace(cause, searched=(1.0 / (1.0 / cutoff + 2.0 * np.pi * lag),))
        found.append(cause)
    return values, found


def lags_of(parameters: Sequence[NuisanceParameter], low_pass: Feature) -> list[int]:
    """Return the numbers of the lags of the channels that a low pass filters.

    Parameters
    ----------
    parameters
        The nuisance parameters.
    low_pass
        Its joint, or the whole arm, and its channels.
    """
    return [
        k
        for k, p in enumerate(parameters)
        if p.is_lag and low_pass.joint in (None, p.joint) and p.channel in low_pass.choices["channels"]
    ]


def is_low_pass(effect: Effect) -> bool:
    """Whether an effect is a corner frequency of some channels."""
    (first, *_) = effect.parameters or (None,)
    return first is not None and first.inverse and first.unit == "Hz"
