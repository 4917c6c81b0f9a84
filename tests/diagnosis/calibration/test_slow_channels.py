"""A low pass of a torque channel, of which the lag is a nuisance parameter that acts like it to first order."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.calibration.slow_channels import beside_low_passes
from elastic_arm.diagnosis.calibration.torque_filters import filters_for_lags
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.selection.regressor_library import Candidate
from elastic_arm.diagnosis.settings import DiagnosisSettings
from elastic_arm.effects import parse
from elastic_arm.effects.equations import ArmEquations
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import load_robot
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

ROBOT = load_robot(None)
EQUATIONS = ArmEquations(ROBOT, "mod3")
LAGS = [
    NuisanceParameter(
        f"time_delay_{channel}",
        "joint_2",
        "s",
        3e-4,
        0.0,
        feature_of(parse(f"time_delay:joint_2:delay=1e-3,channels={channel}", ROBOT), EQUATIONS),
    )
    for channel in ("joint_torque", "motor_torque")
]


def low_pass(channels: str, cutoff: float) -> Candidate:
    """Return a low pass of some channels of joint 2."""
    effect = parse(f"torque_lowpass:joint_2:cutoff={cutoff},channels={channels}", ROBOT)
    return Candidate(feature_of(effect, EQUATIONS).whole(), (cutoff,), slice(0, 0), fixed=True)


def test_a_filter_takes_the_lag_of_its_channel() -> None:
    """A filter of 10 ms whose channel lags by 6 ms more is one of 16 ms."""
    values, (found,) = filters_for_lags(LAGS, np.array([20.0, 1.0]), [low_pass("joint_torque", 50 / np.pi)])
    assert values == pytest.approx([0.0, 1.0])
    assert found.searched == pytest.approx((1.0 / (2 * np.pi * 0.016),))


def test_a_filter_of_two_channels_takes_what_both_lag_alike() -> None:
    """Of a channel that lags and one that hardly does, the mean would make the second one early."""
    values, (found,) = filters_for_lags(LAGS, np.array([52.0, 2.0]), [low_pass("joint_torque+motor_torque", 50.0)])
    assert values == pytest.approx([50.0, 0.0])
    assert found.searched == pytest.approx((1.0 / (1.0 / 50.0 + 2 * np.pi * 6e-4),))


def test_a_channel_that_a_cause_filters_gets_no_second_filter() -> None:
    """Of a lag that is left beside a low pass, the first one takes all, and the second would have no corner."""
    known, other = (low_pass("motor_torque", cutoff) for cutoff in (6.0, 20.0))
    prepared: Any = SimpleNamespace(
        calibration=SimpleNamespace(parameters=LAGS),
        found=SimpleNamespace(values=np.array([0.0, 50.0])),
        candidates=(other.feature,),
        settings=DiagnosisSettings(),
    )
    assert beside_low_passes(prepared, [known]) == (prepared, [known])


@pytest.mark.slow
def test_a_low_pass_is_not_taken_for_the_lag_of_its_channel() -> None:
    """A joint torque behind 10 Hz, on an arm that is a little wrong everywhere, is no lag of 16 ms."""
    rng = np.random.default_rng(52)
    true, ordinary = imprecise(ROBOT, rng), ordinary_faults(ROBOT.n, rng)
    slow = Fault("torque_lowpass", 1, {"cutoff": 10.0}, channels=("joint_torque",))
    first, judge = record(true, [*ordinary, slow], (16.0, 8.0), rng)
    given = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)
    found = diagnose([first], Question(ROBOT, refit=True, given=given), [judge])
    (cause,) = found.causes
    assert (cause.effect, cause.joint) == ("torque_lowpass", "joint_2")
    assert cause.instance.parameters["channels"] == ("joint_torque",)
    assert cause.parameters["cutoff"].value == pytest.approx(10.0, rel=0.05)
    assert found.verdict == "explained" and cause.confidence > 0.95
