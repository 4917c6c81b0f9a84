"""The paper's claims, in its order: each holds, holds in part, does not hold, or is undecided with our numbers."""

from __future__ import annotations

from elastic_arm.studies.paper.claims.claim import FAILS, HOLDS, IN_PART, UNDECIDED, Claim
from elastic_arm.studies.paper.claims.estimation import ESTIMATION_RULES
from elastic_arm.studies.paper.claims.torques import TORQUE_RULES
from elastic_arm.studies.paper.study import StudyResult
from elastic_arm.studies.paper.torque_study import TorqueResult

__all__ = ["FAILS", "HOLDS", "IN_PART", "UNDECIDED", "Claim", "judge", "judge_torques"]
SECTIONS = ("IV-A", "IV-C", "V", "VI-A", "VI-B", "VII")


def judge(result: StudyResult) -> list[Claim]:
    """Decide every claim, in the order of the paper's sections."""
    return _in_order([*judge_torques(result), *(rule(result) for rule in ESTIMATION_RULES)])


def judge_torques(result: TorqueResult) -> list[Claim]:
    """Decide the claims on torques, in the order of the paper's sections."""
    return _in_order([rule(result) for rule in TORQUE_RULES])


def _in_order(claims: list[Claim]) -> list[Claim]:
    return sorted(claims, key=lambda claim: SECTIONS.index(claim.section))
