"""Kinds of sensor noise that are not white, put on the true channels of an arm."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from elastic_arm.recording import Recording, Side

Array = NDArray[np.float64]
Channels = dict[str, Array]
Noise = Callable[[Channels, Array, np.random.Generator], Channels]

TORQUE_STD = 0.26  # Nm, white
VELOCITY_STD = 1e-4  # rad/s, white
TORQUES, POSITIONS, VELOCITIES = ("tau_J", "tau_m"), ("q", "theta"), ("dq", "dtheta")


def white(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
    """White noise of torques and velocities, exact angles: what the laboratory level has."""
    stds = dict.fromkeys(TORQUES, TORQUE_STD) | dict.fromkeys(VELOCITIES, VELOCITY_STD)
    return {k: v + stds.get(k, 0.0) * rng.standard_normal(v.shape) for k, v in channels.items()}


def torque_noise(course: Callable[[tuple[int, ...], float, np.random.Generator], Array]) -> Noise:
    """Return white noise and a course of (shape, rate) besides on both torque channels, Nm."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        found, rate = white(channels, t, rng), 1.0 / float(t[1] - t[0])
        return found | {k: found[k] + course(found[k].shape, rate, rng) for k in TORQUES}

    return noisy


def random_walk(shape: tuple[int, ...], rate: float, rng: np.random.Generator) -> Array:
    """A zero that walks by 0.05 Nm in the root of a second."""
    return 0.05 * np.cumsum(rng.standard_normal(shape), axis=0) / np.sqrt(rate)


def pink(shape: tuple[int, ...], rate: float, rng: np.random.Generator) -> Array:
    """Noise of 0.26 Nm whose density falls with the frequency."""
    spectrum = np.fft.rfft(rng.standard_normal(shape), axis=0)
    spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1.0))[:, None]
    values = np.fft.irfft(spectrum, shape[0], axis=0)
    return TORQUE_STD * values / values.std(axis=0)


def first_order(seconds: float) -> Callable[[tuple[int, ...], float, np.random.Generator], Array]:
    """Return noise of 0.26 Nm that has passed a first-order low pass of this time constant."""

    def course(shape: tuple[int, ...], rate: float, rng: np.random.Generator) -> Array:
        keep = np.exp(-1.0 / (seconds * rate))
        drive = TORQUE_STD * np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
        return np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0))

    return course


def coarse_torque(step: float) -> Noise:
    """Return torques rounded to a step, Nm, with hardly any noise before."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        found = white(channels, t, rng)
        rounded = {
            k: np.round((channels[k] + 0.02 * rng.standard_normal(channels[k].shape)) / step) * step
            for k in TORQUES
        }
        return found | rounded

    return noisy


def encoder(
    std: float = 0.0, bits: tuple[float, float] | None = None, velocity: str = "measured"
) -> Noise:
    """Return angles with white noise (rad), rounded to bits of a turn, and velocities measured,
    differences or none."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        found = white(channels, t, rng)
        for k, name in enumerate(POSITIONS):
            angle = found[name] + std * rng.standard_normal(found[name].shape)
            step = 0.0 if bits is None else 2 * np.pi / 2.0 ** bits[k]
            found[name] = np.round(angle / step) * step if step else angle
            if velocity == "none":
                del found[VELOCITIES[k]]
            elif velocity == "differences":
                found[VELOCITIES[k]] = np.vstack(
                    [np.zeros((1, angle.shape[1])), np.diff(found[name], axis=0)]
                ) / (t[1] - t[0])
        return found

    return noisy


def jitter(std: float) -> Noise:
    """Return samples taken at other instants than their regular stamps state, by so many
    seconds."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        limit = 0.3 * (t[1] - t[0])
        taken = np.clip(t + np.clip(std * rng.standard_normal(len(t)), -limit, limit), t[0], t[-1])
        return white({k: CubicSpline(t, v)(taken) for k, v in channels.items()}, t, rng)

    return noisy


def low_pass(cutoff: float) -> Noise:
    """Return torques of which the noise has passed a first-order low pass, Hz: their own bandwidth
    is far higher."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        seconds = 1.0 / (2 * np.pi * cutoff)
        found, rate = white(channels, t, rng), 1.0 / float(t[1] - t[0])
        return found | {
            k: channels[k] + first_order(seconds)(channels[k].shape, rate, rng) for k in TORQUES
        }

    return noisy


def outliers(share: float) -> Noise:
    """Return white noise with a share of torque and angle samples far off."""

    def noisy(channels: Channels, t: Array, rng: np.random.Generator) -> Channels:
        found = white(channels, t, rng)
        for name, size in (*((k, 20.0) for k in TORQUES), *((k, 1e-2) for k in POSITIONS)):
            hit = rng.random(found[name].shape) < share
            found[name] = found[name] + hit * size * rng.standard_normal(hit.shape)
        return found

    return noisy


KINDS: Mapping[str, Noise] = {
    "white": white,
    "random_walk": torque_noise(random_walk),
    "pink": torque_noise(pink),
    "first_order_10ms": torque_noise(first_order(0.01)),
    "first_order_100ms": torque_noise(first_order(0.1)),
    "low_pass_20Hz": low_pass(20.0),
    "torque_step": coarse_torque(0.5),
    "encoder_16_bit": encoder(bits=(16, 16), velocity="none"),
    "encoder_19_13_bit": encoder(bits=(19, 13 + np.log2(101)), velocity="none"),
    "encoder_1e-5": encoder(std=1e-5),
    "differences": encoder(bits=(19, 13 + np.log2(101)), velocity="differences"),
    "jitter": jitter(2e-5),
    "outliers": outliers(3e-4),
    "dropped": white,
}


def recording(
    kind: str, t: Array, channels: Channels, rng: np.random.Generator, source: str = "run"
) -> Recording:
    """Return the recording of true channels with a kind of noise."""
    read = KINDS[kind](dict(channels), t, rng)
    kept = rng.random(len(t)) > (0.003 if kind == "dropped" else 0.0)
    stamps = (np.round(t * 1e9).astype(np.int64) + 1_700_000_000_000_000_000)[kept]
    part = {k: v[kept] for k, v in read.items()}
    joints = tuple(f"joint_{i + 1}" for i in range(channels["q"].shape[1]))
    sides = [
        Side(stamps, part[p], part.get(v), part[tau])
        for p, v, tau in zip(POSITIONS, VELOCITIES, TORQUES, strict=True)
    ]
    return replace(Recording(joints, link=sides[0], motor=sides[1]), source=source)
