"""The paper's claims, in its order: each holds, holds in part, or does not hold with our numbers."""

from __future__ import annotations

from elastic_arm.studies.paper.claims.claim import FAILS, HOLDS, IN_PART, Claim
from elastic_arm.studies.paper.claims.estimation import ESTIMATION_RULES
from elastic_arm.studies.paper.claims.torques import TORQUE_RULES
from elastic_arm.studies.paper.study import StudyResult

__all__ = ["FAILS", "HOLDS", "IN_PART", "Claim", "judge"]
SECTIONS = ("IV-A", "IV-C", "V", "VI-A", "VI-B", "VII")


def judge(result: StudyResult) -> list[Claim]:
    """Decide every claim, in the order of the paper's sections."""
    claims = [rule(result) for rule in (*TORQUE_RULES, *ESTIMATION_RULES)]
    return sorted(claims, key=lambda claim: SECTIONS.index(claim.section))
