"""Motions imposed at the rotors, divided into smooth pieces so that integration crosses no jump."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.excitation import FourierTrajectory

Evaluate = Callable[[Array], tuple[Array, Array, Array]]
"""Times (N,) to theta, dtheta, ddtheta (N, n)."""


@dataclass(frozen=True)
class SmoothPiece:
    """A stretch of time in which the motion is smooth."""

    start: float
    end: float
    evaluate: Evaluate


class ImposedMotion(Protocol):
    """A motion imposed at the rotors of the prototype."""

    @property
    def pieces(self) -> list[SmoothPiece]:
        """The smooth stretches, in order, each beginning where the one before ends."""


CUBIC = (0.0, 0.0, 3.0, -2.0)
"""Adams' STEP: its acceleration jumps at both ends to 6 height / rise^2."""

QUINTIC = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)
"""A step whose acceleration is continuous."""


@dataclass(frozen=True)
class StepRamp:
    """The paper's step ramp: all joints turn by `height` in `rise` seconds, then stand still."""

    start: Array  # theta before the ramp (n,), rad
    height: float = 0.1  # the step at the harmonic-drive output, rad
    rise: float = 1.0  # duration of the ramp, s
    hold: float = 0.5  # how long the arm then stands still, s
    # Coefficients, rising, of the polynomial from 0 to 1 over the unit interval; the paper's step
    # is the cubic
    shape: tuple[float, ...] = CUBIC

    @property
    def pieces(self) -> list[SmoothPiece]:
        """Standstill, so that the first sample is at rest, the ramp, and standstill."""
        end = self.rise + self.hold
        return [
            SmoothPiece(-0.01, 0.0, self._wait),
            SmoothPiece(0.0, self.rise, self._ramp),
            SmoothPiece(self.rise, end, self._stand),
        ]

    def _wait(self, t: Array) -> tuple[Array, Array, Array]:
        theta = np.broadcast_to(self.start, (len(t), len(self.start)))
        return theta, np.zeros_like(theta), np.zeros_like(theta)

    def _ramp(self, t: Array) -> tuple[Array, Array, Array]:
        u = np.asarray(t)[:, None] / self.rise
        scale = self.height * np.ones_like(self.start)
        shape = np.polynomial.Polynomial(self.shape)
        speed = shape.deriv(1)(u) / self.rise
        bend = shape.deriv(2)(u) / self.rise**2
        return self.start + scale * shape(u), scale * speed, scale * bend

    def _stand(self, t: Array) -> tuple[Array, Array, Array]:
        theta = np.broadcast_to(self.start + self.height, (len(t), len(self.start)))
        return theta, np.zeros_like(theta), np.zeros_like(theta)


@dataclass(frozen=True)
class PeriodicMotion:
    """A Fourier trajectory: its smooth start is driven, then a period is recorded.

    Recorded from t = 0 on.
    """

    trajectory: FourierTrajectory  # fourier series between two smooth ramps

    @property
    def pieces(self) -> list[SmoothPiece]:
        """The smooth start, where there is one, and one period."""
        ramp = self.trajectory.ramp
        period = self.trajectory.period
        recorded = SmoothPiece(0.0, period, self._evaluate)
        return [SmoothPiece(-ramp, 0.0, self._evaluate), recorded] if ramp > 0.0 else [recorded]

    def _evaluate(self, t: Array) -> tuple[Array, Array, Array]:
        return self.trajectory.evaluate(t + self.trajectory.ramp)
