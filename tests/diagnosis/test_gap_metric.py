"""What a gap is measured by, and what is said of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.assembly import verdict as verdict_of
from elastic_arm.diagnosis.inference import judgement
from elastic_arm.diagnosis.inference.estimates import ParameterEstimate
from elastic_arm.diagnosis.inference.excess import ResidualStatistics
from elastic_arm.diagnosis.inference.gap_metric import ExcessMeasure, LikelihoodMeasure
from elastic_arm.diagnosis.inference.judgement import without_ordinary
from elastic_arm.diagnosis.result import Diagnosis
from elastic_arm.diagnosis.selection.hypothesis import Hypothesis, Rival
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import EFFECTS
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.draw import Request, draw
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import HiddenArm
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel
from elastic_arm.studies.blind_challenge.levels import LABORATORY

ROBOT = load_robot(None)
SETTINGS = DiagnosisSettings()
DETECTED, EXPLAINED = SETTINGS.significance.detected, SETTINGS.judgement.explained


def diagnosed(effects: tuple[str, ...], seed: int, size: float) -> Diagnosis:
    """Diagnose a hidden arm of another engine with effects of so many bounds."""
    rng = np.random.default_rng(seed)
    drawn = draw(Request("arm", effects, (seed,), (12.0, 8.0), (size, size)), LABORATORY, rng, EFFECTS)
    arm = HiddenArm(ROBOT, drawn.arm.faults)
    identify, validate = (arm.record(motion, SensorModel(), rng) for motion in drawn.motions)
    return diagnose([identify], Question(ROBOT), [validate])


# --- gaps that no residual shows


@pytest.mark.slow(7)
def test_an_effect_that_no_residual_shows_is_found_by_all_of_them_together() -> None:
    """A damping wrong by some 20 bounds stands out of no residual's noise; all equations together name it."""
    found = diagnosed(("damping_mismatch",), 8, 20.0)
    assert found.measured_by == "likelihood"
    assert found.verdict == "explained" and found.log_likelihood > DETECTED
    assert [c.effect for c in found.causes] == ["damping_mismatch"]
    assert found.shrink is not None and found.shrink_interval is not None
    low, high = found.shrink_interval
    assert low < 0.9 < found.shrink <= high  # what just stays undetected may be left


@pytest.mark.slow(3)
def test_a_clean_arm_of_another_engine_has_no_gap() -> None:
    """Nothing is found in noise, by size or by likelihood."""
    found = diagnosed((), 6, 20.0)
    assert (found.verdict, found.causes, found.shrink, found.log_likelihood) == ("none", (), None, 0.0)


class Gains:
    """A library whose selected gain what they say, evenly over forty blocks."""

    def held_out(self, selected: Any) -> float:
        return float(sum(selected))

    def falls(self, without: Any, selected: Any) -> tuple[Any, Any]:
        each = 2.0 * (sum(selected) - sum(without)) / 40.0
        return np.full(24, each), np.full(16, each)


def likelihood(left: float) -> LikelihoodMeasure:
    library: Any = Gains()
    before: Any = None
    selected: Any = [300.0, 100.0]
    return LikelihoodMeasure(library, before, [], selected, left, SETTINGS)


def test_a_faint_gap_is_what_the_best_explanation_gains_and_what_it_leaves() -> None:
    """Shares are of both; the lower end leaves room for what just stays undetected."""
    selected: Any = [300.0, 100.0]
    share, (low, high) = likelihood(100.0).share(selected)
    assert share == pytest.approx(0.8)
    assert low == pytest.approx(400.0 / (500.0 + DETECTED)) and high == pytest.approx(0.8)
    assert likelihood(0.0).share(selected)[0] == 1.0
    assert likelihood(100.0).share([]) == (0.0, (0.0, 0.0))


