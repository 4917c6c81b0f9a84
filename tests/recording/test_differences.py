"""Two recordings of the same commands, without a model."""

from dataclasses import replace

import numpy as np
import pytest

from elastic_arm.errors import RecordingError
from elastic_arm.recording import Recording, Side
from elastic_arm.recording.inspection.differences import differences

RATE = 500.0


def recording(
    begin: float, end: float, *, start_ns: int = 0, offset: float = 0.0, late: float = 0.0
) -> Recording:
    """Two joints on a motion that is a function of time; the torque of the second is `offset` more,
    all are `late`."""
    t = np.arange(begin, end, 1.0 / RATE)
    true = t - late
    q = np.stack(
        [
            np.sin(1.3 * true) + 0.4 * np.sin(3.1 * true),
            np.cos(0.9 * true) + 0.2 * np.sin(4.0 * true),
        ],
        axis=1,
    )
    stamps = start_ns + np.round((t - begin) * 1e9).astype(np.int64)
    return Recording(("a", "b"), motor=Side(stamps, position=q, effort=10.0 * q + [0.0, offset]))


def test_recordings_that_begin_at_different_times_are_brought_to_cover() -> None:
    """Another clock and another begin are found from the motion; what remains is the difference of
    the torques."""
    found = differences(recording(2.0, 18.0, offset=0.7), recording(0.0, 20.0, start_ns=10**18))
    assert found.offset == pytest.approx(2.0, abs=1e-6)
    theta, tau = found.channels
    assert (theta.channel, tau.channel) == ("theta", "tau_m")
    assert theta.rms.max() < 1e-6
    np.testing.assert_allclose(tau.mean, [0.0, 0.7], atol=1e-4)
    np.testing.assert_allclose(tau.rms, [0.0, 0.7], atol=1e-4)


def test_a_channel_that_is_late_has_its_lag() -> None:
    """A torque 3 ms later than the motion is named with its lag, where the reference tells the
    time."""
    real = recording(0.0, 12.0)
    simulated = recording(0.0, 12.0)
    assert real.motor is not None and simulated.motor is not None
    late = recording(0.0, 12.0, late=0.003).motor
    real = replace(real, motor=replace(real.motor, effort=late.effort))
    tau = differences(real, simulated).channels[1]
    np.testing.assert_allclose(tau.lag, 0.003, rtol=0.02)


def test_other_commands_are_refused() -> None:
    """Two motions that have nothing to do with each other are no pair."""
    real = recording(0.0, 12.0)
    t = np.arange(0.0, 12.0, 1.0 / RATE)
    other = np.stack([np.sin(17.0 * t), np.sin(23.0 * t)], axis=1)
    simulated = Recording(
        ("a", "b"), motor=Side(np.round(t * 1e9).astype(np.int64), position=other, effort=other)
    )
    with pytest.raises(RecordingError, match="contain different motions"):
        differences(real, simulated)
