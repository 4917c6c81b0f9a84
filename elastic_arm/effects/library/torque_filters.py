"""Torque channels behind a delay or a first-order low pass: what they read beside the true torque.

The laws hold to first order in the time constant. Of slow lags that is not enough: to first order a
delay and a low pass are the same. Here the filter is applied to the whole recording.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from elastic_arm.arrays import Array
from elastic_arm.effects.arm_equations import ArmEquations
from elastic_arm.effects.regressor import MotionSignals

PADDING = 0.5  # s mirrored at both ends
AVERAGED = 1.0  # Hz, over which a power spectrum is averaged
# Times the noise: from there the noise of a torque no longer counts when a filter is undone; and
# what shows at all, as the power of noise, averaged, stays below. Conventions.
CLEAR = 100.0
VISIBLE = 3.0
CHANNELS = {"joint_torque": "tau_J", "motor_torque": "tau_m"}


class FilteredTorques(ABC):
    """Errors of filtered torque channels in the residuals; subclasses have the filter."""

    def __init__(self, equations: ArmEquations) -> None:
        self.equations = equations

    @property
    def acts(self) -> bool:
        """True: every arm may have such sensors."""
        return True

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return recorded less true torque in link, drive and motor residuals, (N, 3 n)."""
        n = self.equations.robot.n
        joints = list(values["joints"])
        link = np.zeros((len(signals.t), n))
        drive = np.zeros((len(signals.t), n))
        motor = np.zeros((len(signals.t), n))
        for channel in (c for c in values["channels"] if c in CHANNELS):
            error = self._error(signals, CHANNELS[channel], joints, values)
            if channel == "motor_torque":
                motor[:, joints] += error
            else:
                link[:, joints] += error
                drive[:, joints] += error
                motor[:, joints] -= error
        return np.hstack([link, drive, motor])

    @abstractmethod
    def _error(
        self, signals: MotionSignals, name: str, joints: list[int], values: Mapping[str, Any]
    ) -> Array:
        """Return the recorded minus the true torque (N, k), Nm, of a channel at some joints.

        The torque of the signals is the true one if it is the model's, else the recorded one.
        """


class DelayedTorques(FilteredTorques):
    """Torques that come `delay` late, and link encoders, whose delay stays of first order."""

    def residuals(self, signals: MotionSignals, values: Mapping[str, Any]) -> Array:
        """Return recorded less true torque in link, drive and motor residuals, (N, 3 n)."""
        found = super().residuals(signals, values)
        if "link_encoder" in values["channels"]:
            equations = self.equations
            n = self.equations.robot.n
            gears = [joint.transmission for joint in equations.robot.joints]
            K = np.array([gear.stiffness if gear else 0.0 for gear in gears])
            D = np.array([gear.damping if gear else 0.0 for gear in gears])
            v = signals.values
            wound = K * v["dx"][:, :n] + D * v["ddx"][:, :n]
            for j in values["joints"]:
                found[:, j] += values["delay"] * v["dtau_J"][:, j]
                found[:, n + j] -= values["delay"] * wound[:, j]
        return found

    def _error(
        self, signals: MotionSignals, name: str, joints: list[int], values: Mapping[str, Any]
    ) -> Array:
        """Return recorded less true torque (N, k): of the recorded one, the true torque is what
        comes a delay later."""
        t = signals.t
        torque = signals.values[name]
        delay = float(values["delay"])
        by = -delay if signals.predicted else delay
        splines = [
            signals.once(
                f"spline of {name} {j}", partial(scipy.interpolate.CubicSpline, t, torque[:, [j]])
            )
            for j in joints
        ]
        at = np.hstack([_at(t, spline, by) for spline in splines])
        torque = torque[:, joints]
        return np.asarray(at - torque if signals.predicted else torque - at)


class LowPassedTorques(FilteredTorques):
    """Torques behind a first-order low pass of `cutoff`."""

    def _error(
        self, signals: MotionSignals, name: str, joints: list[int], values: Mapping[str, Any]
    ) -> Array:
        """Return the error (N, k), Nm, by the recorded torque where it is clear of its noise.

        Undoing a low pass amplifies the noise of what was recorded; a delay does not. So above, as
        far as the torque shows at all, the model's torque takes its place. No further: to low-pass
        that would take the noise of its accelerations off the residual, which a filter on the
        torque does not.
        """
        t = signals.t
        cutoff = float(values["cutoff"])
        if signals.predicted:
            # Filtered, the noise of accelerations would leave the link's residual and enter those
            # of drive and motor.
            return low_pass_error(t, signals.model_torques[name][:, joints], cutoff)
        undone = signals.once(f"parts of {name} that are clear", lambda: _Undone.of(signals, name))
        # By y - x = -T y', as y + T y' = x with T = 1 / (2 pi cutoff).
        by_reading = -undone.rate[:, joints] / (2.0 * np.pi * cutoff)
        if undone.clear is None or undone.visible is None:
            return by_reading
        by_model = undone.visible(
            low_pass_error(t, signals.model_torques[name][:, joints], cutoff), joints
        )
        return by_reading + by_model - undone.clear(by_model, joints)


