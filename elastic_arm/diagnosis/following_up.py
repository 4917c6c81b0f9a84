"""Follow-up of a diagnosis: prediction errors, and the motion to record next."""

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.next_motion import propose
from elastic_arm.diagnosis.prediction import predict
from elastic_arm.diagnosis.result import Diagnosis


def follow_up(found: Diagnosis, *, rng: np.random.Generator | None) -> Diagnosis:
    """Return a diagnosis with prediction errors and, if causes are uncertain, a motion that
    separates them.

    Parameters
    ----------
    found
        From :func:`diagnose`.
    rng
        Random generator of the proposed motions; None to propose none.
    """
    if found.context is None:
        return found
    proposal = None if rng is None else propose(found.context, found.causes, rng=rng)
    decided = set() if proposal is None else proposal.decided
    return replace(
        found,
        causes=tuple(cause.with_separating_file(decided) for cause in found.causes),
        prediction=predict(found.context, [cause.instance for cause in found.causes if cause.acts]),
        proposal=proposal,
    )
