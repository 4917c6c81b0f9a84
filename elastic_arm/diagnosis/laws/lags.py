"""Late torque channels: whether the lag is a delay or a low pass, where the recording can tell.

To first order both are the rate of the torque times a time. What they differ by is of second order, T^2 y'' / 2, and in
the motion of an arm often less than a recording shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.torque_filters import is_low_pass
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.lack_of_fit import placed
from elastic_arm.diagnosis.laws.comparison import LawComparison
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.hypothesis import Key, Rival
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects.library.torque_filters import CHANNELS, low_pass_error, moved
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.noise import wiener_filtered
from elastic_arm.estimation.whitening import Part, WhitenedData

Array = NDArray[np.float64]


def filters_for_delays(
    prepared: PreparedData,
    comparison: LawComparison,
    sets: Sequence[WhitenedData],
    faults: Sequence[LargeImperfection],
) -> dict[Key, Rival]:
    """Return the low passes that could stand in the place of delays, with their odds, by key of the delay.

    What a low pass does beside a delay as late has the coefficient 0 of a delay and 1 of a low pass. Where the expected
    ratio of likelihoods is below what counts as detected, or the coefficient is neither, or another at each joint of a
    fault of the whole arm, other imperfections of the model decide which of the two fits better: the odds are even.

    Parameters
    ----------
    prepared
        Data and regressors.
    comparison
        Of the hypothesis at its optimum.
    sets
        Identification and validation, there.
    faults
        What it names beyond ordinary.
    """
    detected, least = prepared.settings.significance.detected, prepared.settings.search.least_odds
    found: dict[Key, Rival] = {}
    for fault, low_pass in _delays(prepared, faults):
        names = prepared.model.robot.joint_names
        joints = range(len(names)) if fault.feature.joint is None else [names.index(fault.feature.joint)]
        (channel,) = fault.feature.choices["channels"]
        by_joint = [[_difference(data, channel, j, fault.value) for data in sets] for j in joints]
        blocks = [[np.sum(parts, axis=0) for parts in zip(*own, strict=True)] for own in zip(*by_joint, strict=True)]
        expected, ratio = comparison.against(blocks)
        # In standard deviations of the coefficient, which is 1 / sqrt(2 expected).
        nearest = (abs(ratio) - expected) / np.sqrt(2.0 * max(expected, np.finfo(float).tiny))
        undecided = expected < detected or abs(nearest) > prepared.settings.refit.certain
        if not undecided and len(by_joint) > 1:
            told = [one for one in map(comparison.against, by_joint) if one[0] >= detected]
            undecided = _contradict(told, prepared.settings.refit.certain)
        odds = 1.0 if undecided else float(np.exp(np.clip(ratio, -700.0, 700.0)))
        if odds > least:
            cutoff = 1.0 / (2.0 * np.pi * fault.value)
            found[fault.feature.key] = Rival(Candidate(low_pass.whole(), (cutoff,), slice(0, 0), fixed=True), odds)
    return found


def _contradict(told: Sequence[tuple[float, float]], certain: float) -> bool:
    """Whether the coefficients of low passes at several joints differ.

    Parameters
    ----------
    told
        Expected and found logarithm of the ratio of likelihoods of each.
    certain
        Standard deviations by which they differ for certain.
    """
    pairs = [(0.5 + 0.5 * ratio / expected, 0.5 / expected) for expected, ratio in told]
    return any(abs(a - b) > certain * np.sqrt(u + v) for (a, u), (b, v) in combinations(pairs, 2))


def _delays(prepared: PreparedData, faults: Sequence[LargeImperfection]) -> Iterator[tuple[LargeImperfection, Feature]]:
    """Yield each fault that is a delay of one torque channel, with the low pass of that channel."""
    low_passes = [feature for feature in prepared.candidates if is_low_pass(feature.effect)]
    for fault in faults:
        channels = fault.feature.choices.get("channels", ())
        if len(channels) != 1 or channels[0] not in CHANNELS or fault.value <= 0.0:
            continue
        for other in low_passes:
            if other.joint == fault.feature.joint and tuple(other.choices["channels"]) == tuple(channels):
                yield fault, other


def _difference(data: WhitenedData, channel: str, joint: int, delay: float) -> list[Array]:
    """Return what a low pass as late as a delay adds to the residuals (N', R, 1) of a channel moved back by that.

    Parameters
    ----------
    data
        Of a recording.
    channel
        "joint_torque" or "motor_torque".
    joint
        Index of the one that is late.
    delay
        s.
    """
    parts = [data.band.apply(_passed(part, CHANNELS[channel], joint, delay))[part.stretch.kept] for part in data.parts]
    return placed(data, "sensor" if channel == "joint_torque" else "motor", joint, parts)


def _passed(part: Part, name: str, joint: int, delay: float) -> Array:
    """Return a predicted torque behind a low pass, moved back by as much as that is late, less the torque, (N, 1).

    Parameters
    ----------
    part
        Of a recording.
    name
        tau_J or tau_m.
    joint
        Its index.
    delay
        s.
    """
    t, noise = part.signals.t, part.noise
    torque = part.signals.values[name][:, joint]
    if noise.load is not None:
        # The noise of accelerations is no torque that a filter could have passed.
        torque = wiener_filtered(torque, noise.rate, noise.f, noise.load[:, joint])
    torque = torque[:, None]
    behind = torque + low_pass_error(t, torque, 1.0 / (2.0 * np.pi * delay))
    return np.asarray(moved(t, behind, delay) - torque)
