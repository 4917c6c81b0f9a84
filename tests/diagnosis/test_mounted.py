"""An arm that is mounted otherwise than described: the gap before is that of the description."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.diagnosis.corrected_robot import repaired_robot
from elastic_arm.identification.batch.mounting import Mounting
from elastic_arm.recording import Recording
from elastic_arm.robot import Robot
from elastic_arm.robot.parts import placed
from elastic_arm.simulation import SimulationSettings, simulate
from tests.helpers.gap_recordings import RATE, ROBOT, motions
from tests.helpers.nightly import nightly


def recorded(arm: Robot, k: int) -> Recording:
    settings = SimulationSettings(rate=RATE)
    return simulate(arm, motions()[k], settings, rng=np.random.default_rng(k))


@pytest.mark.parametrize(
    ("x", "y"), [(np.pi, 0.0), *nightly([(0.0, np.pi / 2.0)])], ids=["ceiling", "wall"]
)
def test_another_mounting_removes_the_gap_of_the_description(x: float, y: float) -> None:
    turned = Rotation.from_euler("XY", [x, y]).as_matrix()
    base = placed(turned) @ ROBOT.base_placement
    arm = ROBOT.with_(base_placement=base, base_dh=None)

    found = diagnose([recorded(arm, 0)], Question(ROBOT, effects=["base_tilt"]), [recorded(arm, 1)])
    (cause,) = found.causes
    assert (found.verdict, cause.effect) == ("explained", "base_tilt")
    assert found.before.rmse["joint_2", "link"] > 100.0 * found.after.rmse["joint_2", "link"]
    assert cause.shrink > 0.99
    assert found.shrink is not None and found.shrink > 0.99


def test_the_corrected_arm_has_the_tilt_beside_the_mounting() -> None:
    """The mounting is assumed to a degree, and what is found beside it belongs to the arm: both
    turns are one, from the description, and gravity is that of the recording."""
    turned = Rotation.from_euler("XY", [0.0, 0.5275]).as_matrix()
    arm = ROBOT.with_(base_placement=placed(turned) @ ROBOT.base_placement, base_dh=None)
    found = diagnose([recorded(arm, 0)], Question(ROBOT, effects=["base_tilt"]), [recorded(arm, 1)])
    corrected = repaired_robot(ROBOT, found)
    np.testing.assert_allclose(_felt(corrected), _felt(arm), atol=0.02)


def _felt(arm: Robot) -> np.ndarray:
    """Return gravity (3,) m/s² in the frame of the base."""
    gravity = np.asarray(arm.base_placement)[:3, :3].T @ np.asarray(arm.gravity)
    return np.asarray(gravity)


@pytest.mark.parametrize("mounting", [(0.2, 0.5), (1.5, 0.3), (2.9, 0.1)])
def test_deviations_of_both_turns_are_those_of_gravity(mounting: tuple[float, float]) -> None:
    """They agree with those of turns drawn at random; on its side an arm does not show a turn about
    the vertical."""
    where = Mounting(*mounting, np.zeros(3), np.array([0.0, 0.0, -9.81]))
    drawn = np.random.default_rng(1).normal([0.01, -0.02], [1e-3, 2e-3], (4_000, 2))
    told = where.tilted_by((1e-3, 2e-3), 0.01, -0.02)
    np.testing.assert_allclose(told, np.std([where.tilted(*one) for one in drawn], 0), rtol=0.05)


def test_a_turn_about_the_vertical_is_unknown() -> None:
    on_its_side = Mounting(np.pi / 2.0, 0.0, np.zeros(3), np.array([0.0, 0.0, -9.81]))
    x, y = on_its_side.tilted_by((0.01, 0.01), 0.0, 0.0)
    assert (x, y) == pytest.approx((0.01, np.pi / np.sqrt(3.0)))
