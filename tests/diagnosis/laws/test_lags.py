"""Delays and low passes of torque channels: told apart where the recording can, else both are listed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.laws.better_laws import BetterLaws
from elastic_arm.diagnosis.laws.lags import _contradict, _passed, delays_for_filters, filters_for_delays
from elastic_arm.diagnosis.ranked_causes import RankedCause
from elastic_arm.diagnosis.result import Cause
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import parse
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.library.torque_filters import low_pass_error, moved
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)
EQUATIONS = ArmEquations(ROBOT, "mod3")
DETECTED = DiagnosisSettings().significance.detected
DELAY = parse("time_delay:joint_1:delay=0.0022,channels=motor_torque", ROBOT)
LOW_PASS = parse("torque_lowpass:joint_1:cutoff=70,channels=motor_torque", ROBOT)


def low_passes(monkeypatch: pytest.MonkeyPatch, expected: float, ratio: float) -> dict[Any, Any]:
    """Return what stands in the place of a delay where the low pass has these expected and found log-likelihoods."""
    monkeypatch.setattr("elastic_arm.diagnosis.laws.lags._difference", lambda *_: [])
    prepared: Any = SimpleNamespace(
        settings=DiagnosisSettings(), model=SimpleNamespace(robot=ROBOT), candidates=[feature_of(LOW_PASS, EQUATIONS)]
    )
    comparison: Any = SimpleNamespace(against=lambda _: (expected, ratio))
    fault: Any = SimpleNamespace(feature=feature_of(DELAY, EQUATIONS), value=0.0022)
    return filters_for_delays(prepared, comparison, [], [fault])


def test_joints_that_contradict_each_other_leave_both_possible() -> None:
    """A coefficient of 1 at one joint and of 0 at another is no low pass of both, nor a delay."""
    certain = DiagnosisSettings().refit.certain
    assert _contradict([(31.7, 30.7), (172.3, -194.6), (38.8, -17.3)], certain)
    assert not _contradict([(31.7, 27.0), (172.3, 150.0), (38.8, 20.0)], certain)


@pytest.mark.parametrize("ratio", [-10.0, 50.0])
def test_the_odds_are_even_where_the_recording_cannot_tell(ratio: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Below what counts as detected, the likelihoods decide nothing."""
    (rival,) = low_passes(monkeypatch, 0.5 * DETECTED, ratio).values()
    assert rival.candidate.feature.effect.id == "torque_lowpass"
    assert rival.odds == 1.0


def test_a_recording_that_tells_them_apart_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """A low pass that loses clearly is no alternative, and one that wins clearly is the likelier of the two."""
    assert not low_passes(monkeypatch, 10 * DETECTED, -10 * DETECTED)
    (rival,) = low_passes(monkeypatch, 2 * DETECTED, 2 * DETECTED).values()
    assert rival.odds == pytest.approx(np.exp(2 * DETECTED))


