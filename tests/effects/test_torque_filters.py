"""Delays and low passes of torque channels, applied to whole recordings."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter, lfilter_zi

from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.library.torque_filters import DelayedTorques, LowPassedTorques
from elastic_arm.effects.regressor import Once
from elastic_arm.robot import load_robot

ROBOT = load_robot(None)
T = np.arange(8000) / 1000.0
INSIDE = slice(500, -500)
NOISE = 0.26  # Nm


def true_torque(t):
    """A slow motion, and a drive that swings."""
    return 80 * np.sin(2.1 * t) + 30 * np.cos(5.3 * t + 0.4) + 3 * np.sin(75 * t)


def late(delay):
    """What a channel reads that comes late."""
    return true_torque(T - delay)


def low_passed(cutoff):
    """What a channel reads behind a first-order low pass."""
    b, a = bilinear([1.0], [1.0 / (2 * np.pi * cutoff), 1.0], 1000.0)
    x = true_torque(T)
    return lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0]


FILTERS = {
    "time_delay": (DelayedTorques, {"delay": 0.02}, late(0.02)),
    "torque_lowpass": (LowPassedTorques, {"cutoff": 5.0}, low_passed(5.0)),
}


@dataclass(frozen=True)
class Signals:
    """Torques of joint 2; the others carry none."""

    torque: np.ndarray
    predicted: bool
    t: np.ndarray = field(default_factory=lambda: T)
    cutoff: float = np.inf
    torque_noise: dict = field(
        default_factory=lambda: dict.fromkeys(("tau_J", "tau_m"), np.full(3, NOISE**2))
    )
    once: Once = field(default_factory=Once)

    @property
    def values(self):
        return {name: np.stack([0 * T, self.torque, 0 * T], axis=1) for name in ("tau_J", "tau_m")}

    @property
    def model_torques(self):
        return {
            name: np.stack([0 * T, true_torque(T), 0 * T], axis=1) for name in ("tau_J", "tau_m")
        }


def error_of(effect, signals, channels=("joint_torque",)):
    kind, values, _ = FILTERS[effect]
    return kind(ArmEquations(ROBOT)).residuals(
        signals, {**values, "channels": channels, "joints": [1]}
    )


@pytest.mark.parametrize("predicted", [False, True])
@pytest.mark.parametrize("effect", sorted(FILTERS))
def test_the_error_is_recorded_less_true_torque(effect, predicted):
    """By a torque without noise, recorded or the model's: a lag of 20 ms and a corner of 5 Hz, to 1
    % of the error."""
    recorded = FILTERS[effect][2]
    exact = {"tau_J": np.full(3, 1e-12)}
    found = error_of(
        effect, Signals(true_torque(T) if predicted else recorded, predicted, torque_noise=exact)
    )[INSIDE]
    expected = (recorded - true_torque(T))[INSIDE]
    assert np.abs(found[:, 1] - expected).max() < 0.01 * np.abs(expected).max()
    # tau_J stands in link and drive with one sign, in the motor's equation with the other.
    assert np.array_equal(found[:, 4], found[:, 1]) and np.array_equal(found[:, 7], -found[:, 1])
    assert not found[:, [0, 2, 3, 5, 6, 8]].any()


@pytest.mark.parametrize("effect", sorted(FILTERS))
def test_a_motor_torque_shows_in_its_own_equation_alone(effect):
    """Link and drive hold no motor torque."""
    found = error_of(effect, Signals(true_torque(T), True), ("motor_torque",))
    assert found[:, 7].any() and not found[:, :6].any()


def test_noise_of_a_low_passed_torque_is_hardly_amplified():
    """Less the error, a noisy torque has up to 40 Hz less than half the noise of the same filter
    undone plainly."""
    noise = NOISE * np.random.default_rng(0).standard_normal(len(T))
    recorded = FILTERS["torque_lowpass"][2] + noise

    def left(torque_noise):
        signals = Signals(recorded, False, torque_noise={"tau_J": np.full(3, torque_noise)})
        values = recorded - true_torque(T) - error_of("torque_lowpass", signals)[:, 1]
        slow = np.fft.rfftfreq(len(T), 1e-3) <= 40.0
        return np.fft.irfft(np.fft.rfft(values) * slow, len(T))[INSIDE].std()

    assert left(NOISE**2) < 0.5 * left(1e-12)
