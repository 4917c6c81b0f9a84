"""Torques that were low-passed before they were recorded: where the filter begins, and where nothing is left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy

from elastic_arm.recording import read_recording
from elastic_arm.recording.inspection.torque_spectrum import torque_spectra, torque_spectrum

RATE = 200.0
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def torque(seconds: float = 30.0) -> np.ndarray:
    """Return torques (N, 2) of slow motion with dry friction and white noise, Nm."""
    t, rng = np.arange(round(seconds * RATE)) / RATE, np.random.default_rng(7)
    slow = np.stack([20.0 * np.sin(1.3 * t), 5.0 * np.cos(2.1 * t)], axis=1)
    friction = 3.0 * np.sign(np.stack([np.cos(1.3 * t), -np.sin(2.1 * t)], axis=1))
    return slow + friction + rng.normal(0.0, 0.2, slow.shape)


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("corner", [2.0, 5.0])
def test_the_knee_is_where_the_filter_begins(order: int, corner: float) -> None:
    """A zero-phase Butterworth filter of 2 or 5 Hz is found to a third of its corner, and nothing is left far above."""
    sections = scipy.signal.butter(order, corner, fs=RATE, output="sos")
    found = torque_spectrum(scipy.signal.sosfiltfilt(sections, torque(), axis=0), RATE)
    assert found.low_passed.all() and not found.computed.any()
    np.testing.assert_allclose(found.knee, corner, rtol=0.35)
    assert np.all(found.end > found.knee)


def test_a_torque_with_noise_has_no_knee() -> None:
    """White noise of a sensor, however small, is no low pass."""
    found = torque_spectrum(torque(), RATE)
    assert not found.low_passed.any() and np.isinf(found.knee).all() and np.isinf(found.end).all()


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the recordings of real robots")
def test_the_low_pass_of_a_real_robot_is_found() -> None:
    """The UR10's currents were low-passed at 2 Hz, as its recording's source states."""
    (found,) = torque_spectra(read_recording(SHARED / "ur10" / "ur10_exciting_trajectory.db3")).values()
    assert np.median(found.knee) == pytest.approx(2.0, rel=0.15)
    assert 1.0 < found.band < np.median(found.knee)
