"""The ends of a recording: where they are part of the fit, and that they are right there."""

import numpy as np

from elastic_arm.estimation.resampling import Grid
from elastic_arm.estimation.smoother import FOREIGN, with_ends

RATE, LOST = 200.0, 400


def grid(seconds: float, begin: float = 0.0) -> Grid:
    """Return a joint that swings at 1 Hz from `begin` seconds on, until as long before the end."""
    t = np.arange(round(seconds * RATE)) / RATE
    moving = (t > begin) & (t < t[-1] - begin)
    return Grid(t, RATE, q=np.where(moving, np.sin(2 * np.pi * (t - begin)), 0.0)[:, None])


def test_the_ends_of_a_short_recording_are_part_of_the_fit() -> None:
    """Of 20 s, of which the smoother would lose 2 s, all but that share is kept in which a trace is
    foreign."""
    piece = grid(20.0)
    longer = with_ends(piece, LOST)
    lost = LOST - (len(longer) - len(piece))
    assert 0 < lost < 0.5 * LOST
    assert np.isclose(lost, LOST * np.log(FOREIGN) / np.log(1e-11), atol=2)
    inner = slice((len(longer) - len(piece)) // 2, -((len(longer) - len(piece)) // 2))
    np.testing.assert_array_equal(longer.q[inner], piece.q)


def test_ends_at_which_the_arm_stands_are_left_out() -> None:
    """A joint at rest carries any torque up to its dry friction."""
    piece = grid(20.0, begin=1.5)
    assert with_ends(piece, LOST) is piece


def test_a_long_recording_stays_as_it_is() -> None:
    """What is lost of two minutes is nothing."""
    piece = grid(120.0)
    assert with_ends(piece, LOST) is piece