def test_a_causes_part_of_a_faint_gap_is_what_it_gains_beside_the_others() -> None:
    """Taken away, the second of two causes leaves a fifth of the gap."""
    selected: Any = [300.0, 100.0]
    assert likelihood(100.0).contribution(selected, 1) == pytest.approx(0.2)
    assert likelihood(-5.0).contribution(selected, 0) == pytest.approx(0.75)


# --- the band in which a cause is most


def figures(band: float, power: float, noise: float = 1.0) -> ResidualStatistics:
    squares = np.array([noise**2 + power])
    ones = np.full(1, noise)
    return ResidualStatistics(
        band, np.sqrt(squares), ones, ones, 1e5, np.full((8, 1), squares[0]), np.array([power > 0.0])
    )


def test_a_cause_counts_in_the_band_in_which_it_is_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is a thousandth of a low band's gap and a fifth of a wide one's is a fifth of the gap."""
    slow, wide = figures(2.5, 1000.0), figures(40.0, 5.0)
    left = {2.5: {2: 0.0, 1: 1.0}, 40.0: {2: 0.0, 1: 1.0}}  # by band, of both causes and of the first alone
    library: Any = None
    measure = ExcessMeasure(library, slow, [wide, slow], SETTINGS)
    monkeypatch.setattr(ExcessMeasure, "after", lambda self, selected, band: figures(band, left[band][len(selected)]))
    causes: Any = ["slow", "fast"]
    assert measure.contribution(causes, 1) == pytest.approx(0.2)


# --- what is said


@pytest.mark.parametrize(
    ("causes", "shrink", "unexplained", "verdict"),
    [
        (1, 1.0 - EXPLAINED, True, "explained"),  # so little may be left, whatever it looks like
        (1, 1.0 - EXPLAINED - 1e-6, True, "unknown"),
        (1, 1.0 - EXPLAINED - 1e-6, False, "explained"),  # what is left looks like noise
        (1, 0.1, False, "explained"),
        (0, 0.0, True, "unknown"),
        (0, 0.0, False, "none"),
    ],
)
def test_verdict_follows_what_is_left(causes: int, shrink: float, unexplained: bool, verdict: str) -> None:
    """A tenth of the excess may be left; more only if it looks like noise; without cause or rest there is no gap."""
    settings = SETTINGS.judgement
    assert verdict_of(shrink, caused=causes > 0, unexplained=unexplained, settings=settings) == verdict


def late(milliseconds: float, std: float = 0.01) -> Any:
    size = {"delay": ParameterEstimate(1e-3 * milliseconds, 1e-3 * std, "s")}
    choices = {"channels": ("joint_torque",)}
    feature = SimpleNamespace(effect=EFFECTS["time_delay"], joint="joint_2", choices=choices)
    return SimpleNamespace(size=size, feature=feature)


def friction() -> Any:
    return SimpleNamespace(size={}, feature=SimpleNamespace(effect=EFFECTS["coulomb_friction"]))


def test_a_lag_of_a_sample_is_no_cause_and_a_longer_one_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lags up to a sample move to what counts as the model and are noted; causes keep their own alternatives."""
    estimates = SimpleNamespace(parameters=lambda selected: [c.size for c in selected])
    monkeypatch.setattr(judgement, "matters", lambda prepared, hypothesis, k: False)
    prepared: Any = SimpleNamespace(library=None, rate=1000.0, settings=SETTINGS, estimates=estimates)
    known, drag, lag, delay = friction(), friction(), late(1.0), late(1.1)
    rivals = {1: [Rival(known, 0.1)], 2: [Rival(known, 0.2)], 3: [Rival(known, 0.3)]}
    found, notes = without_ordinary(prepared, Hypothesis([known, drag, lag, delay], 1, rivals))
    assert found.selected == [known, lag, drag, delay] and found.given == 2
    assert {k: r[0].odds for k, r in found.rivals.items()} == {2: 0.1, 3: 0.3}
    assert len(notes) == 1 and "joint_torque of joint_2 lags by 1.00 ms" in notes[0]
