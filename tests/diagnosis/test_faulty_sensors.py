"""A sensor that is far off beside an effect that bends the model: its prior is not to hold it back."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.challenge_arms import diagnosed_field_arm


@pytest.mark.slow
def test_an_offset_beside_a_spring_is_found_as_one_and_leaves_the_spring_its_size(tmp_path: Path) -> None:
    """Held by a prior of 0.5 Nm an offset of -23 Nm bent the masses: four springs and counterbalances stood for both.

    Arm 47 of the field level's seed 917001: motor side alone, seven joints.
    """
    true, found = diagnosed_field_arm(tmp_path, ("motor_torque_offset", "joint_spring"), (917001, 41))
    assert found.verdict == "explained"
    causes = {(cause.effect, cause.joint): cause.parameters for cause in found.causes}
    assert causes.keys() == true.keys()
    for key, parameters in true.items():
        for name, value in parameters.items():
            estimate = causes[key][name]
            assert estimate.std is not None and isinstance(estimate.value, float)
            assert abs(estimate.value - value) < 3.0 * estimate.std
            assert estimate.std < 0.05 * abs(value)
