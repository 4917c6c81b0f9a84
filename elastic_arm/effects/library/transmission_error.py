"""Kinematic error of the harmonic drive."""

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Parameter,
    SymbolicMotion,
    phase,
    searched,
)


def slope(motion: SymbolicMotion, i: int, p: Numbers) -> ca.SX:
    """de/dtheta."""
    spatial = p["order"] * motion.gear(i).harmonic_drive_ratio
    return p["amplitude"] * spatial * ca.cos(spatial * motion.theta[i] + p["phase"])


def twist(motion: SymbolicMotion, i: int, p: Numbers) -> tuple[ca.SX, ca.SX]:
    """E = A sin(k r_hd theta + phi) and its rate."""
    spatial = p["order"] * motion.gear(i).harmonic_drive_ratio
    error = p["amplitude"] * ca.sin(spatial * motion.theta[i] + p["phase"])
    return error, slope(motion, i, p) * motion.dtheta[i]


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """K e + D e' in the drive; by virtual work the motor feels tau_J (1 + de/dtheta)."""
    error, rate = twist(motion, i, p)
    return motion.at(
        i,
        drive=motion.K[i] * error + motion.D[i] * rate,
        motor=motion.tau_J[i] * slope(motion, i, p),
    )


EFFECT = Effect(
    id="transmission_error",
    formula=(
        "deflection theta + e(theta) - q, e = A sin(k r_hd theta + phi); on the motor tau_J (1 +"
        " de/dtheta)"
    ),
    description=(
        "The kinematic error of the harmonic drive: its output leads and lags"
        " periodically in the wave-generator angle, usually twice per turn."
    ),
    plain=(
        "has a gear that leads and lags by ±{amplitude}, {order} times per turn of"
        " the wave generator"
    ),
    signature=(
        "A ripple of joint torque that is periodic in the wave-generator angle and"
        " grows at speeds that excite the elastic resonance; in the motor residual it"
        " is proportional to the load."
    ),
    law=law,
    parameters=(
        Parameter("amplitude", "rad", 1e-6, 1e-3, neutral=0.0, meaning="A"),
        phase(),
        searched(
            "order",
            "1",
            0.5,
            8.0,
            "k, per wave-generator turn",
            default=2.0,
            above=0.0,
            integer=True,
        ),
    ),
    sides=("drive", "motor"),
    regime="wave_generator_angle",
    twist=twist,
    confusions=(
        Confusion(
            "torque_ripple",
            "there is no joint torque sensor and k_ripple r_b equals k_error",
            "a joint torque sensor, or motion under different loads: ripple does not grow with the"
            " load",
        ),
    ),
)
