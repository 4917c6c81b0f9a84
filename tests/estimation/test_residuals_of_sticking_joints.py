"""What a joint's friction may be while it sticks is removed from residuals and columns, and nothing
else."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equation_sets import EquationSet
from elastic_arm.estimation.noise import encoder_steps
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.residuals import FreeTorque, FreeTorques, Stretch, residuals
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import ROBOT, motions, record

MODEL = build_model(ROBOT, "mod3")
LAYOUT = EquationSet.direct(("theta", "tau_m"), MODEL.n)
STICKS = 1  # joint
STANDING = np.full(MODEL.n, 5e-3)
NO_STEPS = {"link": np.zeros(1), "motor": np.zeros(1)}


@lru_cache(maxsize=1)
def setting() -> tuple[Band, Stretch, np.ndarray]:
    """Return a narrow band, a stretch in which one joint stands for 0.1 s every second, and where
    it stands (N,)."""
    recording = record(motions()[0], seed=0, sensors=Sensors.real())
    seen = observe(replace(recording, link=None))
    band = Band(5.0, seen.rate)
    (stretch,) = residuals(MODEL, seen, LAYOUT, band)
    stands = np.mod(stretch.quiet.t, 1.0) < 0.1
    speed = np.where(np.arange(MODEL.n) == STICKS, np.where(stands, 0.0, 1.0)[:, None], 1.0)
    return band, replace(stretch, quiet=replace(stretch.quiet, dtheta=speed)), stands


def in_band(torque: np.ndarray) -> np.ndarray:
    """Return a motor torque (N,) of the joint that sticks as rows (N', R)."""
    band, stretch, _ = setting()
    rows = np.zeros((len(torque), LAYOUT.rows))
    rows[:, STICKS] = torque
    return band.apply(rows)[stretch.kept]


def test_friction_that_changes_sign_while_the_joint_stands_is_removed() -> None:
    """Whenever it does so within the 0.1 s: a twentieth of it is left in a band of 5 Hz."""
    band, stretch, stands = setting()
    t = stretch.quiet.t
    changes = (
        np.floor(t)
        + np.random.default_rng(1).uniform(0.0, 0.1, size=int(t[-1]) + 2)[np.floor(t).astype(int)]
    )
    torque = in_band(np.sign(t - changes) * stands)
    left = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING).remove(
        torque
    )
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(torque)


def test_other_joints_and_most_of_the_friction_are_kept() -> None:
    """Rows of other joints are all kept, and friction shows."""
    band, stretch, _ = setting()
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    others = np.random.default_rng(2).normal(size=(len(stretch.t), LAYOUT.rows))
    others[:, STICKS] = 0.0
    np.testing.assert_array_equal(sticking.remove(others), others)
    friction = in_band(np.sign(np.sin(2 * np.pi * 0.2 * stretch.quiet.t)))
    assert np.linalg.norm(sticking.remove(friction)) > 0.7 * np.linalg.norm(friction)


def test_torques_are_removed_at_once_as_one_after_the_other() -> None:
    """By their bases and estimates, also where two of them share instants."""
    band, stretch, _ = setting()
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    twice = replace(sticking, found=(*sticking.found, *sticking.found[::2]))
    rows = np.random.default_rng(3).normal(size=(len(stretch.t), LAYOUT.rows, 2))
    expected = rows.copy()
    for free in twice.found:
        own = expected[:, free.row]
        assert free.basis is not None and free.estimate is not None
        seen = np.concatenate([own[free.instants], own[free.beside]])
        own[free.instants] -= free.basis @ (free.estimate @ seen)
    np.testing.assert_allclose(twice.remove(rows), expected, atol=1e-12)


def test_a_torque_that_fills_a_recording_is_removed_as_one_of_a_moment() -> None:
    """Its matrices are not sparse; what they remove is the same."""
    rng = np.random.default_rng(4)
    for length in (50, 2000):
        basis = rng.normal(size=(40, 5))
        estimate = rng.normal(size=(5, 45))
        beside = np.arange(44, 49)
        torque = FreeTorque(1, slice(2, 42), basis, beside, estimate)
        rows = rng.normal(size=(length, 3, 2))
        expected = rows.copy()
        seen = np.concatenate([rows[2:42, 1], rows[beside, 1]])
        expected[2:42, 1] -= basis @ (estimate @ seen)
        found = FreeTorques((torque,), length).remove(rows)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_friction_of_a_joint_that_sticks_half_of_the_time_is_removed() -> None:
    """Wrists with much friction and little motion: a sign that the law gets wrong in 0.5 s of every
    second."""
    band, stretch, _ = setting()
    t = stretch.quiet.t
    stands = np.mod(t, 1.0) < 0.5
    speed = np.where(np.arange(MODEL.n) == STICKS, np.where(stands, 0.0, 1.0)[:, None], 1.0)
    stretch = replace(stretch, quiet=replace(stretch.quiet, dtheta=speed))
    torque = in_band(np.sign(np.sin(2 * np.pi * 3.0 * t)) * stands)
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    assert np.linalg.norm(sticking.remove(torque)) < 0.05 * np.linalg.norm(torque)


