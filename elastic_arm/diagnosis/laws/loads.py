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
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.whitening import WhitenedData

CHANNELS = {"tau_J", "tau_m"}


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
        offsets = [fault for fault in estimated.faults if _is_zero_of_torque(fault.feature, joint)]
        if {fault.feature.read_torque for fault in offsets} != CHANNELS or len(offsets) != len(CHANNELS):
            continue
        gain = _log_odds_of_one_torque(offsets, final)
        if gain <= 0.0:
            continue
        size = float(np.mean([fault.value for fault in offsets]))
        law, coefficients = link_torque(sets, names.index(joint), size, settings)
        fit = LawFit(law, gain, abs(size), [part @ coefficients for part in law.plain(sets[1])])
        beside = [feature for feature in causes if feature.joint == joint and _moves_deflection(feature)]
        found |= dict.fromkeys((feature.key for feature in (*(fault.feature for fault in offsets), *beside)), fit)
    return found


def _is_zero_of_torque(feature: Feature, joint: str) -> bool:
    """Whether an effect is the zero of a torque channel of a joint."""
    return feature.joint == joint and feature.read_torque is not None and feature.effect.set_at_start


def _moves_deflection(feature: Feature) -> bool:
    """Whether an effect makes a deflection agree with a joint torque whose zero is wrong: play, an encoder's zero."""
    play = any(parameter.exceeded_by for parameter in feature.effect.parameters)
    return play or (feature.effect.set_at_start and "q" in feature.sensed)


def _log_odds_of_one_torque(offsets: Sequence[LargeImperfection], final: FinalEstimates) -> float:
    """Return the log-odds, nats, of one torque that both channels read, against two zeros as far off as they are.

    Both explain the recording: what decides is by how much the offsets differ, which ordinary zeros make small.
    """
    apart = offsets[0].value - offsets[1].value
    uncertain = [fault.std for fault in offsets]
    ordinary = np.linalg.norm([*(final.ordinary_std(fault) for fault in offsets), *uncertain])
    unrelated = np.linalg.norm([*(fault.value for fault in offsets), *uncertain])
    return float(norm.logpdf(apart, scale=ordinary) - norm.logpdf(apart, scale=unrelated))
