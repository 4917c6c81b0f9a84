"""Bearing compliance as a feature: tilts that the model holds at zero, estimated from the moments that press on them.

The law adds nothing to the residuals of the locked arm, as the tilts are coordinates of their own. What they do
follows in one step: the moments about the tilting axes move the tilts against the bearings' stiffness, damping and the
arm's own inertia, and the tilts enter the equations of link and motor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from elastic_arm.dynamics import Model, build_model
from elastic_arm.gap.features import Feature, Signals

Array = NDArray[np.float64]

POSES = 40
SMOOTH = 12.0  # Hz: above, the moments hold more of the encoders' noise, twice differentiated, than of motion
PADDING = 500  # samples mirrored at both ends, in which the tilts swing in


@dataclass(frozen=True, eq=False)
class Tilting(Feature):
    """The bearings of all joints, with `stiffness_scale` times the stiffness of the arm file."""

    @property
    def scalable(self) -> bool:
        """False: at each stiffness the size of the effect is known."""
        return False

    @property
    def acts(self) -> bool:
        """Whether the arm file describes bearings."""
        robot = self.equations.robot
        return all(joint.transmission is not None and joint.transmission.bearing for joint in robot.joints)

    def whole(self) -> Feature:
        """Return itself: its column is the law already."""
        return self

    @cached_property
    def _model(self) -> Model:
        return build_model(self.equations.robot, self.equations.model_name, bearings=True)

    @cached_property
    def _bearings(self) -> tuple[Array, Array]:
        gears = [joint.transmission for joint in self.equations.robot.joints]
        bearings = [gear.bearing for gear in gears if gear is not None and gear.bearing is not None]
        return np.array([b.stiffness for b in bearings * 2]), np.array([b.damping for b in bearings * 2])

    def columns(self, signals: Signals, searched: Sequence[float] = ()) -> Array:
        """Return what the tilts add to the residuals, (N, 3 n, 1)."""
        n = self.equations.robot.n
        v = signals.values
        none = np.zeros((len(signals.t), 2 * n))
        locked = [np.hstack([v[name], none]) for name in ("x", "dx", "ddx")]
        rest = self._model.inverse_dynamics(*locked)
        tilts = self._tilts(signals, -rest[:, 2 * n :], float(searched[0]))
        free = [np.hstack([v[name], tilt]) for name, tilt in zip(("x", "dx", "ddx"), tilts, strict=True)]
        change = self._model.inverse_dynamics(*free)[:, : 2 * n] - rest[:, : 2 * n]
        return np.concatenate([change[:, :n], none[:, :n], change[:, n:]], axis=1)[:, :, None]

    def _tilts(self, signals: Signals, moment: Array, scale: float) -> tuple[Array, Array, Array]:
        """Return the tilts (N, 2n) under moments, and their first and second derivatives."""
        n = self.equations.robot.n
        stiffness, damping = self._bearings
        poses = signals.values["x"][:: max(1, len(moment) // POSES)]
        inertia = self._model.mass_matrix(np.hstack([poses, np.zeros_like(poses)])).mean(axis=0)[2 * n :, 2 * n :]
        padded = np.pad(moment, ((PADDING, PADDING), (0, 0)), mode="reflect")
        f = np.fft.rfftfreq(len(padded), signals.t[1] - signals.t[0])
        s = 2j * np.pi * f[:, None, None]
        response = np.linalg.inv(np.diag(scale * stiffness) + s * np.diag(damping) + s**2 * inertia)
        pressing = np.fft.rfft(padded, axis=0) * np.exp(-0.5 * (f / SMOOTH) ** 2)[:, None]
        tilt = (response @ pressing[:, :, None])[:, :, 0]
        rate = s[:, :, 0]
        kept = slice(PADDING, PADDING + len(moment))
        derivatives = [np.fft.irfft(tilt * rate**k, len(padded), axis=0)[kept] for k in range(3)]
        return derivatives[0], derivatives[1], derivatives[2]
