"""Derivatives: exact where they can be, honest about noise, and the same filter for all terms."""

import numpy as np
import pytest

from elastic_arm.errors import IdentificationError
from elastic_arm.estimation.noise import estimate_noise
from elastic_arm.estimation.resampling import LONGEST_HOLE, LONGEST_HOLE_SECONDS, Clock, Grid, part
from elastic_arm.estimation.smoother import Smoother, design_smoother, instantaneous
from elastic_arm.recording import Samples

RATE = 1000.0
LINES = ((0.6, 0.2, 0.0), (0.3, 0.5, 1.0), (0.1, 1.1, 2.0), (2e-4, 7.0, 0.3))


def motion(t: np.ndarray, order: int) -> np.ndarray:
    """Derivative of a sum of sinusoids, two joints (N, 2)."""
    one = sum(
        a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * t + p + order * np.pi / 2)
        for a, f, p in LINES
    )
    return np.stack([one, 0.7 * one], axis=1)


def noisy(
    position_std: float, velocity_std: float | None, seconds: float = 20.0, seed: int = 0
) -> Grid:
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    q = motion(t, 0) + position_std * rng.standard_normal((len(t), 2))
    dq = (
        None
        if velocity_std is None
        else motion(t, 1) + velocity_std * rng.standard_normal((len(t), 2))
    )
    return Grid(t, RATE, q=q, dq=dq)


def smoother(cutoff_hz: float, crossover_hz: float = np.inf) -> Smoother:
    w = np.full(2, 2 * np.pi * crossover_hz)
    return Smoother(RATE, 2 * np.pi * cutoff_hz, w, w)


def samples(t: np.ndarray, q: np.ndarray) -> Samples:
    stamps = np.rint(t * 1e9).astype(np.int64)
    return Samples(t, q, None, np.zeros_like(q), None, None, None, stamps)


@pytest.mark.parametrize("crossover", [np.inf, 30.0])
def test_cubic_motion_comes_out_exactly(crossover: float) -> None:
    """Position, velocity and acceleration of a cubic are exact, with and without a velocity
    channel."""
    t = np.arange(3000) / RATE
    cubic = np.stack([0.3 + 0.5 * t - 0.2 * t**2 + 0.1 * t**3, 1.0 - t], axis=1)
    rate = np.stack([0.5 - 0.4 * t + 0.3 * t**2, -np.ones_like(t)], axis=1)
    got = smoother(20.0, crossover)(Grid(t, RATE, q=cubic, dq=rate))
    acceleration = np.stack([-0.4 + 0.6 * got.t, np.zeros_like(got.t)], axis=1)
    lag = (len(t) - len(got)) // 2
    assert np.abs(got.q - cubic[lag:-lag]).max() < 1e-11
    assert np.abs(got.dq - rate[lag:-lag]).max() < 1e-9
    assert np.abs(got.ddq - acceleration).max() < 1e-6


@pytest.mark.parametrize("crossover", [np.inf, 20.0])
def test_consistent_channels_and_torques_see_one_response(crossover: float) -> None:
    """Positions, their derivatives and torques are all multiplied by H = 1 / (1 + (f / f_c)^8),
    without phase."""
    t = np.arange(4000) / RATE
    f, cutoff = 15.0, 20.0
    q = np.stack([np.sin(2 * np.pi * f * t)] * 2, axis=1)
    dq = 2 * np.pi * f * np.stack([np.cos(2 * np.pi * f * t)] * 2, axis=1)
    means = np.sinc(f / RATE) * q
    got = smoother(cutoff, crossover)(Grid(t, RATE, q=q, dq=dq, tau_J=means))
    lag = (len(t) - len(got)) // 2
    response = 1.0 / (1.0 + (f / cutoff) ** 8)
    assert np.abs(got.q - response * q[lag:-lag]).max() < 1e-7
    assert (
        np.abs(got.ddq + response * (2 * np.pi * f) ** 2 * q[lag:-lag]).max()
        < 1e-7 * (2 * np.pi * f) ** 2
    )
    assert np.abs(got.tau_J - response * q[lag:-lag]).max() < 1e-6


@pytest.mark.parametrize(
    ("position_std", "velocity_std"), [(1e-6, 1e-4), (1e-5, 1e-2), (1e-4, 1e-3)]
)
def test_noise_of_both_channels_is_estimated_from_the_recording(
    position_std: float, velocity_std: float
) -> None:
    """The standard deviations of position and velocity noise are found to 10 %."""
    grid = noisy(position_std, velocity_std)
    found = estimate_noise(grid.q, grid.dq, RATE)
    assert found.position_std == pytest.approx(position_std, rel=0.1)
    assert found.velocity_std == pytest.approx(velocity_std, rel=0.1)


