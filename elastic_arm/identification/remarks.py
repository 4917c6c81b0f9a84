"""What a user must know of a fit beside its numbers: what was not estimated, and what no arm can have."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elastic_arm.formatting import rounded
from elastic_arm.identification.base_regression import BaseRegression
from elastic_arm.identification.least_squares import Fit

Array = NDArray[np.float64]

# Columns at unit length that are so close to dependent leave the numbers to rounding.
HOPELESS = 1e12
# Numbers that no arm has below zero: springs, friction, inertias about axes.
NEVER_NEGATIVE = re.compile(r"(\.(K|D|m)|(viscous|coulomb)_friction:\S+\.(coefficient|torque)|\.Izz)")


def impossible(equations: BaseRegression, Psi: Array) -> NDArray[np.bool_]:
    """Return which base parameters are below zero though all that they are made of is above, (B,).

    Parameters
    ----------
    equations
        In base parameters.
    Psi
        (B,) their values.
    """
    can = []
    for row in equations.base.T:
        parts = np.flatnonzero(row)
        names = [equations.names[k] for k in parts.tolist()]
        can.append(bool(np.any(row < 0)) or not all(_never_negative(name) for name in names))
    return (Psi < 0) & ~np.array(can)


def _never_negative(name: str) -> bool:
    return NEVER_NEGATIVE.search(name) is not None


def checked(words: Sequence[str], fit: Fit, equations: BaseRegression) -> tuple[str, ...]:
    """Return the verdicts with what is impossible called "not" determined, and nothing "well" of a hopeless fit.

    Parameters
    ----------
    words
        "well", "poorly" or "not" by the standard deviations alone.
    fit, equations
        The estimate, and what it is one of.
    """
    wrong = impossible(equations, fit.Psi)
    hopeless = fit.condition > HOPELESS
    found = []
    for word, bad in zip(words, wrong.tolist(), strict=True):
        found.append("not" if bad else "poorly" if hopeless and word == "well" else word)
    return tuple(found)


def remarks(fit: Fit, equations: BaseRegression) -> tuple[str, ...]:
    """Return what was fixed, what is impossible, and how far the link encoders lag and are offset.

    Parameters
    ----------
    fit, equations
        The estimate, and what it is one of.
    """
    names = equations.base.names
    found = []
    if fit.fixed:
        kept = ", ".join(names[k] for k in fit.fixed)
        found.append(f"this recording gives no value of {kept}: kept as in the description")
    below = [names[k] for k in np.flatnonzero(impossible(equations, fit.Psi)).tolist()]
    if below:
        found.append(f"{', '.join(below)}: below zero, which no arm can have; the model lacks something there")
    if fit.condition > HOPELESS:
        found.append(f"condition number {fit.condition:.1e}: no parameter is known well from this recording")
    return (*found, *_encoders(fit, equations))


def _encoders(fit: Fit, equations: BaseRegression) -> list[str]:
    """Return lags and offsets of the link encoders that stand out."""
    if not equations.summed:
        return []
    place = {name: k for k, name in enumerate(equations.base.names)}
    found = []
    for joint, (K, _) in zip(equations.joints, equations.drive_columns(), strict=True):
        parts = []
        for what, factor, unit in (("delay", 1e3, "ms"), ("offset", 1e3, "mrad")):
            k = place.get(f"link_encoder:{joint}.K_{what}")
            if k is not None and abs(fit.Psi[k]) > 5.0 * fit.std[k]:
                value, std = rounded(factor * fit.Psi[k] / fit.Psi[K], factor * fit.std[k] / fit.Psi[K])
                parts.append(f"lags by {value} ± {std} {unit}" if what == "delay" else f"offset {value} ± {std} {unit}")
        if parts:
            found.append(f"link encoder of {joint} beside the motor encoder: {', '.join(parts)}")
    return found
