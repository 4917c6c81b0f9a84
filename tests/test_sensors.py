"""The sensors' layer: what is recorded of a known truth."""

import numpy as np
import pytest

from elastic_arm.errors import SensorError
from elastic_arm.sensors import Encoder, SensorBank, Sensors, TorqueSensor

RATE = 1000.0
N = 3
CHANNELS = ("q", "dq", "tau_J", "theta", "dtheta", "tau_m")


def smooth(t, seed=0):
    """A motion of a few harmonics below 20 Hz on every channel, (N, 3) each."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 6, (6, 3, 4))
    speeds = 2 * np.pi * np.array([0.3, 1.7, 6.0, 19.0])
    waves = np.sin(speeds * t[:, None, None, None] + phases[None]) @ np.array([1.0, 0.5, 0.2, 0.1])
    return {name: waves[:, k] for k, name in enumerate(CHANNELS)}


def read(sensors, true, seed=1):
    return SensorBank(sensors, N, RATE, np.random.default_rng(seed)).read(true)


@pytest.fixture(scope="module")
def t():
    return np.arange(4000) / RATE


def test_exact_sensors_record_the_truth(t):
    """Sensors.exact() changes no bit of any channel."""
    true = smooth(t)
    measured = read(Sensors.exact(), true)
    assert all(np.array_equal(measured[name], true[name]) for name in CHANNELS)


def test_default_noise_is_the_papers(t):
    """By default torques carry white zero-mean noise of 0.26 Nm, and encoders are exact."""
    true = smooth(t)
    measured = read(Sensors(), true)
    for name in ("tau_J", "tau_m"):
        noise = measured[name] - true[name]
        assert np.all(np.abs(noise.std(axis=0) / 0.26 - 1) < 5 / np.sqrt(2 * len(t)))
        assert np.all(np.abs(noise.mean(axis=0)) < 5 * 0.26 / np.sqrt(len(t)))
        lag_one = np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)
        assert np.all(np.abs(lag_one) < 5 / np.sqrt(len(t)))
    assert np.array_equal(measured["q"], true["q"])


def test_noise_of_channels_is_independent(t):
    """No two channels, joints included, share their noise."""
    measured = read(Sensors.real(), {name: np.zeros((len(t), N)) for name in CHANNELS})
    noise = np.hstack([measured[name] for name in ("dq", "tau_J", "dtheta", "tau_m")])
    correlation = np.corrcoef(noise.T) - np.eye(noise.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(len(t))


def test_gain_and_offset_follow_the_contract(t):
    """Recorded = gain x true + offset, joint by joint."""
    true = smooth(t)
    sensor = TorqueSensor(noise=0.0, gain=(1.0, 1.2, 0.9), offset=(0.5, 0.0, -2.0))
    measured = read(Sensors(joint_torque=sensor, motor_torque=TorqueSensor(noise=0.0)), true)
    assert np.allclose(
        measured["tau_J"], true["tau_J"] * [1.0, 1.2, 0.9] + [0.5, 0.0, -2.0], atol=1e-15
    )
    assert np.array_equal(measured["tau_m"], true["tau_m"])


def test_eccentric_encoder_adds_a_sine_of_its_angle(t):
    """Recorded = true + A sin(q + phi), and its velocity is the derivative of that."""
    true = smooth(t) | {"dq": np.gradient(smooth(t)["q"], t, axis=0, edge_order=2)}
    measured = read(Sensors(link_encoder=Encoder(eccentricity=1e-3, phase=0.4)), true)
    assert np.allclose(measured["q"], true["q"] + 1e-3 * np.sin(true["q"] + 0.4), atol=1e-15)
    slope = np.gradient(measured["q"] - true["q"], t, axis=0, edge_order=2)
    assert np.abs(measured["dq"] - true["dq"] - slope)[1:-1].max() < 1e-4


def test_quantised_angles_are_multiples_of_the_resolution(t):
    """An encoder reads whole steps and errs by half a step at most."""
    step = 2 * np.pi / 4096
    true = smooth(t)
    measured = read(Sensors(motor_encoder=Encoder(resolution=step)), true)["theta"]
    assert np.abs(measured / step - np.round(measured / step)).max() < 1e-9
    assert np.abs(measured - true["theta"]).max() <= step / 2 + 1e-12


@pytest.mark.parametrize("delay", [0.0003, 0.001, 0.0025, 0.0077, 0.02])
def test_delay_shifts_a_channel(t, delay):
    """A late channel holds the true value of `delay` before, at fractions of a sample too."""
    sensors = Sensors(
        joint_torque=TorqueSensor(noise=0.0, delay=delay), motor_torque=TorqueSensor(noise=0.0)
    )
    measured = read(sensors, smooth(t))
    settled = t > 0.1
    assert np.abs(measured["tau_J"] - smooth(t - delay)["tau_J"])[settled].max() < 1e-3
    assert np.array_equal(measured["tau_m"], smooth(t)["tau_m"])


def test_delay_of_whole_samples_is_exact(t):
    """Three milliseconds at 1 kHz are three samples, bit for bit."""
    true = smooth(t)
    late = read(Sensors(link_encoder=Encoder(delay=0.003)), true)["q"]
    assert np.array_equal(late[3:], true["q"][:-3])


def test_blocks_and_single_samples_give_the_same_bits(t):
    """Feeding samples one at a time changes nothing: noise, delay and rounding included."""
    true = {name: values[:200] for name, values in smooth(t).items()}
    encoder = Encoder(noise=1e-5, velocity_noise=1e-3, resolution=1e-6, delay=0.0013)
    sensors = Sensors(
        encoder, encoder, TorqueSensor(delay=0.0021), TorqueSensor(delay=(0.0, 0.001, 0.0049))
    )
    whole = read(sensors, true)
    bank = SensorBank(sensors, N, RATE, np.random.default_rng(1))
    parts = [
        bank.read({name: values[k : k + 1] for name, values in true.items()}) for k in range(200)
    ]
    for name in CHANNELS:
        assert np.array_equal(whole[name], np.concatenate([part[name] for part in parts]))


def test_jitter_keeps_stamps_in_order():
    """However large the jitter, stamps stay strictly increasing."""
    bank = SensorBank(Sensors(stamp_jitter=0.01), N, RATE, np.random.default_rng(0))
    assert np.diff(np.arange(5000) / RATE + bank.jitter(5000)).min() > 0


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: TorqueSensor(noise=-1.0), "noise"),
        (lambda: TorqueSensor(gain=0.0), "gain"),
        (lambda: Encoder(offset=float("nan")), "offset"),
        (lambda: Encoder(delay=-0.001), "delay"),
        (lambda: Sensors(stamp_jitter=-1.0), "stamp_jitter"),
        (
            lambda: read(
                Sensors(joint_torque=TorqueSensor(offset=(1.0, 2.0))), smooth(np.zeros(1))
            ),
            "offset",
        ),
    ],
)
def test_settings_without_sense_are_refused_by_name(make, word):
    """A wrong setting is named in the error."""
    with pytest.raises(SensorError, match=word):
        make()
