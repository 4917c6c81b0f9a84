"""Of a long recording those segments are taken that tell most."""

import numpy as np

from elastic_arm.estimation.segments import SEGMENT, MostTelling
from elastic_arm.recording import Recording, Side
from tests.helpers.gap_recordings import ROBOT

RATE = 200.0


def swinging(begin: float, seconds: float, size: float, joints: int) -> Recording:
    """Return a recording in which some joints swing by `size` rad."""
    t = begin + np.arange(round(seconds * RATE)) / RATE
    w = np.array([1.0, 1.7, 2.3])
    position = size * np.sin(np.outer(t, w)) * (np.arange(3) < joints)
    return Recording(
        ROBOT.joint_names,
        motor=Side(np.rint(t * 1e9).astype(np.int64), position=position),
        source="run",
    )


def test_lively_motion_is_taken_and_what_hardly_tells_is_not() -> None:
    """Of 60 s in which one joint trembles, 20 s of motion of all joints, and 60 s more, the 20 s
    are taken."""
    telling = MostTelling(ROBOT, 2.0 * SEGMENT)
    for part in (
        swinging(0.0, 60.0, 0.01, 1),
        swinging(60.0, 20.0, 0.5, 3),
        swinging(80.0, 60.0, 0.01, 1),
    ):
        telling.add(part)
    found = telling.recording()
    assert found.motor is not None
    t = found.motor.stamp_ns * 1e-9
    assert np.sum((t >= 60.0) & (t < 80.0)) > 0.98 * 20.0 * RATE and len(t) < 31.0 * RATE
    assert any("most informative" in note for note in found.notes), found.notes


def test_another_motion_tells_more_than_the_same_again() -> None:
    """After a motion of one joint, that of the others is taken before its repetition."""
    telling = MostTelling(ROBOT, 2.0 * SEGMENT)
    same = swinging(0.0, 40.0, 0.5, 1)
    other = swinging(40.0, 10.0, 0.3, 3)
    for part in (same, other):
        telling.add(part)
    motor = telling.recording().motor
    assert motor is not None and motor.stamp_ns[-1] * 1e-9 > 45.0


def test_a_jump_of_an_encoder_is_no_motion_that_tells() -> None:
    """Of seconds in which an arm hardly moves, those with a jump are not preferred to a lively
    motion."""
    jump = swinging(0.0, 30.0, 0.01, 1)
    assert jump.motor is not None and jump.motor.position is not None
    jump.motor.position[round(5.0 * RATE) :] += 0.2
    telling = MostTelling(ROBOT, 0.5 * SEGMENT)
    for part in (jump, swinging(30.0, 20.0, 0.3, 3)):
        telling.add(part)
    motor = telling.recording().motor
    assert motor is not None and motor.stamp_ns[0] * 1e-9 > 25.0


def test_a_recording_that_is_short_enough_is_kept_whole() -> None:
    """Every sample of it, and without a word."""
    telling, part = MostTelling(ROBOT, 60.0), swinging(0.0, 30.0, 0.5, 3)
    telling.add(part)
    found = telling.recording()
    assert found.motor is not None and part.motor is not None and not found.notes
    np.testing.assert_array_equal(found.motor.stamp_ns, part.motor.stamp_ns)
    np.testing.assert_array_equal(found.motor.position, part.motor.position)


def test_a_hole_is_no_standstill_however_long_it_is() -> None:
    """A clock that leaps by decades while an arm moves costs nothing, and the note tells what was
    not recorded."""
    telling = MostTelling(ROBOT, 3.0 * SEGMENT)
    first, later = swinging(0.0, 12.0, 0.5, 3), swinging(1.7e9, 12.0, 0.5, 3)
    telling.add(Recording.joined([first, later]))
    found = telling.recording()
    assert found.motor is not None and len(found.motor) > 3000
    assert [note for note in found.notes if "standstill" in note] == []
    assert any(
        "nothing was recorded in 1699999988 of 1700000012 s" in note for note in found.notes
    ), found.notes
