"""Where an arm stands still, and that a long bag is read in parts."""

from pathlib import Path

import numpy as np
import pytest

from elastic_arm.recording import Recording, Side, read_recording, write_recording
from elastic_arm.recording.reading import read_parts
from elastic_arm.recording.standstill import KEPT, without_standstill
from elastic_arm.recording.storage.bag import open_bag
from tests.helpers.bags import two_sided

RATE = 250.0


def arm(noise: float = 1e-4, rest: float = 60.0) -> Recording:
    """Return two joints, of which one swings for 5 s before and after a rest; the other stands
    throughout."""
    t = np.arange(round((10.0 + rest) * RATE)) / RATE
    moving = np.where(t < 5.0, np.sin(t), np.where(t > 5.0 + rest, np.sin(t - rest), np.sin(5.0)))
    position = np.stack([moving, np.full_like(t, 0.3)], axis=1)
    position += noise * np.random.default_rng(0).standard_normal(position.shape)
    stamps = np.rint(t * 1e9).astype(np.int64)
    return Recording(("a", "b"), motor=Side(stamps, position=position), source="run")


def test_standstill_is_left_out_but_for_some_seconds_around_motion() -> None:
    """What is kept is the motion and 3 s on either side of the rest; a note says how much that
    leaves out."""
    whole = arm()
    found = without_standstill(whole)
    t = found.motor.stamp_ns * 1e-9
    hole = int(np.argmax(np.diff(t)))
    assert 5.0 + KEPT <= t[hole] + 0.01 < 6.1 + KEPT and 63.9 - KEPT < t[hole + 1] <= 65.0 - KEPT
    assert np.sum(np.diff(t) > 1.5 / RATE) == 1
    assert found.notes[-1].startswith("run: 5") and found.notes[-1].endswith(
        "s of standstill are excluded"
    )


def test_an_absurd_sample_is_no_motion() -> None:
    """A spike in the middle of the rest does not keep the seconds around it."""
    whole = arm()
    whole.motor.position[round(35.0 * RATE)] = 1e6
    found = without_standstill(whole)
    assert len(found.motor or ()) == len(without_standstill(arm()).motor or ())


def test_short_rests_and_arms_that_never_move_keep_all() -> None:
    """There is nothing to be gained by a hole, and what is no motion is for others to refuse."""
    short = arm(rest=4.0)
    assert without_standstill(short) is short
    whole = arm()
    still = Recording(
        ("b",), motor=Side(whole.motor.stamp_ns, position=whole.motor.position[:, 1:])
    )
    assert without_standstill(still) is still


@pytest.mark.skipif(
    not Path("/proc/self/smaps").exists(), reason="Linux says what of a file stands in memory"
)
def test_of_a_bag_that_was_read_next_to_nothing_stays_in_memory(tmp_path: Path) -> None:
    """Its chunks are given back one after another: a day's bag would fill the memory."""
    path = write_recording(
        tmp_path / "bag", two_sided(np.random.default_rng(0), 20_000), compression="none"
    )
    (bag,) = open_bag(path).files
    for _ in bag.blocks():
        pass
    _, _, held = Path("/proc/self/smaps").read_text().partition(str(bag.path))
    kilobytes = int(held.partition("Rss:")[2].split()[0])
    size = bag.path.stat().st_size
    assert size > 4e6 and 1e3 * kilobytes < 0.2 * size


def test_the_parts_of_a_bag_are_the_recording(tmp_path: Path) -> None:
    """Put together they hold every sample of it, and the last one says that all was read."""
    bag = write_recording(tmp_path / "bag", two_sided(np.random.default_rng(0), 20_000))
    parts = list(read_parts(bag, most=10_000))
    whole = read_recording(bag)
    joined = Recording.joined([part for part, _ in parts])
    assert len(parts) > 2 and parts[-1][1] == 1.0
    for name, values in whole.link.channels().items():
        np.testing.assert_array_equal(joined.link.channels()[name], values)
    np.testing.assert_array_equal(joined.link.stamp_ns, whole.link.stamp_ns)
