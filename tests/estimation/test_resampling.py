"""From stamped samples to a regular grid: holes, jitter, pieces."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.resampling import Clock, interpolate
from elastic_arm.recording import Samples

RATE = 200.0


def samples(t: np.ndarray) -> Samples:
    """A smooth motion of two joints at instants t, with a torque."""
    q = np.stack([np.sin(2.0 * t), np.cos(3.0 * t)], axis=1)
    dq = np.stack([2.0 * np.cos(2.0 * t), -3.0 * np.sin(3.0 * t)], axis=1)
    stamps = np.round(1e9 * t).astype(np.int64)
    return Samples(
        t, q=q, dq=dq, tau_J=None, theta=None, dtheta=None, tau_m=q.copy(), stamp_ns=stamps
    )


def test_interpolation_is_exact_for_polynomials_of_fifth_order() -> None:
    """Six points determine a polynomial of fifth order."""
    rng = np.random.default_rng(0)
    known, wanted = np.sort(rng.uniform(0, 1, 40)), rng.uniform(0.1, 0.9, 20)
    values, expected = (
        np.polynomial.Polynomial([1, -2, 3, 0.5, -1, 2])(t)[:, None] for t in (known, wanted)
    )
    np.testing.assert_allclose(interpolate(known, values, wanted, 1.0), expected, rtol=1e-8)


def test_a_regular_recording_is_its_own_grid() -> None:
    """Nothing is changed where nothing has to be."""
    taken = samples(np.arange(1000) / RATE)
    clock = Clock.of(taken)
    (grid,) = clock.place(taken)
    assert clock.rate == pytest.approx(RATE) and len(grid) == 1000
    np.testing.assert_allclose(grid.q, taken.q, atol=1e-12)


@pytest.mark.parametrize(("unit", "words"), [(1e3, "too few"), (1e-3, "too many")])
def test_times_in_another_unit_are_refused(unit: float, words: str) -> None:
    """Milliseconds taken for seconds, or the reverse, give a rate at which no arm is recorded:
    asked is the unit."""
    taken = samples(np.arange(1000) * 5e-3)
    with pytest.raises(
        IdentificationError, match=f"run_1: .*{words}.*Are the times in another unit"
    ):
        Clock.of(replace(taken, t=unit * taken.t), "run_1")


def test_single_missing_samples_are_filled_and_gaps_cut() -> None:
    """A hole of one sample is interpolated; after a gap of half a second a new piece begins."""
    t = np.arange(2000) / RATE
    kept = np.ones(2000, dtype=bool)
    kept[300] = False
    kept[1000:1100] = False
    taken = samples(t[kept])
    grids = Clock.of(taken).place(taken)
    assert len(grids) == 2
    first = samples(grids[0].t)
    assert len(grids[0]) == 1000
    np.testing.assert_allclose(grids[0].q, first.q, atol=1e-7)


def test_noise_does_not_grow_across_a_hole() -> None:
    """Of twelve missing samples the motion is known as well as of recorded ones; through six points
    it is eight times worse."""
    t = (
        np.delete(np.arange(2000), np.add.outer(np.arange(200, 1800, 100), np.arange(12)).ravel())
        / 1000.0
    )
    taken = samples(t)
    noise = np.random.default_rng(5).standard_normal(taken.q.shape)
    noisy = replace(taken, q=taken.q + 1e-4 * noise)
    (grid,) = Clock.of(noisy).place(noisy)
    assert grid.q is not None and len(grid) == 2000
    inside = np.isin(np.arange(2000), np.rint(1000.0 * t).astype(int), invert=True)
    assert np.std((grid.q - samples(grid.t).q)[inside]) < 1.5e-4
