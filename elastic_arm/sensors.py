"""The sensors of an arm: noise, resolution, gain, offset, eccentricity, delay, jitter.

This layer works on arrays of samples and has no dynamics. A :class:`SensorBank` carries the memory
of the sensors, so that samples fed one at a time and samples fed at once give identical results.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np
import scipy  # its parts are loaded when they are used

from elastic_arm.arrays import Array
from elastic_arm.errors import SensorError

PerJoint = float | tuple[float, ...]

# Interpolation at a fraction of a sample is exact to about 3e-4 up to this share of the sample
# rate.
PASSBAND = 0.2
TAPS = 24
# Keeps the filter from amplifying what lies above the passband (to a few times, at most, for delays
# below a sample).
RIDGE = 1e-8
# Jitter beyond this share of the sample interval would put samples out of order.
LARGEST_JITTER = 0.45

_AT_LEAST_ZERO = {"noise", "velocity_noise", "resolution", "delay", "cutoff"}


class _Settings:
    """Values that hold for all joints (a number) or for each (a tuple), checked when made."""

    def __post_init__(self) -> None:
        for entry in fields(self):  # type: ignore[arg-type]
            given = getattr(self, entry.name)
            values = np.atleast_1d(np.asarray(given, dtype=float))
            if values.ndim != 1 or not np.isfinite(values).all():
                raise SensorError(
                    f"{entry.name} of a sensor is {given!r}",
                    "Give a finite number, or one per joint.",
                )
            if entry.name in _AT_LEAST_ZERO and (values < 0).any():
                raise SensorError(
                    f"{entry.name} of a sensor is negative: {given!r}",
                    "Give zero or a positive number.",
                )
            if entry.name == "gain" and (values == 0).any():
                raise SensorError("the gain of a sensor is zero", "Give the ratio recorded / true.")
            value = float(values[0]) if np.ndim(given) == 0 else tuple(float(v) for v in values)
            object.__setattr__(self, entry.name, value)

    def row(self, name: str, n: int) -> Array:
        """Return a setting as an array (n,), not to be written to."""
        return _row(self, name, n)

    def changed(self, joint: int, n: int, **settings: float) -> Any:
        """Return these settings with those of one joint (index) of `n` changed."""
        rows: dict[str, Any] = {}
        for name, value in settings.items():
            row = self.row(name, n).copy()
            row[joint] = value
            rows[name] = tuple(row)
        return replace(self, **rows)  # type: ignore[type-var]


@lru_cache(maxsize=256)
def _row(settings: _Settings, name: str, n: int) -> Array:
    """Spread a setting over the joints; kept, as it is needed at every sample."""
    values = np.atleast_1d(np.asarray(getattr(settings, name), dtype=float))
    if len(values) not in (1, n):
        raise SensorError(
            f"{name} of a sensor has {len(values)} values for {n} joints",
            "Give one, or one per joint.",
        )
    return np.broadcast_to(values, (n,))


@dataclass(frozen=True)
class TorqueSensor(_Settings):
    """A torque channel: gain * true(t - delay) + offset + drift * t + noise.

    Rounded to the resolution.
    """

    noise: PerJoint = 0.26  # standard deviation, Nm. The default is the paper's (section VII)
    resolution: PerJoint = 0.0  # step of the quantisation, Nm; zero for none
    # gain, offset, delay: recorded / true; Nm; s
    gain: PerJoint = 1.0
    offset: PerJoint = 0.0
    delay: PerJoint = 0.0
    drift: PerJoint = 0.0  # Nm/s, at which the zero moves from the first sample on
    cutoff: PerJoint = (
        0.0  # Hz, of a first-order low pass that the true torque goes through; zero for none
    )


@dataclass(frozen=True)
class Encoder(_Settings):
    """An encoder: true(t - delay) + offset + eccentricity sin(true + phase) + noise.

    Rounded.
    """

    # noise, velocity_noise: standard deviations, rad and rad/s. The velocity channel has noise of
    # its own
    noise: PerJoint = 0.0
    velocity_noise: PerJoint = 0.0
    resolution: PerJoint = 0.0  # step of the quantised angle, rad; zero for none
    # offset, eccentricity, phase, delay: rad, rad, rad, s
    offset: PerJoint = 0.0
    eccentricity: PerJoint = 0.0
    phase: PerJoint = 0.0
    delay: PerJoint = 0.0


@dataclass(frozen=True)
class Sensors:
    """The sensors of an arm; by default exact encoders and torques with noise of 0.26 Nm."""

    # link_encoder, motor_encoder: the two encoders of a joint
    link_encoder: Encoder = field(default_factory=Encoder)
    motor_encoder: Encoder = field(default_factory=Encoder)
    # joint_torque, motor_torque: the torque sensor at the harmonic-drive output, and the motor's
    # torque as its drive reports it
    joint_torque: TorqueSensor = field(default_factory=TorqueSensor)
    motor_torque: TorqueSensor = field(default_factory=TorqueSensor)
    stamp_jitter: float = 0.0  # standard deviation of the stamps against the true sampling times, s

    def __post_init__(self) -> None:
        if not (np.isfinite(self.stamp_jitter) and self.stamp_jitter >= 0):
            raise SensorError(
                f"stamp_jitter is {self.stamp_jitter!r}",
                "Give a standard deviation in seconds, or zero.",
            )

    @classmethod
    def exact(cls) -> Self:
        """Return sensors that record the truth."""
        return cls(joint_torque=TorqueSensor(noise=0.0), motor_torque=TorqueSensor(noise=0.0))

    @classmethod
    def real(cls) -> Self:
        """Return sensors as on a real arm.

        23-bit encoders with noise of a microradian, jittered stamps.
        """
        encoder = Encoder(noise=1e-6, velocity_noise=1e-4, resolution=2 * np.pi / 2**23)
        return cls(link_encoder=encoder, motor_encoder=encoder, stamp_jitter=2e-5)

    def changed(self, channel: str, joint: int, n: int, **settings: float) -> Self:
        """Return these sensors with settings of one channel and joint of `n` changed.

        Channels are `joint_torque`, …; joints are given by index.
        """
        return replace(self, **{channel: getattr(self, channel).changed(joint, n, **settings)})


class SensorBank:
    """Sensors at work: true samples in, measured samples out, in blocks of any length."""

    def __init__(self, sensors: Sensors, n: int, rate: float, rng: np.random.Generator) -> None:
        self.sensors = sensors
        self._rate = rate
        *own, self._jitter = rng.spawn(7)
        self._link = _encoder(sensors.link_encoder, n, rate, own[0], own[1])
        self._motor = _encoder(sensors.motor_encoder, n, rate, own[2], own[3])
        self._joint_torque = _torque(sensors.joint_torque, n, rate, own[4])
        self._motor_torque = _torque(sensors.motor_torque, n, rate, own[5])

    def read(self, true: Mapping[str, Array]) -> dict[str, Array]:
        """Return measured channels for true ones."""
        q, dq = self._link(true["q"], true["dq"])
        theta, dtheta = self._motor(true["theta"], true["dtheta"])
        tau_J = self._joint_torque(true["tau_J"])
        tau_m = self._motor_torque(true["tau_m"])
        return {"q": q, "dq": dq, "tau_J": tau_J, "theta": theta, "dtheta": dtheta, "tau_m": tau_m}

    def jitter(self, count: int) -> Array:
        """Return `count` errors of stamps, s, small enough to keep their order."""
        limit = LARGEST_JITTER / self._rate
        return np.clip(
            self._jitter.standard_normal(count) * self.sensors.stamp_jitter, -limit, limit
        )


# What a channel passes through: only stages that change something, as a live arm reads its sensors
# sample by sample.
Plant = Callable[[Array], Array]


def _through(stages: Sequence[Plant]) -> Plant:
    def run(values: Array) -> Array:
        for stage in stages:
            values = stage(values)
        return values

    return run


def _late(sensor: _Settings, n: int, rate: float) -> list[Plant]:
    delay = sensor.row("delay", n)
    return [DelayLine(delay, rate)] if delay.any() else []


def _noisy(std: Array, rng: np.random.Generator) -> list[Plant]:
    return [lambda values: values + rng.standard_normal(values.shape) * std] if std.any() else []


def _rounded(sensor: _Settings, n: int) -> list[Plant]:
    resolution = sensor.row("resolution", n)
    return [lambda values: quantised(values, resolution)] if resolution.any() else []


def _torque(sensor: TorqueSensor, n: int, rate: float, rng: np.random.Generator) -> Plant:
    gain = sensor.row("gain", n)
    offset = sensor.row("offset", n)
    scaled: list[Plant] = (
        [lambda values: gain * values + offset] if offset.any() or (gain != 1).any() else []
    )
    drift = sensor.row("drift", n)
    cutoff = sensor.row("cutoff", n)
    filtered: list[Plant] = [FirstOrderFilter(cutoff, rate)] if cutoff.any() else []
    moving: list[Plant] = [Drift(drift, rate)] if drift.any() else []
    noisy = _noisy(sensor.row("noise", n), rng)
    return _through(
        [*_late(sensor, n, rate), *filtered, *scaled, *moving, *noisy, *_rounded(sensor, n)]
    )


def _encoder(
    encoder: Encoder,
    n: int,
    rate: float,
    rng: np.random.Generator,
    rng_velocity: np.random.Generator,
) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Return the function of true angle and velocity."""
    amplitude = encoder.row("eccentricity", n)
    phase = encoder.row("phase", n)
    offset = encoder.row("offset", n)
    late = _through(_late(encoder, n, rate))
    late_velocity = _through(_late(encoder, n, rate))
    read = _through([*_noisy(encoder.row("noise", n), rng), *_rounded(encoder, n)])
    read_velocity = _through(_noisy(encoder.row("velocity_noise", n), rng_velocity))

    def run(angle: Array, velocity: Array) -> tuple[Array, Array]:
        angle = late(angle)
        velocity = late_velocity(velocity)
        if amplitude.any():
            velocity = velocity * (1.0 + amplitude * np.cos(angle + phase))
            angle = angle + amplitude * np.sin(angle + phase)
        return read(angle + offset if offset.any() else angle), read_velocity(velocity)

    return run


