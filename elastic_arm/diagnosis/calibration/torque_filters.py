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

Array = NDArray[np.float64]


def filters_for_lags(
    parameters: Sequence[NuisanceParameter], values: Array, causes: Sequence[Candidate]
) -> tuple[Array, list[Candidate]]:
    """Return nuisance parameters without the lags of low-passed channels, and filters that are as much slower.

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
        chosen = [
            k
            for k, p in enumerate(parameters)
            if p.feature is not None
            and feature.joint in (None, p.joint)
            and set(p.feature.choices.get("channels", ())) & set(feature.choices["channels"])
        ]
        lag = float(np.mean([values[k] * parameters[k].prior_std for k in chosen])) if chosen else 0.0
        (cutoff,) = cause.searched or (np.inf,)
        slower = 1.0 / (2.0 * np.pi * cutoff) + lag
        if lag > 0.0:
            values[chosen] = 0.0
            cause = replace(cause, searched=(1.0 / (2.0 * np.pi * slower),))
        found.append(cause)
    return values, found


def is_low_pass(effect: Effect) -> bool:
    """Whether an effect is a corner frequency of some channels."""
    (first, *_) = effect.parameters or (None,)
    return first is not None and first.inverse and first.unit == "Hz"
