"""A cause as large as what the arm does without it, about which nothing is linear."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.helpers.challenge_arms import diagnosed_field_arm


@pytest.mark.slow
def test_a_payload_as_heavy_as_a_small_arm_is_one_and_no_motor_gain(tmp_path: Path) -> None:
    """Calibrated without it, the motors of seven joints had gains of 1.5 to 2.3, about which friction drove.

    Arm 14 of the field level's seed 918001: motor side alone, 3 kg at an arm of a few Nm.
    """
    drawn, found = diagnosed_field_arm(tmp_path, ("payload",), (918001, 20))
    (((_, joint), true),) = drawn.items()
    assert found.verdict == "explained"
    assert [(cause.effect, cause.joint) for cause in found.causes] == [("payload", joint)]
    mass, position = (found.causes[0].parameters[name] for name in ("mass", "position"))
    assert mass.std is not None and abs(mass.value - true["mass"]) < 3.0 * mass.std and mass.std < 0.1 * true["mass"]
    at = np.array([true[f"position_{axis}"] for axis in "xyz"])
    assert np.all(np.abs(np.subtract(position.value, at)) < 3.0 * np.asarray(position.std))
    assert all(one.ordinary for one in found.imperfections)
