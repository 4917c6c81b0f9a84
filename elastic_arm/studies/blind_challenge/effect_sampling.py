"""Effects as the challenge draws them: where, in which form, and how much of them an arm may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from elastic_arm.effects import EFFECTS
from elastic_arm.effects.parameters import Role
from elastic_arm.studies.blind_challenge.hidden_arms.effect_laws import Fault

# Of each effect: the parameter that is its size.
SIZE = {
    "viscous_friction": "coefficient",
    "coulomb_friction": "torque",
    "stribeck_friction": "torque",
    "load_dependent_friction": "coefficient",
    "nonlinear_stiffness": "cubic",
    "hysteresis": "torque",
    "backlash": "half_gap",
    "transmission_error": "amplitude",
    "torque_ripple": "amplitude",
    "bearing_compliance": "stiffness_scale",
    "payload": "mass",
    "base_tilt": "x",
    "motor_torque_gain": "gain",
    "joint_torque_gain": "gain",
    "motor_torque_offset": "offset",
    "joint_torque_offset": "offset",
    "encoder_offset": "offset",
    "encoder_eccentricity": "amplitude",
    "time_delay": "delay",
    "link_inertia_mismatch": "mass",
    "rotor_inertia_mismatch": "inertia",
    "stiffness_mismatch": "stiffness",
    "damping_mismatch": "damping",
}
STRUCTURAL = {"spline_inertia": "mod1", "inertia_coupling": "mod2"}  # the arm has them, the model does not
SIDED = ("viscous_friction", "coulomb_friction", "stribeck_friction")
WHOLE_ARM = ("payload", "base_tilt", "bearing_compliance")
SIGNED = ("gain", "offset", "inertia", "stiffness", "damping", "cubic")
CHANNELS = ("joint_torque", "motor_torque", "link_encoder")
COMMON = 0.25  # share of delays that all joints have
DELAYS = (1.5e-3, 0.01)  # s: a lag of one sample or less is no cause


@dataclass(frozen=True)
class SampledEffect:
    """An effect without its size.

    Parameters
    ----------
    fault
        With all its parameters but the size.
    sign
        Of the size, where it may have either.
    angle
        Direction of a tilt, rad.
    """

    fault: Fault
    sign: float
    angle: float

    def sized(self, amount: float) -> Fault:
        """Return the effect with so much of it, 0 for none."""
        effect, size = self.fault.effect, SIZE[self.fault.effect]
        neutral = EFFECTS[effect].parameter(size).neutral or 0.0
        values = {size: neutral + self.sign * amount}
        if effect == "base_tilt":
            values = {"x": amount * np.cos(self.angle), "y": amount * np.sin(self.angle)}
        elif effect == "bearing_compliance":
            values = {size: 1.0 / amount}
        return replace(self.fault, parameters={k: float(v) for k, v in (values | dict(self.fault.parameters)).items()})

    def limits(self) -> tuple[float, float]:
        """Return the smallest and largest plausible amount; of sizes that enter linearly, any small one is."""
        effect = self.fault.effect
        parameter = EFFECTS[effect].parameter(SIZE[effect])
        if effect == "time_delay":
            return DELAYS
        if effect == "bearing_compliance":
            return 1.0 / parameter.high, 1.0 / parameter.low
        if effect == "link_inertia_mismatch" or parameter.neutral:
            return 1e-9, abs((parameter.high if self.sign > 0 else parameter.low) - 1.0)
        return (parameter.low if parameter.role is Role.SEARCHED else 1e-12), parameter.high

    def typical(self) -> float:
        """Return an amount to begin with."""
        low, high = self.limits()
        parameter = EFFECTS[self.fault.effect].parameter(SIZE[self.fault.effect])
        if parameter.neutral:
            return 0.1 * high
        return float(np.sqrt(low * high)) if low > 1e-9 else 1e-3 * high


def sample_effect(effect: str, n: int, rng: np.random.Generator) -> SampledEffect:
    """Draw where an effect sits, its form, and its parameters other than the size.

    Parameters
    ----------
    effect
        Its id.
    n
        Number of joints.
    rng
        Draws joint, side, channels and parameters.
    """
    joint = None if effect in WHOLE_ARM else int(rng.integers(n))
    side = str(rng.choice(["motor", "link"])) if effect in SIDED else "motor"
    channels: tuple[str, ...] = ()
    if effect == "time_delay":
        channels = (str(rng.choice(CHANNELS)),)
        joint = None if rng.random() < COMMON else joint
    signed = effect == "link_inertia_mismatch" or SIZE[effect] in SIGNED
    sign = float(rng.choice([-1.0, 1.0])) if signed else 1.0
    fault = Fault(effect, joint, _others(effect, rng), side, channels)
    return SampledEffect(fault, sign, float(rng.uniform(-np.pi, np.pi)))


def _others(effect: str, rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters that are not the size."""
    phase = {"phase": float(rng.uniform(-np.pi, np.pi))}
    drawn: Mapping[str, dict[str, float]] = {
        "stribeck_friction": {"speed": float(10 ** rng.uniform(-1.7, -0.7))},
        "hysteresis": {"width": float(10 ** rng.uniform(-4.5, -3.5))},
        "transmission_error": {**phase, "order": 2.0},
        "torque_ripple": {**phase, "order": float(rng.choice([1, 2, 3]))},
        "encoder_eccentricity": phase,
        "payload": {f"position_{axis}": float(rng.uniform(-0.15, 0.15)) for axis in "xyz"},
        # Half of the heavier motors are heavier in B alone, which is the contract's law, half in S too, as masses are.
        "rotor_inertia_mismatch": {"coupled": float(rng.random() < 0.5)},
    }
    return drawn.get(effect, {})
