"""Random smooth motions for the hidden arms: sums of sines under a smooth start and stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HARMONICS = 8
RAMP = 1.0  # s, from rest to full motion


@dataclass(frozen=True)
class MultiSine:
    """q_d(t) = q0 + w(t) sum_k a_k sin(k omega t + p_k), w a smooth step up and down."""

    omega: float  # fundamental, rad/s
    # amplitude, phase: (n, H) rad
    amplitude: np.ndarray
    phase: np.ndarray
    centre: np.ndarray  # (n,) rad
    duration: float  # s

    def evaluate(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q_d, its velocity and acceleration at t (N,), each (N, n)."""
        k = self.omega * np.arange(1, self.amplitude.shape[1] + 1)
        angle = k * t[:, None, None] + self.phase
        s0 = (self.amplitude * np.sin(angle)).sum(2)
        s1 = (self.amplitude * k * np.cos(angle)).sum(2)
        s2 = -(self.amplitude * k**2 * np.sin(angle)).sum(2)
        w, dw, ddw = (v[:, None] for v in _window(t, self.duration))
        return self.centre + w * s0, dw * s0 + w * s1, ddw * s0 + 2 * dw * s1 + w * s2


def _window(t: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quintic-and-better step (zero velocity, acceleration and jerk at both ends) up from 0 and down to `duration`."""

    def step(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u = np.clip(u, 0.0, 1.0)
        value = u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)
        return value, 140 * u**3 * (1 - u) ** 3, 420 * u**2 * (1 - u) ** 2 * (1 - 2 * u)

    up, down = step(t / RAMP), step((duration - t) / RAMP)
    # The ramps do not overlap, so their product's derivatives have one term at a time.
    return up[0] * down[0], (up[1] - down[1]) / RAMP, (up[2] + down[2]) / RAMP**2


def random_motion(
    rng: np.random.Generator,
    n: int,
    duration: float,
    *,
    speed: float = 1.0,
    acceleration: float = 3.0,
    reach: float = 1.2,
) -> MultiSine:
    """Draw a motion whose peaks stay within `speed` (rad/s), `acceleration` (rad/s²) and `reach` (rad) of zero.

    Harmonics reach up to about 1 Hz, and amplitudes fall with frequency so that speed, not position, is shared.
    """
    omega = 2 * np.pi / rng.uniform(7.0, 10.0)
    k = np.arange(1, HARMONICS + 1)
    amplitude = rng.uniform(0.3, 1.0, (n, HARMONICS)) / k
    phase = rng.uniform(-np.pi, np.pi, (n, HARMONICS))
    motion = MultiSine(omega, amplitude, phase, np.zeros(n), duration)
    q, dq, ddq = motion.evaluate(np.linspace(0.0, duration, 2000))
    peaks = np.stack([np.abs(q).max(0) / (0.8 * reach), np.abs(dq).max(0) / speed, np.abs(ddq).max(0) / acceleration])
    scale = rng.uniform(0.75, 1.0, n) / peaks.max(0)
    margin = reach - scale * np.abs(q).max(0)
    return MultiSine(omega, amplitude * scale[:, None], phase, rng.uniform(-1, 1, n) * margin, duration)
