"""What a joint's friction may be while it sticks is removed from residuals and columns, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from elastic_arm.dynamics import build_model
from elastic_arm.estimation.band import Band
from elastic_arm.estimation.equations import EquationSet
from elastic_arm.estimation.observation import observe
from elastic_arm.estimation.residuals import Sticking, Stretch, residuals, stuck_rows
from elastic_arm.sensors import Sensors
from tests.helpers.gap_recordings import ROBOT, motions, record

MODEL = build_model(ROBOT, "mod3")
LAYOUT = EquationSet.direct(("theta", "tau_m"), MODEL.n)
STICKS = 1  # joint


@lru_cache(maxsize=1)
def setting() -> tuple[Band, Stretch, np.ndarray]:
    """Return a narrow band, a stretch in which one joint stands for 0.1 s every second, and where it stands (N,)."""
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
    changes = np.floor(t) + np.random.default_rng(1).uniform(0.0, 0.1, size=int(t[-1]) + 2)[np.floor(t).astype(int)]
    torque = in_band(np.sign(t - changes) * stands)
    left = Sticking.of(stretch, band, LAYOUT).remove(torque)
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(torque)


def test_other_joints_and_most_of_the_friction_are_kept() -> None:
    """Where leaving out instants would leave a tenth of them, rows of other joints are all kept, and friction shows."""
    band, stretch, _ = setting()
    rows = stuck_rows(stretch, band, LAYOUT)
    assert rows[:, STICKS].mean() > 0.9 and not np.delete(rows, STICKS, axis=1).any()
    sticking = Sticking.of(stretch, band, LAYOUT)
    others = np.random.default_rng(2).normal(size=(len(stretch.t), LAYOUT.rows))
    others[:, STICKS] = 0.0
    np.testing.assert_array_equal(sticking.remove(others), others)
    friction = in_band(np.sign(np.sin(2 * np.pi * 0.2 * stretch.quiet.t)))
    assert np.linalg.norm(sticking.remove(friction)) > 0.7 * np.linalg.norm(friction)
    assert 0.7 < sticking.share_left < 1.0


def test_columns_are_treated_as_residuals_are() -> None:
    """What is removed of several columns at once is what is removed of each."""
    band, stretch, _ = setting()
    sticking = Sticking.of(stretch, band, LAYOUT)
    columns = np.random.default_rng(3).normal(size=(len(stretch.t), LAYOUT.rows, 4))
    together = sticking.remove(columns)
    for k in range(4):
        np.testing.assert_allclose(together[:, :, k], sticking.remove(columns[:, :, k]), atol=1e-12)
