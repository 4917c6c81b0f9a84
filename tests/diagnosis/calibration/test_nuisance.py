"""What a recording shows of a nuisance parameter beside its prior."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from elastic_arm.diagnosis.calibration import recalibration
from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.selection.candidates import feature_of
from elastic_arm.diagnosis.settings import DiagnosisSettings, RefitSettings
from elastic_arm.effects import parse
from elastic_arm.effects.equations import ArmEquations
from tests.helpers.gap_recordings import ROBOT

SETTINGS = RefitSettings()
GAIN = NuisanceParameter("joint_torque_gain", "joint_4", "1", 0.01, 1.0)
MASS = NuisanceParameter("link_mass", "joint_2", "1", 0.1, 1.0)
DAMPING = NuisanceParameter("damping", "joint_3", "1", 0.4, 1.0)


def posterior(alone: float, uncertain: float) -> tuple[float, float]:
    """Return the estimate of a gain's deviation with its prior, from what the recording alone determines."""
    variance = 1.0 / (uncertain**-2 + GAIN.prior_std**-2)
    return alone * variance / uncertain**2, float(np.sqrt(variance))


@pytest.mark.parametrize(("alone", "uncertain"), [(-0.5, 0.04), (0.2, 0.017), (0.003, 0.0005), (5.0, 3.0)])
def test_what_the_recording_alone_determines_is_the_estimate_without_its_prior(alone: float, uncertain: float) -> None:
    """The posterior divided by the prior gives the likelihood back."""
    assert GAIN.without_prior(*posterior(alone, uncertain)) == pytest.approx((alone, uncertain))


def test_a_narrow_prior_hides_no_sensor_that_reads_half() -> None:
    """Held back to -0.03 by a prior of 0.01, a gain that the recording puts at 0.50 +- 0.04 is beyond ordinary."""
    deviation, std = posterior(-0.5, 0.04)
    assert abs(deviation) < 3.5 * GAIN.prior_std
    assert GAIN.is_beyond(*GAIN.without_prior(deviation, std), SETTINGS)


@pytest.mark.parametrize(("alone", "uncertain"), [(0.025, 0.002), (0.2, 0.05), (5.0, 3.0)])
def test_what_is_within_the_prior_or_uncertain_is_not_beyond(alone: float, uncertain: float) -> None:
    """Two and a half deviations of the prior, and four of the recording, are no fault."""
    assert not GAIN.is_beyond(*GAIN.without_prior(*posterior(alone, uncertain)), SETTINGS)


@pytest.mark.parametrize(
    ("number", "ratio", "uncertain", "beyond"),
    [
        (DAMPING, 0.1, 0.02, True),  # 2.25 deviations of the prior, but a tenth
        (DAMPING, 1.9, 0.02, False),
        (DAMPING, 2.5, 0.02, True),
        (MASS, 0.6, 0.04, True),
        (MASS, 0.75, 0.02, False),
        (MASS, 1.45, 0.04, True),
        (MASS, 1.33, 0.05, False),  # an ordinary arm's estimate is as far off in 0.3 % of all cases
    ],
)
def test_a_positive_number_is_beyond_ordinary_by_its_factor(
    number: NuisanceParameter, ratio: float, uncertain: float, beyond: bool
) -> None:
    """A tenth of a damping and half a mass are far, whatever share of the whole is missing."""
    assert number.is_beyond(ratio - 1.0, uncertain, SETTINGS) is beyond


def test_an_ordinary_number_scatters_by_its_prior_and_by_its_own_deviation() -> None:
    """Three deviations of the prior, known exactly, are as far as 4.2 of them known to one."""
    assert MASS.distance(0.3, 1e-6) == pytest.approx(3.0)
    assert MASS.distance(0.3 * np.sqrt(2.0), 0.1) == pytest.approx(3.0)


def test_a_ratio_below_zero_is_not_ordinary_however_uncertain() -> None:
    """A gain of -0.32 +- 0.45 is no gain; one of 0.9 +- 0.45 may be any."""
    wide = NuisanceParameter("motor_torque_gain", "joint_4", "1", 0.15, 1.0)
    assert not wide.is_ordinary(-1.32, 0.45, SETTINGS)
    assert wide.is_ordinary(-0.1, 0.15, SETTINGS)


@pytest.mark.parametrize("whole", [False, True])
def test_a_drift_wanders_beside_its_rate_however_that_was_found(whole: bool) -> None:
    """As a random walk of its mean rate, which is a coefficient of its column, or a number of the whole law."""
    drift = feature_of(parse("torque_drift:joint_1:rate=0.2,channel=motor_torque", ROBOT), ArmEquations(ROBOT, "mod3"))
    found: Any = SimpleNamespace(feature=drift.whole() if whole else drift, searched=(0.2,) if whole else ())
    library = SimpleNamespace(coefficients=lambda selected: [np.array([1.0 if whole else 0.2])])
    prepared: Any = SimpleNamespace(library=library, settings=DiagnosisSettings())
    curves = recalibration._curves(prepared, [found])
    assert [curve.prior_std for curve in curves] == pytest.approx(
        [0.2 * np.sqrt(2.0) / np.pi / c.curve for c in curves]
    )
    assert all(curve.feature is not None and curve.feature.linear for curve in curves) and curves
