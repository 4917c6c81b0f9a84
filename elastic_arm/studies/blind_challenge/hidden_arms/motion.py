"""Motions of hidden arms: sums of sines, motion from point to point, and the true channels."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from elastic_arm.arrays import Array

HARMONICS = 8
SPEED = 1.0  # rad/s
ACCELERATION = 3.0  # rad/s²
REACH = 1.2  # rad from zero
RAMP = 1.0  # s, from rest to full motion
DWELL = (0.2, 1.0)  # s, at a point
WAY = 0.8  # rad, from point to point at most
# Largest rate and second rate of a step from 0 to 1 in unit time.
STEP_RATE = 2.1875
STEP_SECOND_RATE = 7.5132


@dataclass(frozen=True)
class TrueChannels:
    """What really happened, at the samples."""

    t: Array  # (N,) s
    # q, dq, theta, dtheta: (N, n) at the instant of the sample
    q: Array
    dq: Array
    theta: Array
    dtheta: Array
    # tau_J, tau_m: (N, n) means over the sample interval centred on it
    tau_J: Array
    tau_m: Array
    gravity: Array | None = None  # (N, n) what a controller that compensates gravity adds by itself


class HiddenMotion(Protocol):
    """A motion from rest to rest."""

    @property
    def duration(self) -> float:
        """Seconds."""

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return angles, velocities and accelerations at t (N,), each (N, n)."""


@dataclass(frozen=True)
class MultiSine:
    """q_d(t) = q0 + w(t) sum_k a_k sin(k omega t + p_k), w a smooth step up and down."""

    omega: float  # fundamental, rad/s
    # amplitude, phase: (n, H) rad
    amplitude: Array
    phase: Array
    centre: Array  # (n,) rad
    duration: float  # s

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q_d, its velocity and acceleration at t (N,), each (N, n)."""
        k = self.omega * np.arange(1, self.amplitude.shape[1] + 1)
        angle = k * t[:, None, None] + self.phase
        s0 = (self.amplitude * np.sin(angle)).sum(2)
        s1 = (self.amplitude * k * np.cos(angle)).sum(2)
        s2 = -(self.amplitude * k**2 * np.sin(angle)).sum(2)
        w, dw, ddw = (v[:, None] for v in _window(t, self.duration))
        return self.centre + w * s0, dw * s0 + w * s1, ddw * s0 + 2 * dw * s1 + w * s2


def _window(t: Array, duration: float) -> tuple[Array, Array, Array]:
    """Smooth step up from 0 and down to `duration`."""
    up = _step(t / RAMP)
    down = _step((duration - t) / RAMP)
    # The ramps do not overlap, so their product's derivatives have one term at a time.
    return up[0] * down[0], (up[1] - down[1]) / RAMP, (up[2] + down[2]) / RAMP**2


def _step(u: Array) -> tuple[Array, Array, Array]:
    """Step from 0 to 1 with zero velocity, acceleration and jerk at both ends, and its
    derivatives."""
    u = np.clip(u, 0.0, 1.0)
    value = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
    return value, 140 * u**3 * (1 - u) ** 3, 420 * u**2 * (1 - u) ** 2 * (1 - 2 * u)


@dataclass(frozen=True)
class PointToPoint:
    """All joints from one point to the next at once, with a dwell at each."""

    points: Array  # (P + 1, n) rad
    begins: Array  # (P,) s, of each way
    lasts: Array  # (P,) s, how long each way takes
    duration: float  # s

    def evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q_d, its velocity and acceleration at t (N,), each (N, n)."""
        way = np.clip(np.searchsorted(self.begins, t, side="right") - 1, 0, len(self.begins) - 1)
        last = self.lasts[way][:, None]
        value, rate, second = (v[:, None] for v in _step((t - self.begins[way]) / self.lasts[way]))
        far = self.points[way + 1] - self.points[way]
        return self.points[way] + value * far, rate * far / last, second * far / last**2


def random_points(rng: np.random.Generator, n: int, duration: float) -> PointToPoint:
    """Draw points within :data:`REACH` of zero, and ways between them.

    At :data:`SPEED`, :data:`ACCELERATION` or less.
    """
    points = [rng.uniform(-REACH, REACH, n)]
    t = RAMP
    begins: list[float] = []
    lasts: list[float] = []
    while True:
        there = np.clip(points[-1] + rng.uniform(-WAY, WAY, n), -REACH, REACH)
        far = np.abs(there - points[-1]).max()
        if far == 0.0:  # all joints at their bounds already: drawn anew
            continue
        points.append(there)
        last = max(
            STEP_RATE * far / SPEED, np.sqrt(STEP_SECOND_RATE * far / ACCELERATION)
        ) * rng.uniform(1.0, 1.5)
        if t + last > duration and begins:
            return PointToPoint(np.array(points[:-1]), np.array(begins), np.array(lasts), duration)
        begins.append(t)
        lasts.append(last)
        t += last + rng.uniform(*DWELL)


def random_motion(rng: np.random.Generator, n: int, duration: float) -> MultiSine:
    """Draw a motion within :data:`SPEED`, :data:`ACCELERATION` and :data:`REACH`.

    Harmonics reach up to about 1 Hz, and amplitudes fall with frequency so that speed, not
    position, is shared.
    """
    omega = 2 * np.pi / rng.uniform(7.0, 10.0)
    k = np.arange(1, HARMONICS + 1)
    amplitude = rng.uniform(0.3, 1.0, (n, HARMONICS)) / k
    phase = rng.uniform(-np.pi, np.pi, (n, HARMONICS))
    motion = MultiSine(omega, amplitude, phase, np.zeros(n), duration)
    q, dq, ddq = motion.evaluate(np.linspace(0.0, duration, 2000))
    peaks = np.stack(
        [
            np.abs(q).max(0) / (0.8 * REACH),
            np.abs(dq).max(0) / SPEED,
            np.abs(ddq).max(0) / ACCELERATION,
        ]
    )
    scale = rng.uniform(0.75, 1.0, n) / peaks.max(0)
    margin = REACH - scale * np.abs(q).max(0)
    return MultiSine(
        omega, amplitude * scale[:, None], phase, rng.uniform(-1, 1, n) * margin, duration
    )
