"""What a recording shows of a nuisance parameter beside its prior."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis.calibration.nuisance import NuisanceParameter
from elastic_arm.diagnosis.settings import RefitSettings

SETTINGS = RefitSettings()
GAIN = NuisanceParameter("joint_torque_gain", "joint_4", "1", 0.01, 1.0)


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