class Drift:
    """Moves the zero of each joint's channel at a rate of its own, from the first sample on."""

    def __init__(self, drift: Array, rate: float) -> None:
        self._step = drift / rate
        self._seen = 0

    def __call__(self, values: Array) -> Array:
        """Return `values` (N, n) with the zero moved on, continuing the block before."""
        at = self._seen + np.arange(len(values))[:, None]
        self._seen += len(values)
        return values + at * self._step


class FirstOrderFilter:
    """A first-order low pass of each joint's channel by the bilinear rule.

    At rest before the first sample.
    """

    def __init__(self, cutoff: Array, rate: float) -> None:
        self._on = cutoff > 0
        ratio = np.pi * cutoff / rate
        self._new = ratio / (1.0 + ratio)
        self._old = (1.0 - ratio) / (1.0 + ratio)
        self._memory: Array | None = None

    def __call__(self, values: Array) -> Array:
        """Return `values` (N, n), filtered, continuing the block before."""
        if self._memory is None:
            self._memory = (1.0 - self._new) * values[0]
        out = values.copy()
        for j in np.flatnonzero(self._on):
            new = self._new[j]
            memory = self._memory[j : j + 1]
            out[:, j], (self._memory[j],) = scipy.signal.lfilter(
                [new, new], [1.0, -self._old[j]], values[:, j], zi=memory
            )
        return out


