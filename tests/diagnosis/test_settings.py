"""Every group of thresholds decides something: with another value the answer is another one."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import Diagnosis, DiagnosisSettings, Question, diagnose
from elastic_arm.diagnosis.data.preprocessing import clock_drift
from elastic_arm.diagnosis.data.split import split
from elastic_arm.diagnosis.inference.regimes import regime
from elastic_arm.diagnosis.selection.candidates import starting_points
from elastic_arm.diagnosis.settings import (
    CandidateSettings,
    ExperimentSettings,
    PreprocessingSettings,
    RegimeSettings,
    ResamplingSettings,
    SearchSettings,
    SplitSettings,
)
from elastic_arm.effects import EFFECTS
from elastic_arm.effects.parameters import Parameter, Role
from elastic_arm.errors import DiagnosisError
from elastic_arm.recording import Recording, Samples
from tests.helpers.gap_recordings import ROBOT, motions, record

DEFAULT = DiagnosisSettings()
FRICTION = (EFFECTS["coulomb_friction"],)


@pytest.fixture(scope="module")
def pair() -> list[Recording]:
    """Two recordings of an arm with dry friction in joint 2."""
    return [record(motion, "coulomb_friction:joint_2:torque=6", seed=k) for k, motion in enumerate(motions())]


def diagnosed(pair: list[Recording], **changed: Any) -> Diagnosis:
    """Diagnose with other thresholds in one or more groups."""
    settings = replace(DEFAULT, **{name: replace(getattr(DEFAULT, name), **new) for name, new in changed.items()})
    return diagnose([pair[0]], Question(ROBOT, effects=FRICTION, settings=settings), [pair[1]])


@pytest.fixture(scope="module")
def usual(pair: list[Recording]) -> Diagnosis:
    """The diagnosis with the thresholds as they are."""
    return diagnosed(pair)


@pytest.mark.parametrize(
    ("changed", "verdict", "causes"),
    [
        ({"search": {"least_gain": 1e9}}, "unknown", 0),  # nothing is worth being selected
        ({"judgement": {"least_shrink": 1.01, "place_explained": 1.01}}, "unknown", 0),  # nothing is large enough
        ({"judgement": {"level": 1.0}}, "unknown", 0),  # no interval excludes anything
        ({"significance": {"noise_guard": 1e9, "detected": 1e9}}, "none", 0),  # nothing counts as a gap
    ],
    ids=["search", "judgement", "level", "significance"],
)
def test_thresholds_of_search_judgement_and_significance_decide(
    pair: list[Recording], usual: Diagnosis, changed: dict[str, Any], verdict: str, causes: int
) -> None:
    """Friction that is the one cause is none where more is asked of a candidate, a cause, or a gap."""
    assert (usual.verdict, len(usual.causes)) == ("explained", 1)
    found = diagnosed(pair, **changed)
    assert (found.verdict, len(found.causes)) == (verdict, causes)


def test_seeds_draw_the_intervals_and_nothing_else(pair: list[Recording], usual: Diagnosis) -> None:
    """With another seed the interval of the shrink is another one, and every other digit the same."""
    written = diagnosed(pair, resampling={"shrink_seed": 7}).to_dict()
    assert written["shrink_interval"] != usual.to_dict()["shrink_interval"]
    assert {**written, "shrink_interval": None} == {**usual.to_dict(), "shrink_interval": None}


def test_a_recording_decides_by_what_a_cause_must_gain() -> None:
    """The log-likelihood that decides between two effects is the one that a cause must gain: one number."""
    assert ExperimentSettings().decisive == SearchSettings().least_gain


def test_what_is_held_back_and_how_short_it_may_be_are_settings(pair: list[Recording]) -> None:
    """The share that judges is held back, and a part below the shortest is refused."""
    fitted, judging = split([pair[0]], [], replace(SplitSettings(), held_back=0.5))
    assert judging[0].duration == pytest.approx(fitted[0].duration, rel=0.02)
    with pytest.raises(DiagnosisError, match="too short"):
        split([pair[0]], [], replace(SplitSettings(), shortest=5.0))


def test_a_drift_below_the_threshold_is_no_drift() -> None:
    """Clocks that drift apart by 0.1 ms a second are brought together only if that is more than what is noticed."""
    t = np.arange(0.0, 10.0, 0.002)
    theta = np.stack([np.sin(1.3 * t), np.cos(0.7 * t)], axis=1)
    late = t / (1.0 + 1e-4)
    q = np.stack([np.sin(1.3 * late), np.cos(0.7 * late)], axis=1)
    samples = Samples(t, q, None, None, theta, None, None, stamp_ns=np.round(1e9 * t).astype(np.int64))
    assert clock_drift(samples, PreprocessingSettings()) == pytest.approx(1e-4, rel=0.05)
    assert clock_drift(samples, replace(PreprocessingSettings(), clock_shift=1.0)) is None


def test_the_grid_holds_as_many_values_as_set() -> None:
    """A nonlinear parameter is tried at `grid` values, an integer one at `orders`."""
    speed = Parameter("speed", "rad/s", 0.01, 1.0, role=Role.SEARCHED)
    one: Any = SimpleNamespace(searched=(speed,))
    assert len(starting_points(one, CandidateSettings(), ())) == CandidateSettings().grid
    assert len(starting_points(one, replace(CandidateSettings(), grid=3), ())) == 3


def test_a_weak_share_names_no_regime() -> None:
    """A residual of which a twentieth follows the load has no regime of its own, unless so little counts."""
    shares = {"load": 0.05, "drift": 0.01}
    assert regime(shares, RegimeSettings()) == "always"
    assert regime(shares, replace(RegimeSettings(), weak=0.02)) == "load"


def test_every_use_of_chance_has_a_seed_of_its_own() -> None:
    """The seeds belong to the settings."""
    names = {f.name for f in fields(ResamplingSettings())}
    assert names >= {"significance_seed", "shrink_seed", "fall_seed", "odds_seed"}
