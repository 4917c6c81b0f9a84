"""Sensors of ordinary quality: encoders with a few bits, coloured torque noise, and different rates
and sides.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import lfilter

from elastic_arm.arrays import Array, Mask
from elastic_arm.recording import Recording, Side
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault
from elastic_arm.studies.blind_challenge.hidden_arms.hidden_arm import RATE
from elastic_arm.studies.blind_challenge.hidden_arms.motion import TrueChannels
from elastic_arm.studies.blind_challenge.hidden_arms.sensor_models import SensorModel, measure

BOTH = "both"
MOTOR = "motor"
LINK = "link"
MISSING = "missing"
DIFFERENCED = "differenced"
MEASURED = "measured"
LONGEST_GAP = 8  # samples that are lost in a row
WHITE_SHARE = 0.3  # of the amplitude of a coloured noise that is white


@dataclass(frozen=True)
class RealisticSensors:
    """Quality of the sensors of one arm."""

    torque_noise: tuple[float, ...]  # standard deviation of each joint's torque channels (n,), Nm
    corner: float | None = (
        None  # Hz, of the first-order low-pass that colours the torque noise; None for white noise
    )
    # link_bits, motor_bits: of the encoders; the motor's sits before the gear
    link_bits: int = 19
    motor_bits: int = 13
    encoder_noise: float = 0.0  # rad, white, of both encoders behind the gear
    lost: float = 0.0  # share of the samples that never arrive, singly and several in a row
    velocity: str = (
        MISSING  # "missing", "differenced" (differences of the quantised angles) or "measured"
    )
    jitter: float = 2e-5  # standard deviation of the instants of sampling, s
    apart: bool = False  # whether the two sides are sampled at instants of their own
    rate: float = 1000.0  # samples a second, a divisor of 1000
    sides: str = BOTH  # "both", "motor" (theta and tau_m alone) or "link" (q and tau_J alone)
    # Standard deviation that a random walk reaches over the run, relative to the noise; about its
    # mean, it is how a torque channel's zero wanders
    drift: float = 0.0

    @property
    def link_step(self) -> float:
        """Resolution of the link encoders, rad."""
        return float(2 * np.pi / 2**self.link_bits)

    def motor_steps(self, ratios: Array) -> Array:
        """Return the resolution (n,) of the motor encoders behind their gears, rad."""
        return 2 * np.pi / 2**self.motor_bits / ratios


def measure_realistically(
    course: TrueChannels,
    joints: Sequence[str],
    faults: Sequence[Fault],
    sensors: RealisticSensors,
    ratios: Array,
    rng: np.random.Generator,
) -> Recording:
    """Return the recording that such sensors make of a course."""
    every = round(RATE / sensors.rate)
    ideal = SensorModel(
        torque_noise=0.0, velocity_noise=0.0, jitter=sensors.jitter, apart=sensors.apart
    )
    taken = _every(measure(course, joints, faults, ideal, rng), every)
    assert taken.link is not None and taken.motor is not None
    sides: dict[str, Side] = {}
    for name, side, step in (
        ("link", taken.link, sensors.link_step),
        ("motor", taken.motor, sensors.motor_steps(ratios)),
    ):
        assert side.position is not None and side.effort is not None
        position = side.position + sensors.encoder_noise * rng.standard_normal(side.position.shape)
        position = np.round(position / step) * step
        velocity = _velocity(side, position, sensors, rng)
        sides[name] = replace(
            side,
            position=position,
            velocity=velocity,
            effort=side.effort + _noise(sensors, len(position), rng),
        )
    if sensors.lost:
        arrived = {name: _arrived(len(side), sensors.lost, rng) for name, side in sides.items()}
        common = None if sensors.apart else arrived["link"]
        sides = {
            name: side.at(arrived[name] if common is None else common)
            for name, side in sides.items()
        }
    link = None if sensors.sides == MOTOR else sides["link"]
    motor = None if sensors.sides == LINK else sides["motor"]
    return replace(taken, link=link, motor=motor)


def _arrived(N: int, lost: float, rng: np.random.Generator) -> Mask:
    """Which of N samples arrive: gaps of one to :data:`LONGEST_GAP` samples begin anywhere but at
    the ends."""
    kept = np.ones(N, dtype=bool)
    for begin in np.flatnonzero(rng.random(N) < lost / (0.5 * (1 + LONGEST_GAP))):
        kept[begin : begin + int(rng.integers(1, LONGEST_GAP + 1))] = False
    kept[[0, -1]] = True
    return kept


def _every(recording: Recording, every: int) -> Recording:
    """Return each so manieth sample; torques are means over the interval between samples, centred
    on them."""
    if every == 1:
        return recording
    sides = {}
    for name, side in (("link", recording.link), ("motor", recording.motor)):
        assert side is not None and side.effort is not None
        kept = np.arange(every, len(side.effort) - every, every)
        # Where the interval ends within two samples, half of each belongs to it.
        share = np.ones(2 * (every // 2) + 1)
        share[[0, -1]] = 1.0 if every % 2 else 0.5
        mean = convolve1d(side.effort, share / every, axis=0)
        sides[name] = replace(side.at(kept), effort=mean[kept])
    return replace(recording, link=sides["link"], motor=sides["motor"])


def _velocity(
    side: Side, position: Array, sensors: RealisticSensors, rng: np.random.Generator
) -> Array | None:
    if sensors.velocity == MISSING or side.velocity is None:
        return None
    if sensors.velocity == DIFFERENCED:
        return (
            np.vstack([np.zeros((1, position.shape[1])), np.diff(position, axis=0)]) * sensors.rate
        )
    return side.velocity + 1e-4 * rng.standard_normal(side.velocity.shape)


def _noise(sensors: RealisticSensors, N: int, rng: np.random.Generator) -> Array:
    """Noise (N, n) of one side's torque channels: white or first order, and zeros that wander about
    their mean."""
    std = np.asarray(sensors.torque_noise)
    white = rng.standard_normal((N, len(std)))
    if sensors.corner is not None:
        decay = np.exp(-2 * np.pi * sensors.corner / sensors.rate)
        coloured = lfilter(
            [np.sqrt(1 - decay**2)], [1, -decay], rng.standard_normal((N + 500, len(std))), axis=0
        )[500:]
        white = WHITE_SHARE * white + np.sqrt(1 - WHITE_SHARE**2) * coloured
    walk = np.cumsum(rng.standard_normal((N, len(std))), axis=0) / np.sqrt(N)
    # An offset is the mean of a zero over a recording: what is left is how it wanders.
    return std * (white + sensors.drift * (walk - walk.mean(axis=0)))