@pytest.mark.parametrize("ratio", [0.0, 2.0, -2.0])
def test_what_is_neither_a_delay_nor_a_low_pass_decides_nothing(ratio: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The difference of the two fits with a coefficient of 0.5, 1.5 or -0.5 of known error: neither 0 nor 1."""
    (rival,) = low_passes(monkeypatch, 10 * DETECTED, ratio * 10 * DETECTED).values()
    assert rival.odds == 1.0


def test_the_alternative_takes_its_share_of_the_confidence() -> None:
    """Cause and alternative share what the cause had."""
    feature = feature_of(DELAY, EQUATIONS)
    size = {"delay": ParameterEstimate(0.0022, 1e-5, "s")}
    cause = Cause("time_delay", "joint_1", ("motor",), "frequency", size, 1.0, 0.98, (), DELAY)
    ranked = RankedCause(cause, Candidate(feature, (), slice(0, 0)), (), [])
    low_pass = Candidate(feature_of(LOW_PASS, EQUATIONS).whole(), (70.0,), slice(0, 0), fixed=True)
    rival: Any = SimpleNamespace(candidate=low_pass, odds=1.0)
    found = ranked.against(BetterLaws(filters={feature.key: rival})).cause
    assert found.confidence == pytest.approx(0.49)
    assert [(a.effect, a.confidence) for a in found.alternatives] == [("torque_lowpass", pytest.approx(0.49))]
    assert replace(found, confidence=0.98, alternatives=()) == cause


def test_the_likelier_low_pass_is_the_cause() -> None:
    """It is as late as the delay, in whose place it is, and the delay is its alternative."""
    feature = feature_of(DELAY, EQUATIONS)
    size = {"delay": ParameterEstimate(0.0022, 1e-5, "s")}
    cause = Cause("time_delay", "joint_1", ("motor",), "frequency", size, 1.0, 0.96, (), DELAY)
    ranked = RankedCause(cause, Candidate(feature, (), slice(0, 0)), (), [])
    cutoff = 1.0 / (2.0 * np.pi * 0.0022)
    low_pass = Candidate(feature_of(LOW_PASS, EQUATIONS).whole(), (cutoff,), slice(0, 0), fixed=True)
    rival: Any = SimpleNamespace(candidate=low_pass, odds=3.0)
    found = ranked.against(BetterLaws(filters={feature.key: rival})).cause
    assert (found.effect, found.joint, found.confidence) == ("torque_lowpass", "joint_1", pytest.approx(0.72))
    assert [(a.effect, a.confidence) for a in found.alternatives] == [("time_delay", pytest.approx(0.24))]
    assert found.parameters["cutoff"].value == pytest.approx(cutoff)
    assert found.parameters["cutoff"].std == pytest.approx(cutoff * 1e-5 / 0.0022)
    assert found.instance.parameters == {"cutoff": pytest.approx(cutoff), "channels": ("motor_torque",)}


def test_a_low_pass_moved_back_differs_from_nothing_at_second_order() -> None:
    """A low pass less the delay of its time constant is half its square times the second derivative."""
    t, T, omega = np.arange(0.0, 4.0, 1e-3), 2e-3, 2 * np.pi * 3.0
    torque = np.sin(omega * t)[:, None]
    behind = moved(t, torque + low_pass_error(t, torque, 1.0 / (2 * np.pi * T)), T)
    inner = slice(100, -100)
    expected = -0.5 * T**2 * omega**2 * np.sin(omega * t)
    np.testing.assert_allclose((behind - torque)[inner, 0], expected[inner], atol=0.1 * np.abs(expected).max())


@pytest.mark.parametrize(("expected", "doubtful"), [(0.5 * DETECTED, True), (2.0 * DETECTED, False)])
def test_a_low_pass_that_a_delay_could_be_is_said_to_be_either(
    expected: float, doubtful: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a search took for a low pass is compared with the delay: where their difference is not to be seen, both."""
    monkeypatch.setattr("elastic_arm.diagnosis.laws.lags._difference", lambda *_: [])
    lag: Any = SimpleNamespace(
        is_lag=True, joint="joint_1", channel="motor_torque", feature=feature_of(DELAY, EQUATIONS)
    )
    prepared: Any = SimpleNamespace(
        settings=DiagnosisSettings(),
        model=SimpleNamespace(robot=ROBOT),
        calibration=SimpleNamespace(parameters=[lag]),
    )
    comparison: Any = SimpleNamespace(against=lambda *_: (expected, -expected))
    cause = Candidate(feature_of(LOW_PASS, EQUATIONS).whole(), (16.0,), slice(0, 0), fixed=True)
    found = delays_for_filters(prepared, comparison, [], [cause])
    assert list(found) == ([cause.feature.key] if doubtful else [])
    for rival in found.values():
        assert (rival.candidate.feature.effect.id, rival.candidate.feature.joint) == ("time_delay", "joint_1")
        assert rival.odds == 1.0


@pytest.mark.parametrize("slow", [False, True])
def test_noise_of_the_torque_does_not_decide_between_delay_and_low_pass(slow: bool) -> None:
    """What is left of it in the difference of the two follows itself in the residual by less than a third."""
    rng, t, T, std = np.random.default_rng(5), np.arange(0.0, 20.0, 1e-3), 2e-3, 0.3
    true = 30.0 * np.sin(2 * np.pi * 0.7 * t) + 8.0 * np.sin(2 * np.pi * 4.0 * t)
    noise, white, colour = std * rng.standard_normal(len(t)), std**2, None
    if slow:
        # First order, 10 ms: its density is that of a low pass of 16 Hz, and next to none is white.
        keep = np.exp(-1e-3 / 0.01)
        noise, white = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], noise), 1e-3 * std**2
        density = std**2 * (1.0 - keep**2) / (1.0 - keep) ** 2
        colour = SimpleNamespace(density=lambda _, f: (density / (1.0 + (f / 15.9) ** 2))[:, None])
    motion = SimpleNamespace(tau_J=None, tau_m=(true + noise)[:, None])
    signals = SimpleNamespace(t=t, torque_noise={"tau_m": np.array([white])})
    noises = SimpleNamespace(rate=1000.0, f=np.linspace(0.0, 50.0, 400), colour=colour)
    part: Any = SimpleNamespace(signals=signals, stretch=SimpleNamespace(motion=motion), noise=noises)
    column = _passed(part, "tau_m", 0, T)[200:-200, 0]
    torque = true[:, None]
    clean = (moved(t, torque + low_pass_error(t, torque, 1.0 / (2 * np.pi * T)), T) - torque)[200:-200, 0]
    assert column @ clean == pytest.approx(clean @ clean, rel=0.1)
    assert abs((column - clean) @ noise[200:-200]) < 0.3 * clean @ clean