class Clear:
    """Keeps the frequencies up to the highest at which a recorded torque has more than a power."""

    def __init__(self, t: Array, torque: Array, least: Array) -> None:
        step = float(t[1] - t[0])
        self._count = min(len(t) - 1, round(PADDING / step))
        window = np.hanning(len(t))[:, None]
        transform = np.fft.rfft(window * (torque - torque.mean(axis=0)), axis=0)
        power = np.abs(transform) ** 2 / np.sum(window**2)
        width = max(3, round(AVERAGED * len(t) * step))
        power = scipy.ndimage.uniform_filter1d(power, width, axis=0, mode="nearest")
        f = np.fft.rfftfreq(len(t), step)[:, None]
        highest = np.max(np.where(power > least, f, 0.0), axis=0)
        # Zero phase, and so gradual that it does not ring.
        f = np.fft.rfftfreq(len(t) + 2 * self._count, step)[:, None]
        self._weight = 1.0 / (1.0 + (f / np.maximum(highest, 1e-9)) ** 8)

    def _spectrum(self, values: Array) -> NDArray[np.complexfloating]:
        ends = ((self._count, self._count), (0, 0))
        return np.fft.rfft(np.pad(values, ends, mode="reflect", reflect_type="odd"), axis=0)

    def __call__(self, values: Array, joints: Sequence[int]) -> Array:
        """Return values (N, k) at these frequencies alone, of some of the torques by number."""
        N = len(values)
        found = np.fft.irfft(
            self._spectrum(values) * self._weight[:, joints], N + 2 * self._count, axis=0
        )
        return found[self._count : self._count + N]


@dataclass(frozen=True)
class _Undone:
    """What undoing a low pass of a recorded torque takes, at any corner."""

    rate: Array  # (N, n) Nm/s of the recorded torque, where it is clear of its noise
    # clear, visible: keep the frequencies at which it is clear of its noise, and at which it shows;
    # None where no model's torque is there to take its place
    clear: Clear | None = None
    visible: Clear | None = None

    @staticmethod
    def of(signals: MotionSignals, name: str) -> _Undone:
        """Take them of a torque by name."""
        t = signals.t
        torque = signals.values[name]
        if name not in signals.model_torques:
            return _Undone(scipy.interpolate.CubicSpline(t, torque)(t, 1))
        noise = signals.torque_noise[name]
        clear = Clear(t, torque, CLEAR * noise)
        visible = Clear(t, torque, VISIBLE * noise)
        return _Undone(
            scipy.interpolate.CubicSpline(t, clear(torque, range(torque.shape[1])))(t, 1),
            clear,
            visible,
        )


def moved(t: Array, values: Array, by: float) -> Array:
    """Return values at other times; beyond the ends they go on at the last slope."""
    return _at(t, scipy.interpolate.CubicSpline(t, values), by)


def _at(t: Array, spline: scipy.interpolate.CubicSpline, by: float) -> Array:
    """Return what a spline through values at t (N,) has later, (N, k), as :func:`moved` does."""
    wanted = t + by
    inside = np.clip(wanted, t[0], t[-1])
    return spline(inside) + (wanted - inside)[:, None] * spline(inside, 1)


def low_pass_error(t: Array, torque: Array, cutoff: float) -> Array:
    """Return what a first-order low pass makes of a torque (N, k), less the torque."""
    T = 1.0 / (2.0 * np.pi * cutoff)
    step = float(t[1] - t[0])
    # By the trapezoidal rule, from the state that a steady change before the first sample leaves.
    gain = step / (2.0 * T + step)
    slope = (torque[1] - torque[0]) / step
    memory = (1.0 - gain) * torque[0] - T * slope
    keep = (2.0 * T - step) / (2.0 * T + step)
    passed, _ = scipy.signal.lfilter([gain, gain], [1.0, -keep], torque, axis=0, zi=memory[None])
    return passed - torque
