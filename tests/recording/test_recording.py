"""Parts of a recording."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from tests.helpers.bags import stamps, two_sided


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2)


def test_parts_and_joints_can_be_taken(rng: np.random.Generator) -> None:
    """`between` cuts by time from the start, `select` orders the columns, both on all sides."""
    recording = two_sided(rng, 1000)
    part = recording.between(0.2, 0.5)
    np.testing.assert_array_equal(part.motor.stamp_ns, stamps(1000)[200:500])
    np.testing.assert_array_equal(part.link.velocity, recording.link.velocity[200:500])
    chosen = recording.select(["joint_3", "joint_1"])
    np.testing.assert_array_equal(chosen.motor.effort, recording.motor.effort[:, [2, 0]])
    with pytest.raises(RecordingError, match="has no joint joint_9; it has joint_1, joint_2, joint_3"):
        recording.select(["joint_9"])
