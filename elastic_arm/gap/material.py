"""What a diagnosis worked on, kept for figures and for going on from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model
from elastic_arm.gap.bank import Entry
from elastic_arm.gap.evidence import Evidence

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """The validation data with the residuals before and after.

    Parameters
    ----------
    model
        The nominal model.
    validate
        Evidence of the validation recordings.
    before, after
        Residuals (N', R) of each stretch.
    entries
        The causes as they were fitted.
    alone
        Residuals of each stretch with one cause alone added, by position in the causes.
    regimes
        (R,) share of each residual's power that follows each regime, before.
    """

    model: Model
    validate: Evidence
    before: list[Array]
    after: list[Array]
    entries: tuple[Entry, ...] = ()
    alone: tuple[list[Array], ...] = ()
    regimes: tuple[dict[str, float], ...] = ()
