"""The effects of the contract as the hidden arm has them, written here apart from the catalogue.

Effects that change a number of the arm (a mass, a stiffness) act on its description; those that add a torque are
gathered in :class:`JointLaws`; those of the sensors act on what was simulated (:mod:`.instruments`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

SENSOR_EFFECTS = frozenset(
    {
        "motor_torque_gain",
        "joint_torque_gain",
        "motor_torque_offset",
        "joint_torque_offset",
        "encoder_offset",
        "encoder_eccentricity",
        "time_delay",
    }
)


@dataclass(frozen=True)
class Fault:
    """One effect on a hidden arm.

    Parameters
    ----------
    effect
        The id of the contract.
    joint
        Index of the joint, None for effects of the whole arm.
    side
        "motor" or "link" for friction that may sit on either.
    parameters
        Values by the contract's names, SI units.
    channels
        For `time_delay`: what is late.
    """

    effect: str
    joint: int | None
    parameters: Mapping[str, float] = field(default_factory=dict)
    side: str = "motor"
    channels: tuple[str, ...] = ()


def sign(w: np.ndarray, speed: np.ndarray | float) -> np.ndarray:
    """Sign of a velocity, smoothed below `speed` (rad/s), far below any motion of a recording."""
    return np.tanh(w / speed)


class JointLaws:
    """Torques of the active effects at all joints at once.

    Parameters
    ----------
    faults
        The active effects; those of sensors and of the arm's numbers are passed over.
    stiffness, damping
        K (Nm/rad) and D (Nm s/rad), (n,).
    r_hd, r_tot
        Ratios (n,).
    standstill
        Speed (rad/s) below which a joint counts as standing, (n,).
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        stiffness: np.ndarray,
        damping: np.ndarray,
        r_hd: np.ndarray,
        r_tot: np.ndarray,
        standstill: np.ndarray,
    ) -> None:
        self.K, self.D, self.standstill = stiffness, damping, standstill
        n = len(stiffness)
        self._friction: dict[str, list[tuple[str, int, Mapping[str, float]]]] = {"motor": [], "link": []}
        self._cubic = np.zeros(n)
        self._half_gap = np.zeros(n)
        self._hysteresis, self._width = np.zeros(n), np.ones(n)
        self._error, self._error_rate, self._error_phase = np.zeros(n), np.ones(n), np.zeros(n)
        self._ripple, self._ripple_rate, self._ripple_phase = np.zeros(n), np.ones(n), np.zeros(n)
        for fault in faults:
            i, p = fault.joint, fault.parameters
            if fault.effect.endswith("_friction") and i is not None:
                self._friction[fault.side].append((fault.effect, i, p))
            elif fault.effect == "nonlinear_stiffness":
                self._cubic[i] += p["cubic"]
            elif fault.effect == "backlash":
                self._half_gap[i] = p["half_gap"]
            elif fault.effect == "hysteresis":
                self._hysteresis[i], self._width[i] = p["torque"], p["width"]
            elif fault.effect == "transmission_error":
                self._error[i], self._error_phase[i] = p["amplitude"], p["phase"]
                self._error_rate[i] = p["order"] * r_hd[i]
            elif fault.effect == "torque_ripple":
                self._ripple[i], self._ripple_phase[i] = p["amplitude"], p["phase"]
                self._ripple_rate[i] = p["order"] * r_tot[i]
        self.has_state = bool(self._hysteresis.any())
        self._plain_spring = not (self._cubic.any() or self._half_gap.any() or self.has_state or self._error.any())
        self._has_ripple = bool(self._ripple.any())

    def joint_torque(
        self, q: np.ndarray, theta: np.ndarray, dq: np.ndarray, dtheta: np.ndarray, z: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | float, np.ndarray]:
        """Return tau_J, its lever on the motor (1 + de/dtheta), and the rate of the hysteresis state, each (n,)."""
        if self._plain_spring:
            return self.K * (theta - q) + self.D * (dtheta - dq), 1.0, z
        angle = self._error_rate * theta + self._error_phase
        slope = self._error * self._error_rate * np.cos(angle)
        d = theta + self._error * np.sin(angle) - q
        rate = dtheta * (1.0 + slope) - dq
        spring = self.K * np.sign(d) * np.maximum(np.abs(d) - self._half_gap, 0.0)
        tau_J = spring + self._cubic * d**3 + self._hysteresis * z + self.D * rate
        dz = (rate - 0.5 * np.abs(rate) * z - 0.5 * rate * np.abs(z)) / self._width
        return tau_J, 1.0 + slope, dz

    def friction(self, side: str, w: np.ndarray, tau_J: np.ndarray) -> np.ndarray:
        """Return the torque (n,) that resists the motion w of the motor or the link side."""
        torque = np.zeros(len(w))
        for effect, i, p in self._friction[side]:
            direction = sign(w[i], self.standstill[i])
            if effect == "viscous_friction":
                torque[i] += p["coefficient"] * w[i]
            elif effect == "coulomb_friction":
                torque[i] += p["torque"] * direction
            elif effect == "stribeck_friction":
                torque[i] += p["torque"] * np.exp(-((w[i] / p["speed"]) ** 2)) * direction
            else:
                torque[i] += p["coefficient"] * abs(tau_J[i]) * direction
        return torque

    def ripple(self, theta: np.ndarray) -> np.ndarray | float:
        """Return the torque (n,) that the motors add beside tau_m."""
        return self._ripple * np.sin(self._ripple_rate * theta + self._ripple_phase) if self._has_ripple else 0.0
