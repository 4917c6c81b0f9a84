"""Late torque channels: whether the lag is a delay or a low pass, where the recording can tell.

To first order both are the rate of the torque times a time. What they differ by is of second order, T^2 y'' / 2, and in
the motion of an arm often less than a recording shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from elastic_arm.diagnosis.calibration.torque_filters import is_low_pass, lags_of
from elastic_arm.diagnosis.inference.faults import LargeImperfection
from elastic_arm.diagnosis.inference.lack_of_fit import placed
from elastic_arm.diagnosis.laws.comparison import LawComparison
from elastic_arm.diagnosis.preparation import PreparedData
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.selection.hypothesis import Key, Rival
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.effects import EffectInstance
from elastic_arm.effects.library.torque_filters import CHANNELS, CLEAR, low_pass_error, moved
from elastic_arm.estimation.effect_columns import Feature
from elastic_arm.estimation.noise import wiener_filter
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
        by_joint = _differences(prepared, sets, fault.feature, fault.value)
        expected, ratio = comparison.against(_summed(by_joint))
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


def delays_for_filters(
    prepared: PreparedData,
    comparison: LawComparison,
    sets: Sequence[WhitenedData],
    causes: Sequence[Candidate],
) -> dict[Key, Rival]:
    """Return the delays that could stand in the place of low passes of one torque channel, by key of the low pass.

    A search takes the low pass that fits best. Where what it does beside a delay as late is not to be seen, that was
    decided by other imperfections of the model; and where the delay fits better, the search had other columns: the odds
    are even.

    Parameters
    ----------
    prepared, comparison, sets
        As of :func:`filters_for_delays`.
    causes
        Of the hypothesis, where the comparison was made.
    """
    found: dict[Key, Rival] = {}
    parameters, settings = prepared.calibration.parameters, prepared.settings
    for cause in causes:
        feature, (cutoff, *_) = cause.feature, cause.searched or (np.inf,)
        if not is_low_pass(feature.effect) or _channel(feature) is None or not np.isfinite(cutoff):
            continue
        lags = [lag for k in lags_of(parameters, feature) if (lag := parameters[k].feature) is not None]
        if not lags:
            continue
        delay = 1.0 / (2.0 * np.pi * cutoff)
        added = _summed(_differences(prepared, sets, feature, delay))
        expected, ratio = comparison.against([[-part for part in parts] for parts in added], cause)
        decided = expected >= settings.significance.detected
        odds = float(np.exp(np.clip(ratio, -700.0, 0.0))) if decided else 1.0
        if odds > settings.search.least_odds:
            values = {lags[0].linear[0].name: delay, **lags[0].choices}
            other = feature_of(EffectInstance(lags[0].effect, feature.joint, values), lags[0].equations)
            found[feature.key] = Rival(Candidate(other, (), slice(0, 0)), odds)
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
        channel = _channel(fault.feature)
        if channel is None or fault.value <= 0.0:
            continue
        for other in low_passes:
            if other.joint == fault.feature.joint and _channel(other) == channel:
                yield fault, other


def _channel(feature: Feature) -> str | None:
    """Return the torque channel on which alone an effect acts; None where there is no such."""
    channels = tuple(feature.choices.get("channels", ()))
    return channels[0] if len(channels) == 1 and channels[0] in CHANNELS else None


def _differences(
    prepared: PreparedData, sets: Sequence[WhitenedData], feature: Feature, delay: float
) -> list[list[list[Array]]]:
    """Return what a low pass adds to a delay (s) as late, by joint on which it acts: as :func:`_difference`, by set."""
    names, channel = prepared.model.robot.joint_names, _channel(feature)
    assert channel is not None
    joints = range(len(names)) if feature.joint is None else [names.index(feature.joint)]
    return [[_difference(data, channel, j, delay) for data in sets] for j in joints]


def _summed(by_joint: Sequence[Sequence[Sequence[Array]]]) -> list[list[Array]]:
    return [[np.sum(parts, axis=0) for parts in zip(*own, strict=True)] for own in zip(*by_joint, strict=True)]


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
    """Return a torque behind a low pass, moved back by as much as that is late, less the torque, (N, 1).

    It is the recorded one, at the frequencies at which it is far above its noise. Noise of this torque is noise of the
    residual as well, and the difference grows with the square of the frequency: regressed on it, the residual of an arm
    of six joints had the coefficient of a delay at one joint and of a low pass at another, whatever the arm had. The
    torque that the model predicts is worse, as it holds the noise of the accelerations.

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
    t, motion, noise = part.signals.t, part.stretch.motion, part.noise
    recorded = (motion.tau_J if name == "tau_J" else motion.tau_m)[:, joint]
    density = np.full(len(noise.f), part.signals.torque_noise[name][joint])
    if noise.colour is not None:
        density += noise.colour.density(name, noise.f)[:, joint]
    torque = wiener_filter(recorded, noise.rate, noise.f, density)(CLEAR)[:, None]
    behind = torque + low_pass_error(t, torque, 1.0 / (2.0 * np.pi * delay))
    return np.asarray(moved(t, behind, delay) - torque)