def test_a_joint_that_stands_long_takes_all_of_its_rows_and_next_to_none_of_others() -> None:
    """Any torque while it stands is gone from the rows, and from a second later on a motion keeps
    all but its ends."""
    band, stretch, _ = setting()
    t = stretch.quiet.t
    stands = (t > 2.0) & (t < 5.0)
    speed = np.where(np.arange(MODEL.n) == STICKS, np.where(stands, 0.0, 1.0)[:, None], 1.0)
    stretch = replace(stretch, quiet=replace(stretch.quiet, dtheta=speed))
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    torque = in_band(np.random.default_rng(5).normal(size=len(t)) * stands)
    assert np.linalg.norm(sticking.remove(torque)) < 0.05 * np.linalg.norm(torque)
    moving = in_band(np.sin(20.0 * t) * (np.abs(t - 3.5) > 2.0))
    assert np.linalg.norm(sticking.remove(moving)) > 0.95 * np.linalg.norm(moving)
    assert max(one.basis.shape[1] for one in sticking.found if one.basis is not None) < 40


def test_the_share_of_noise_that_is_left_is_known() -> None:
    """Of noise in the band as much is left as is said, to a tenth: as many rows tell of what is
    left."""
    band, stretch, _ = setting()
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    noise = np.stack(
        [
            in_band(np.random.default_rng(k).normal(size=len(stretch.quiet.t)))[:, STICKS]
            for k in range(40)
        ]
    )
    rows = np.zeros((noise.shape[1], LAYOUT.rows, len(noise)))
    rows[:, STICKS] = noise.T
    left = np.sum(sticking.remove(rows)[:, STICKS] ** 2) / np.sum(noise**2)
    share = sticking.shares(*rows.shape[:2], band).mean(axis=0)
    assert 0.5 < share[STICKS] < 0.95 and abs(share[STICKS] / left - 1.0) < 0.1
    assert np.all(np.delete(share, STICKS) == 1.0)


def test_columns_are_treated_as_residuals_are() -> None:
    """What is removed of several columns at once is what is removed of each."""
    band, stretch, _ = setting()
    sticking = FreeTorques.of(stretch, band, LAYOUT, NO_STEPS, friction=True, standing=STANDING)
    columns = np.random.default_rng(3).normal(size=(len(stretch.t), LAYOUT.rows, 4))
    together = sticking.remove(columns)
    for k in range(4):
        np.testing.assert_allclose(together[:, :, k], sticking.remove(columns[:, :, k]), atol=1e-12)


def test_the_steps_of_encoders_are_those_that_stand_out_of_their_noise() -> None:
    """A code of 1e-5 rad is found; an encoder without steps, and one whose steps are below its
    noise, have none."""
    rng = np.random.default_rng(4)
    angle = np.cumsum(rng.normal(0.0, 3e-6, 4000))
    coarse, noisy = (
        np.round(angle / 1e-5) * 1e-5,
        np.round((angle + rng.normal(0.0, 1e-4, 4000)) / 1e-6) * 1e-6,
    )
    steps = encoder_steps(
        np.stack([coarse, angle, noisy], axis=1), np.array([1e-5 / np.sqrt(12.0), 1e-5, 1e-4])
    )
    np.testing.assert_allclose(steps, [1e-5, 0.0, 0.0])


def test_what_an_encoder_makes_of_a_code_that_it_holds_is_removed() -> None:
    """A deflection that is read a step off while the joint stands leaves the drive's rows, where
    steps are known."""
    band, stretch, stands = setting()
    layout = EquationSet.direct(("q", "theta", "tau_J", "tau_m"), MODEL.n)
    speed = stretch.quiet.dtheta
    stretch = replace(stretch, quiet=replace(stretch.quiet, dq=speed, dtheta=np.ones_like(speed)))
    rows = np.zeros((len(stands), layout.rows))
    rows[:, MODEL.n + STICKS] = stands
    torque = band.apply(rows)[stretch.kept]
    for step, left in ((1e-5, 0.05), (0.0, 1.0)):
        steps = {"link": np.full(MODEL.n, step), "motor": np.zeros(1)}
        removed = FreeTorques.of(
            stretch, band, layout, steps, friction=False, standing=STANDING
        ).remove(torque)
        assert np.linalg.norm(removed) <= left * np.linalg.norm(torque)
        assert removed.any() or step
    np.testing.assert_array_equal(removed, torque)
