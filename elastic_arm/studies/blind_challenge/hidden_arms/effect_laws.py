"""The effects of the contract in a hidden arm, implemented independently of the catalogue.

Effects that change a number of the arm (a mass, a stiffness) act on its description. Effects that
add a torque are implemented here, for all joints at once. Those of the sensors act on the simulated
channels (:mod:`.sensor_models`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array

SENSOR_EFFECTS = frozenset({
    "motor_torque_gain", "joint_torque_gain", "motor_torque_offset", "joint_torque_offset",
    "encoder_offset", "encoder_eccentricity", "time_delay", "torque_drift", "torque_lowpass",
    "sensor_crosstalk", "joint_zero", "gravity_compensation",
})  # fmt: skip
# Numbers of a joint that effects of the contract are, by their parameters.
_NAMES = {
    "viscous_friction": {"coefficient": "viscous_{side}"},
    "coulomb_friction": {"torque": "coulomb_{side}"},
    "stribeck_friction": {"torque": "stribeck_{side}", "speed": "stribeck_speed_{side}"},
    "load_dependent_friction": {"coefficient": "load_{side}"},
    "asymmetric_friction": {"asymmetry": "asymmetry_{side}"},
    "nonlinear_stiffness": {"cubic": "cubic"},
    "backlash": {"half_gap": "half_gap"},
    "hysteresis": {"torque": "hysteresis", "width": "width"},
    "transmission_error": {"amplitude": "error", "order": "error_rate", "phase": "error_phase"},
    "torque_ripple": {"amplitude": "ripple", "order": "ripple_rate", "phase": "ripple_phase"},
}
# Ids of all effects that this engine has; the suite's own simulator moves arms with others.
KNOWN = SENSOR_EFFECTS | set(_NAMES) | {
    "bearing_compliance", "payload", "load", "base_tilt", "link_inertia_mismatch",
    "rotor_inertia_mismatch", "stiffness_mismatch", "damping_mismatch", "spline_inertia",
    "inertia_coupling", "joint_spring", "thermal_friction",
}  # fmt: skip
FRICTION = ("viscous", "coulomb", "stribeck", "stribeck_speed", "load", "asymmetry")
# Numbers of a joint, in the order in which the laws take them; what is not there has its value of
# no effect.
NUMBERS = (
    *(f"{kind}_{side}" for side in ("link", "motor") for kind in FRICTION),
    *("stiffness", "damping", "standstill", "cubic", "half_gap", "hysteresis", "width"),
    *("error", "error_rate", "error_phase", "ripple", "ripple_rate", "ripple_phase", "armature"),
)
_NEUTRAL = {"stribeck_speed_link": 1.0, "stribeck_speed_motor": 1.0, "width": 1.0}


@dataclass(frozen=True)
class Fault:
    """One effect on a hidden arm."""

    effect: str  # the id of the contract
    joint: int | None  # index of the joint, None for effects of the whole arm
    # values by the contract's names, SI units
    parameters: Mapping[str, float] = field(default_factory=dict)
    side: str = "motor"  # "motor" or "link" for friction that may sit on either
    channels: tuple[str, ...] = ()  # for `time_delay`: what is late
    # What else is chosen, of effects that this engine does not have
    choices: Mapping[str, Any] = field(default_factory=dict)


def variation(effect: str, rng: np.random.Generator) -> dict[str, float]:
    """Draw what this engine may do in two ways where the law names one.

    Half of the heavier motors are heavier in B alone, which is the contract's law, half in S too,
    as masses are.
    """
    return {"coupled": float(rng.random() < 0.5)} if effect == "rotor_inertia_mismatch" else {}


def joint_numbers(faults: Sequence[Fault], n: int, r_hd: Array, r_tot: Array) -> dict[str, Array]:
    """Return the :data:`NUMBERS` (n,) of joints with these effects.

    Stiffness, damping, standstill and armature are left 0.
    """
    found = {name: np.full(n, _NEUTRAL.get(name, 0.0)) for name in NUMBERS}
    for fault in faults:
        for name, number in _NAMES.get(fault.effect, {}).items():
            found[number.format(side=fault.side)][fault.joint] = fault.parameters[name]
    # Orders count waves over a turn of the wave generator, and of the rotor.
    found["error_rate"] *= r_hd
    found["ripple_rate"] *= r_tot
    return found


def joint_torque(
    s: Mapping[str, Any], q: Any, theta: Any, dq: Any, dtheta: Any, z: Any
) -> tuple[Any, Any, Any]:
    """Return tau_J, its lever on the motor, and the rate of hysteresis, each (n,).

    The lever is 1 + de/dtheta.
    """
    angle = s["error_rate"] * theta + s["error_phase"]
    slope = s["error"] * s["error_rate"] * ca.cos(angle)
    d = theta + s["error"] * ca.sin(angle) - q
    rate = dtheta * (1.0 + slope) - dq
    spring = s["stiffness"] * ca.sign(d) * ca.fmax(ca.fabs(d) - s["half_gap"], 0.0)
    tau_J = spring + s["cubic"] * d**3 + s["hysteresis"] * z + s["damping"] * rate
    dz = (rate - 0.5 * ca.fabs(rate) * z - 0.5 * rate * ca.fabs(z)) / s["width"]
    return tau_J, 1.0 + slope, dz


def friction(s: Mapping[str, Any], side: str, w: Any, tau_J: Any) -> Any:
    """Return the torque (n,) that resists the motion w of the motor or the link side.

    The sign of a velocity is smoothed below `standstill`, far below any motion of a recording.
    """
    dry = s[f"coulomb_{side}"] + s[f"load_{side}"] * ca.fabs(tau_J)
    dry += s[f"stribeck_{side}"] * ca.exp(-((w / s[f"stribeck_speed_{side}"]) ** 2))
    sign = ca.tanh(w / s["standstill"])
    return (s[f"viscous_{side}"] * w + dry * sign) * (1.0 + s[f"asymmetry_{side}"] * sign)


def ripple(s: Mapping[str, Any], theta: Any) -> Any:
    """Return the torque (n,) that the motors add beside tau_m."""
    return s["ripple"] * ca.sin(s["ripple_rate"] * theta + s["ripple_phase"])