class DelayLine:
    """Delays each joint's channel by its own time.

    The arm is taken to have been at rest before the first sample.
    """

    def __init__(self, delay: Array, rate: float) -> None:
        weights = [delay_filter(d * rate) for d in delay]
        self._length = max(len(w) for w in weights)
        self._weights = np.array([np.pad(w, (0, self._length - len(w))) for w in weights]).T
        self._past: Array | None = None

    def __call__(self, values: Array) -> Array:
        """Return `values` (N, n), delayed, continuing the block before."""
        if self._length == 1:
            return values.copy()
        memory = self._length - 1
        past = np.repeat(values[:1], memory, axis=0) if self._past is None else self._past
        extended = np.concatenate([past, values])
        self._past = extended[len(extended) - memory :]
        late = np.zeros_like(values)
        for lag, weight in enumerate(self._weights):
            if weight.any():
                late = late + weight * extended[memory - lag : len(extended) - lag]
        return late


def delay_filter(samples: float) -> Array:
    """Return the causal FIR filter that delays by `samples`, exact for a whole number.

    In between, the weights are those that come closest, in least squares over the passband, to
    exp(-i w samples): a band-limited interpolation that needs no sample of the future. They sum to
    one.
    """
    whole = round(samples)
    if abs(samples - whole) < 1e-9:
        return np.eye(whole + 1)[whole]
    first = max(0, int(np.floor(samples)) - TAPS // 2 + 1)
    lags = np.arange(first, first + TAPS) - samples
    # Normal equations of the integral over 0..passband: sinc of the differences of lags.
    edge = 2 * PASSBAND
    gram = np.sinc(edge * (lags[:, None] - lags[None, :])) + RIDGE * np.eye(TAPS)
    weights = np.linalg.solve(gram, np.sinc(edge * lags))
    return np.concatenate([np.zeros(first), weights / weights.sum()])


def quantised(values: Array, resolution: Array) -> Array:
    """Round `values` (N, n) to multiples of `resolution` (n,); zero leaves a column as it is."""
    step = np.where(resolution > 0, resolution, 1.0)
    return np.where(resolution > 0, np.round(values / step) * step, values)
