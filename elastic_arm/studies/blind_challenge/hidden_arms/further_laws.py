"""Further effects of a hidden arm: effects beyond the first catalogue, and effects outside it.

They need states of their own: a clock, and one state per joint for relaxation. An arm without them
uses the smaller set of equations.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from elastic_arm.arrays import Array
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault

# Effects of the contract that need the larger set of equations.
FURTHER = frozenset({"joint_spring", "thermal_friction"})
# Effects that no catalogue has, by the parameters that size them. `sensor_crosstalk` acts in the
# sensors.
FOREIGN = {
    "dress_pack": "stiffness",
    "periodic_disturbance": "torque",
    "loose_payload": "torque",
    "cogging_cable": "torque",
    "saturating_drive": "depth",
    "gear_creep": "stiffness",
    "worn_zone": "torque",
    "oil_drag": "coefficient",
    "dragging_brake": "torque",
    "sensor_crosstalk": "share",
}
# Numbers of a joint with their values of no effect.
NEUTRAL = {
    "spring": 0.0, "spring_rest": 0.0, "thermal_link": 0.0, "thermal_motor": 0.0, "duration": 1.0,
    "pack": 0.0, "pack_rest": 0.0, "pack_slack": 0.0, "periodic": 0.0, "periodic_rate": 1.0,
    "periodic_phase": 0.0, "loose": 0.0, "loose_phase": 0.0, "relaxation": 1.0, "cable": 0.0,
    "cable_rate": 1.0, "cable_phase": 0.0, "limit": 1e12, "creep": 0.0, "worn": 0.0,
    "worn_place": 0.0, "worn_width": 1.0, "drag": 0.0, "brake": 0.0, "brake_on": 0.0,
    "brake_off": 1.0,
}  # fmt: skip
_NAMES = {
    "joint_spring": {"stiffness": "spring", "rest": "spring_rest"},
    "dress_pack": {"stiffness": "pack", "rest": "pack_rest", "slack": "pack_slack"},
    "periodic_disturbance": {
        "torque": "periodic",
        "rate": "periodic_rate",
        "phase": "periodic_phase",
    },
    "loose_payload": {"torque": "loose", "phase": "loose_phase", "relaxation": "relaxation"},
    "cogging_cable": {"torque": "cable", "rate": "cable_rate", "phase": "cable_phase"},
    "saturating_drive": {"limit": "limit"},
    "gear_creep": {"stiffness": "creep", "relaxation": "relaxation"},
    "worn_zone": {"torque": "worn", "place": "worn_place", "width": "worn_width"},
    "oil_drag": {"coefficient": "drag"},
    "dragging_brake": {"torque": "brake", "on": "brake_on", "off": "brake_off"},
}
GATE = 0.05  # s in which a brake closes


def needs_further_laws(faults: Sequence[Fault]) -> bool:
    """Whether an arm with these effects is moved by the larger set of equations."""
    return any(fault.effect in FURTHER or fault.effect in FOREIGN for fault in faults)


def further_numbers(faults: Sequence[Fault], n: int, duration: float) -> dict[str, Array]:
    """Return the numbers (n,) by name, of joints with these effects."""
    found = {name: np.full(n, value) for name, value in NEUTRAL.items()}
    found["duration"][:] = duration
    for fault in faults:
        at = slice(None) if fault.joint is None else fault.joint
        if fault.effect == "thermal_friction":
            found[f"thermal_{fault.side}"][at] = fault.parameters["change"]
        for name, number in _NAMES.get(fault.effect, {}).items():
            found[number][at] = fault.parameters[name]
    return found


def link_torque(s: Mapping[str, Any], q: Any, relaxed: Any, clock: Any) -> Any:
    """Return the torque (n,) on links of springs, cables, disturbances and loose loads."""
    wound = q - s["pack_rest"]
    beyond = ca.fmax(ca.fabs(wound) - s["pack_slack"], 0.0)
    torque = -s["spring"] * (q - s["spring_rest"]) - s["pack"] * ca.sign(wound) * beyond**2
    torque += s["periodic"] * ca.sin(s["periodic_rate"] * clock + s["periodic_phase"])
    torque -= s["cable"] * ca.tanh(4.0 * ca.sin(s["cable_rate"] * q + s["cable_phase"]))
    return torque - s["loose"] * relaxed


def motor_torque(s: Mapping[str, Any], q: Any, dtheta: Any, standstill: Any, clock: Any) -> Any:
    """Return the torque (n,) on the motors: worn teeth, oil, a brake that drags for a while."""
    sign = ca.tanh(dtheta / standstill)
    worn = s["worn"] * ca.exp(-(((q - s["worn_place"]) / s["worn_width"]) ** 2))
    gate = 0.5 * (
        ca.tanh((clock - s["brake_on"]) / GATE) - ca.tanh((clock - s["brake_off"]) / GATE)
    )
    return -(worn + s["brake"] * gate) * sign - s["drag"] * dtheta * ca.fabs(dtheta)


def delivered(s: Mapping[str, Any], u: Any) -> Any:
    """Return what drives deliver (n,) of the torques that they report."""
    return ca.fmin(ca.fmax(u, -s["limit"]), s["limit"])


def warmth(s: Mapping[str, Any], side: str, clock: Any) -> Any:
    """Return the factor (n,) of a side's friction: linear in time, 1 in the middle of the run."""
    return 1.0 + s[f"thermal_{side}"] * (clock / s["duration"] - 0.5)


def relaxation(s: Mapping[str, Any], q: Any, rate: Any, relaxed: Any) -> Any:
    """Return the rate (n,) of what relaxes.

    A load that slides to the lower side, or a gear that creeps.
    """
    creeps = ca.sign(s["creep"])
    slides = ca.sign(s["loose"])
    side = ca.tanh(ca.sin(q + s["loose_phase"]) / 0.1)
    return creeps * rate + (slides * side - relaxed) / s["relaxation"]
