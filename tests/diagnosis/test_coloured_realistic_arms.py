"""Arms on which everything is a little wrong, and nothing more, whose torque sensors have slow noise alone."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.effects.text import known_effects
from elastic_arm.robot import load_robot
from tests.helpers.noise_kinds import first_order
from tests.helpers.realistic_arms import imprecise, ordinary_faults, record

pytestmark = pytest.mark.slow(40)

ROBOT = load_robot()
FRICTION = known_effects(("coulomb_friction", "viscous_friction"), ROBOT)


@pytest.mark.parametrize("seed", [72, 75, 80])
def test_slow_noise_alone_is_no_gap(seed: int) -> None:
    """First-order noise of 10 ms and 0.26 Nm: beside that the encoders' noise in regressors must not look like laws."""
    rng = np.random.default_rng(seed)
    robot = imprecise(ROBOT, rng)
    *fitted, judged = record(robot, ordinary_faults(ROBOT.n, rng), (20.0, 20.0, 10.0), rng, first_order(0.01))
    found = diagnose(fitted, Question(ROBOT, given=FRICTION, refit=True), [judged])
    assert found.verdict == "none", [note for note in found.notes if "explains" in note]
    assert not found.causes
