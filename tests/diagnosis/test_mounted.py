"""An arm that is mounted otherwise than described: the gap before is that of the description."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from elastic_arm.diagnosis import Question, diagnose
from elastic_arm.recording import Recording
from elastic_arm.robot.parts import placed
from elastic_arm.simulation import simulate
from tests.helpers.gap_recordings import ROBOT, motions
from tests.helpers.nightly import nightly


@pytest.mark.parametrize(
    ("x", "y"), [(np.pi, 0.0), *nightly([(0.0, np.pi / 2.0)])], ids=["ceiling", "wall"]
)
def test_another_mounting_removes_the_gap_of_the_description(x: float, y: float) -> None:
    turned = Rotation.from_euler("XY", [x, y]).as_matrix()
    base = placed(turned) @ ROBOT.base_placement
    arm = ROBOT.with_(base_placement=base, base_dh=None)

    def recorded(k: int) -> Recording:
        return simulate(arm, motions()[k], rng=np.random.default_rng(k))

    found = diagnose([recorded(0)], Question(ROBOT, effects=["base_tilt"]), [recorded(1)])
    (cause,) = found.causes
    assert (found.verdict, cause.effect) == ("explained", "base_tilt")
    assert found.before.rmse["joint_2", "link"] > 100.0 * found.after.rmse["joint_2", "link"]
    assert cause.shrink > 0.99
    assert found.shrink is not None and found.shrink > 0.99
