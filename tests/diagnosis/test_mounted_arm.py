"""An arm of the challenge's engine that is described as standing on a wall, and stands on the floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.identification.batch.mounting import about_x, about_y
from elastic_arm.robot import Robot
from tests.helpers.challenge_arms import diagnosed_field_arm

pytestmark = pytest.mark.slow(60)


def on_a_wall(robot: Robot) -> Robot:
    """The description with its base turned by a right angle."""
    turn = np.eye(4)
    turn[:3, :3] = about_y(np.pi / 2)
    return robot.with_(base_placement=turn @ robot.base_placement, base_dh=None)


def test_a_wrong_mounting_is_the_first_cause_and_hides_no_other(tmp_path: Path) -> None:
    """The tilt of a right angle comes out to a degree, and an effect of the arm beside it."""
    true, found = diagnosed_field_arm(tmp_path, ["torque_ripple"], (7, 3), on_a_wall)
    tilt = found.causes[0]
    assert tilt.effect == "base_tilt" and tilt.held_as == "number" and tilt.confidence > 0.9
    x, y = (tilt.parameters[name].value for name in "xy")
    turned = (about_x(x) @ about_y(y) @ about_y(np.pi / 2)).T @ [0.0, 0.0, -1.0]
    assert turned == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
    assert {(cause.effect, cause.joint) for cause in found.causes[1:]} == set(true)