def test_noise_of_positions_alone_is_estimated() -> None:
    """Without a velocity channel the position noise is still found to 10 %."""
    found = estimate_noise(noisy(1e-5, None).q, None, RATE)
    assert found.velocity_std is None
    assert found.position_std == pytest.approx(1e-5, rel=0.1)


def test_velocities_that_contradict_the_positions_are_not_trusted() -> None:
    """A velocity channel 90 ms late, as of a filtering drive, has no say in the derivatives."""
    grid = noisy(1e-6, None)
    late = Grid(grid.t, RATE, q=grid.q, dq=motion(grid.t - 0.09, 1))
    got = design_smoother([late], 2)(late)
    assert np.sqrt(np.mean((got.dq - motion(got.t, 1)) ** 2)) < 1e-3


def test_smoothed_acceleration_is_far_better_than_finite_differences() -> None:
    """With encoder noise of 1e-6 rad the smoother's acceleration is 100 times better than second
    differences."""
    grid = noisy(1e-6, 1e-4)
    got = design_smoother([grid], 2)(grid)
    error = np.sqrt(np.mean((got.ddq - motion(got.t, 2)) ** 2))
    differences = np.diff(grid.q, 2, axis=0) * RATE**2
    crude = np.sqrt(np.mean((differences - motion(grid.t[1:-1], 2)) ** 2))
    assert error < 0.01 * crude
    assert error < 0.02


def test_torques_are_taken_from_means_to_their_stamps() -> None:
    """Averaging over a sample interval takes 0.26 % off a 40 Hz torque; 99 % of that is given
    back."""
    t = np.arange(500) / RATE
    torque = np.sin(2 * np.pi * 40.0 * t)[:, None]
    means = np.sinc(40.0 / RATE) * torque
    left = np.abs(instantaneous(means) - torque)[1:-1].max()
    assert left < 0.01 * np.abs(means - torque).max()


def test_short_holes_are_bridged() -> None:
    """Lost samples, up to four in a row, cost no accuracy that matters."""
    t = np.arange(5000) / RATE
    lost = np.r_[1000, 2000:2004, 3000:3002]
    whole = samples(t, motion(t, 0))
    kept = part(whole, np.setdiff1d(np.arange(len(t)), lost))
    grids = Clock.of(kept).place(kept)
    assert len(grids) == 1
    assert len(grids[0]) == len(t)
    assert np.abs(grids[0].q - motion(t, 0)).max() < 1e-9


def test_long_gaps_part_the_recording() -> None:
    """A gap longer than the bridged ones makes two pieces, none of which reaches over it."""
    t, bridged = np.arange(5000) / RATE, max(LONGEST_HOLE, int(LONGEST_HOLE_SECONDS * RATE))
    whole = samples(t, motion(t, 0))
    kept = part(whole, np.setdiff1d(np.arange(len(t)), np.arange(2000, 2000 + bridged + 1)))
    assert [len(grid) for grid in Clock.of(kept).place(kept)] == [2000, 5000 - 2000 - bridged - 1]


def test_jittered_stamps_of_regular_samples_are_seen_through() -> None:
    """Where the motion is smooth in the sample number and not in the stamps, the stamps are not
    believed."""
    rng = np.random.default_rng(1)
    t = np.arange(4000) / RATE
    stamped = t + 1e-4 * rng.standard_normal(len(t))
    assert Clock.of(samples(stamped, motion(t, 0))).mode == "regular"


def test_samples_truly_taken_at_jittered_times_are_interpolated() -> None:
    """Where the motion is smooth in the stamps, they are believed and the motion comes out
    right."""
    rng = np.random.default_rng(1)
    t = np.arange(4000) / RATE + 1e-4 * rng.standard_normal(4000)
    taken = samples(t, motion(t, 0))
    clock = Clock.of(taken)
    grid = clock.place(taken)[0]
    assert clock.mode == "stamps"
    assert np.abs(grid.q - motion(grid.t, 0)).max() < 1e-9


def test_a_recording_that_runs_back_in_time_is_refused() -> None:
    """The error names the time from which the stamps no longer advance."""
    t = np.arange(1000) / RATE
    t[500:] -= 0.2
    with pytest.raises(IdentificationError, match=r"0\.499"):
        Clock.of(samples(t, np.zeros((1000, 1))))


def test_a_piece_too_short_for_the_smoother_is_refused() -> None:
    """The error says how long a piece must be."""
    t = np.arange(100) / RATE
    with pytest.raises(IdentificationError, match="too short"):
        smoother(5.0)(Grid(t, RATE, q=motion(t, 0)))
