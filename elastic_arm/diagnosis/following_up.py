"""What follows a diagnosis: agreement over recordings, prediction errors, the motion to record next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.design.discriminating_motion import propose
from elastic_arm.diagnosis.inference.across_recordings import agreements
from elastic_arm.diagnosis.inference.prediction import predict
from elastic_arm.diagnosis.result import Diagnosis


def follow_up(found: Diagnosis, *, rng: np.random.Generator | None) -> Diagnosis:
    """Return a diagnosis with prediction errors, agreement over recordings and, where causes are in doubt, a motion.

    Parameters
    ----------
    found
        From :func:`diagnose`.
    rng
        Draws the motions that are proposed; None to propose none.
    """
    if found.context is None:
        return found
    proposal = None if rng is None else propose(found.context, found.causes, rng=rng)
    decided = set() if proposal is None else proposal.decided
    # A delay that is listed as the low pass that is likelier is no cause.
    named = {(cause.effect, cause.joint) for cause in found.causes}
    compared = tuple(one for one in agreements(found.context) if (one.effect, one.joint) in named)
    # What has another size in every recording stands in for something else.
    differ: dict[tuple[str, str | None], float] = {}
    for one in compared:
        if one.comparable:
            differ[one.effect, one.joint] = max(one.odds, differ.get((one.effect, one.joint), 0.0))
    causes = [cause.against(differ.get((cause.effect, cause.joint), 0.0)) for cause in found.causes]
    return replace(
        found,
        causes=tuple(cause.with_separating_file(decided) for cause in causes),
        prediction=predict(found.context, [cause.instance for cause in causes if cause.acts]),
        agreements=compared,
        proposal=proposal,
    )
