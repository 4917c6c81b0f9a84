"""Torques on a link that no catalogue states, in the place of zeros that both torque channels of its joint would have.

A cable that pulls, or a load that moves along, is read by the joint torque sensor and by the motor alike. The zeros of
two sensors have nothing to do with each other: that they are off by the same is a coincidence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from elastic_arm.diagnosis.inference.estimated_hypothesis import EstimatedHypothesis
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.final_estimates import FinalEstimates
from elastic_arm.diagnosis.laws.comparison import LawFit
from elastic_arm.diagnosis.laws.general_laws import link_torque
from elastic_arm.diagnosis.selection.hypothesis import Key
from elastic_arm.diagnosis.settings import GeneralLawSettings
from elastic_arm.estimation.whitening import WhitenedData

OFFSETS = ("joint_torque_offset", "motor_torque_offset")
DEFLECTION = ("backlash", "encoder_offset")  # what makes a deflection agree with a joint torque whose zero is wrong


def loads_for_offsets(
    sets: Sequence[WhitenedData], estimated: EstimatedHypothesis, final: FinalEstimates, settings: GeneralLawSettings
) -> dict[Key, LawFit]:
    """Return the torques on links that refute offsets of both torque channels of a joint, by key of what they refute.

    Besides the offsets that is what makes the drive's deflection agree with them.

    Parameters
    ----------
    sets
        Of identification and validation.
    estimated
        Causes and faults.
    final
        Where they were estimated.
    settings
        Of the general laws.
    """
    found: dict[Key, LawFit] = {}
    names = final.fit.problem.robot.joint_names
    causes = [estimated.hypothesis.selected[k].feature for k in estimated.hypothesis.causes]
    for joint in names:
        offsets = [fault for fault in estimated.faults if fault.feature.key[:2] in {(one, joint) for one in OFFSETS}]
        if len(offsets) < len(OFFSETS):
            continue
        gain = _log_odds_of_one_torque(offsets, final)
        if gain <= 0.0:
            continue
        size = float(np.mean([fault.value for fault in offsets]))
        law, coefficients = link_torque(sets, names.index(joint), size, settings)
        fit = LawFit(law, gain, abs(size), [part @ coefficients for part in law.plain(sets[1])])
        beside = [feature for feature in causes if feature.joint == joint and feature.effect.id in DEFLECTION]
        found |= dict.fromkeys((feature.key for feature in (*(fault.feature for fault in offsets), *beside)), fit)
    return found


def _log_odds_of_one_torque(offsets: Sequence[LargeImperfection], final: FinalEstimates) -> float:
    """Return the log-odds, nats, of one torque that both channels read, against two zeros as far off as they are.

    Both explain the recording: what decides is by how much the offsets differ, which ordinary zeros make small.
    """
    apart = offsets[0].value - offsets[1].value
    uncertain = [fault.std for fault in offsets]
    ordinary = np.linalg.norm([*(final.ordinary_std(fault) for fault in offsets), *uncertain])
    unrelated = np.linalg.norm([*(fault.value for fault in offsets), *uncertain])
    return float(norm.logpdf(apart, scale=ordinary) - norm.logpdf(apart, scale=unrelated))
