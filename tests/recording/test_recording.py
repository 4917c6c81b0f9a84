"""Parts of a recording."""

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side
from tests.helpers.bags import stamps, two_sided


def test_parts_and_joints_can_be_taken(rng: np.random.Generator) -> None:
    """`between` cuts by time from the start, `select` orders the columns, both on all sides."""
    recording = two_sided(rng, 1000)
    part = recording.between(0.2, 0.5)
    np.testing.assert_array_equal(part.motor.stamp_ns, stamps(1000)[200:500])
    np.testing.assert_array_equal(part.link.velocity, recording.link.velocity[200:500])
    chosen = recording.select(["joint_3", "joint_1"])
    np.testing.assert_array_equal(chosen.motor.effort, recording.motor.effort[:, [2, 0]])
    with pytest.raises(
        RecordingError, match="has no joint joint_9; it has joint_1, joint_2, joint_3"
    ):
        recording.select(["joint_9"])


@pytest.mark.parametrize(
    "stamp_ns",
    [
        np.arange(4)[::-1],
        np.zeros(4, int),
        np.arange(4)[:, None],
        np.arange(4) + 0j,
        np.full(4, np.nan),
        np.array("x"),
        np.arange(4, dtype=np.uint64) + 2**63,
        [[1], [1, 2]],
        np.arange(4).astype(str),
    ],
)
def test_stamps_that_are_none_are_refused(stamp_ns: object) -> None:
    """Falling, repeated, in two dimensions, or no numbers that 64 bits hold."""
    with pytest.raises(RecordingError, match="stamp"):
        Recording(("a",), Side(stamp_ns, np.zeros((4, 1)))).samples()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "values", [np.zeros((4, 1)) + 1j, np.full((4, 1), "a"), [[0.0]] * 3 + [[0.0, 1.0]]]
)
def test_values_that_are_no_real_numbers_are_refused(values: object) -> None:
    """The imaginary part would be lost."""
    with pytest.raises(RecordingError, match="not real numbers"):
        Side(np.arange(4), position=values)  # type: ignore[arg-type]


def test_masked_values_are_no_values() -> None:
    """What lies under a mask is NaN, and not whatever the array holds there."""
    values = np.ma.masked_array(np.ones((4, 1), int), mask=[[False], [True], [False], [False]])
    position = Side(np.arange(4), position=values).position  # type: ignore[arg-type]
    np.testing.assert_array_equal(position, [[1.0], [np.nan], [1.0], [1.0]])
