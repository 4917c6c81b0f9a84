"""What is asked once the causes are known: how far ahead the model sees, where recordings agree, what to move next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_arm.diagnosis.design.discriminating_motion import propose
from elastic_arm.diagnosis.design.proposal import Proposal
from elastic_arm.diagnosis.inference.across_recordings import agreements
from elastic_arm.diagnosis.inference.prediction import predict
from elastic_arm.diagnosis.result import SEPARATING, Alternative, Cause, Diagnosis


def follow_up(found: Diagnosis, *, rng: np.random.Generator | None) -> Diagnosis:
    """Return a diagnosis with prediction errors, agreement over recordings and, where causes are in doubt, a motion.

    Parameters
    ----------
    found
        From :func:`elastic_arm.diagnosis.pipeline.diagnose`.
    rng
        Draws the motions that are proposed; None to propose none.
    """
    context = found.context
    if context is None:
        return found
    proposal = None if rng is None else propose(context, found.causes, rng=rng)
    return replace(
        found,
        causes=tuple(_told_apart(cause, proposal) for cause in found.causes),
        prediction=predict(context, [cause.active for cause in found.causes]),
        agreements=agreements(context),
        proposal=proposal,
    )


def _told_apart(cause: Cause, proposal: Proposal | None) -> Cause:
    """Return the cause with the proposed file at the alternatives that it is expected to decide on."""
    if proposal is None or proposal.trajectory is None:
        return cause
    decided = {p.alternative for p in proposal.pairs if p.decides and p.cause == (cause.effect, cause.joint)}

    def with_file(other: Alternative) -> Alternative:
        return replace(other, file=SEPARATING) if (other.effect, other.joint) in decided else other

    return replace(cause, alternatives=tuple(with_file(other) for other in cause.alternatives))
