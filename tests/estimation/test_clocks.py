"""Whether stamps that jitter are true is found from the motion, and given with numbers."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.estimation.resampling import Clock
from elastic_arm.recording import Samples

RATE = 500.0


def recorded(
    at: np.ndarray, stamps: np.ndarray, noise: float = 1e-5, velocity: bool = True
) -> Samples:
    """A motion of two joints read at `at` and stamped `stamps`, with encoder noise, rad."""
    rng = np.random.default_rng(1)
    q = 0.5 * np.stack([np.sin(2.0 * at), np.cos(3.0 * at)], axis=1)
    dq = 0.5 * np.stack([2.0 * np.cos(2.0 * at), -3.0 * np.sin(3.0 * at)], axis=1)
    q = q + noise * rng.standard_normal(q.shape)
    dq = dq + 30.0 * noise * rng.standard_normal(q.shape)
    ns = np.round(1e9 * stamps).astype(np.int64)
    return Samples(
        stamps,
        q=q,
        dq=dq if velocity else None,
        tau_J=None,
        theta=None,
        dtheta=None,
        tau_m=q,
        stamp_ns=ns,
    )


def jittered(std: float) -> tuple[np.ndarray, np.ndarray]:
    """Regular instants, and the same with independent jitter of so many seconds."""
    regular = np.arange(5000) / RATE
    return regular, regular + np.random.default_rng(0).uniform(-1.0, 1.0, 5000) * np.sqrt(3.0) * std


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("std", [1e-4, 3e-4])
def test_true_stamps_are_believed(std: float, velocity: bool) -> None:
    """Samples read at jittering instants go by their stamps, and the note has the share of the
    jitter that shows."""
    _, irregular = jittered(std)
    clock = Clock.of(recorded(irregular, irregular, velocity=velocity))
    assert clock.mode == "stamps"
    assert "ms" in clock.note and "±" in clock.note


def test_true_stamps_are_believed_beside_missing_samples() -> None:
    """One sample in thirty is lost, and no velocity was recorded: differences between the holes
    tell."""
    _, irregular = jittered(1e-4)
    at = irregular[np.random.default_rng(2).random(len(irregular)) > 0.03]
    clock = Clock.of(recorded(at, at, velocity=False))
    assert clock.mode == "stamps" and "smooth" in clock.note


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("std", [1e-4, 3e-4])
def test_late_stamps_of_regular_samples_are_not(std: float, velocity: bool) -> None:
    """Samples read regularly and stamped with jitter stay regular."""
    regular, irregular = jittered(std)
    clock = Clock.of(recorded(regular, irregular, velocity=velocity))
    assert clock.mode == "regular"
    assert "regular sample times are used" in clock.note


@pytest.mark.parametrize("late", [1e-3, 2.5e-3])
def test_stamps_late_by_more_than_an_interval_are_no_missing_samples(late: float) -> None:
    """Late stamps in order of arrival keep to a regular clock; every sample is one of its
    points."""
    at = np.arange(5000) / RATE
    stamps = (
        np.maximum.accumulate(at + np.abs(np.random.default_rng(4).normal(0.0, late, 5000)))
        + 1e-9 * RATE * at
    )
    taken = recorded(at, stamps)
    clock = Clock.of(taken)
    assert clock.mode == "regular"
    assert clock.rate == pytest.approx(RATE, rel=1e-3)
    (grid,) = clock.place(taken)
    np.testing.assert_array_equal(grid.q, taken.q)


def test_a_host_loop_that_wanders_goes_by_its_stamps() -> None:
    """Steps of 0.7 to 2.1 periods with gaps to 9: encoder noise hides each, but not where they add
    up to."""
    rng = np.random.default_rng(3)
    steps = rng.uniform(0.7, 2.1, 8000) / 1000.0
    steps[rng.integers(0, 8000, 40)] = 9e-3
    at = np.cumsum(steps)
    taken = recorded(at, at, noise=2e-4)
    clock = Clock.of(taken)
    assert clock.mode == "stamps"
    grids = clock.place(taken)
    assert sum(map(len, grids)) > 0.99 * (at[-1] - at[0]) * clock.rate
    error = np.abs(grids[0].q[:, 0] - 0.5 * np.sin(2.0 * (grids[0].t)))
    assert np.sqrt(np.mean(error**2)) < 4e-4


def test_the_users_word_overrules_the_evidence() -> None:
    """A demanded clock is taken, and noted."""
    _, irregular = jittered(3e-4)
    clock = Clock.of(replace(recorded(irregular, irregular), clock="regular"))
    assert clock.mode == "regular" and "as requested" in clock.note


def test_regular_stamps_need_no_word() -> None:
    """A recording without jitter has no note."""
    regular = np.arange(2000) / RATE
    assert Clock.of(recorded(regular, regular)).note == ""
