"""What follows a diagnosis: the motion to record next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.next_motion import propose
from elastic_arm.diagnosis.result import Diagnosis


def follow_up(found: Diagnosis, *, rng: np.random.Generator | None) -> Diagnosis:
    """Return a diagnosis with, where causes are in doubt, a motion that separates them.

    Parameters
    ----------
    found
        From :func:`diagnose`.
    rng
        Draws the motions that are proposed; None to propose none.
    """
    if found.context is None or rng is None:
        return found
    proposal = propose(found.context, found.causes, rng=rng)
    decided = set() if proposal is None else proposal.decided
    causes = tuple(cause.with_separating_file(decided) for cause in found.causes)
    return replace(found, causes=causes, proposal=proposal)
