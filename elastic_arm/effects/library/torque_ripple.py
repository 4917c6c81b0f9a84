"""Cogging and ripple of the motor."""

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


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """The motor gives A sin(k r_tot theta + phi) more than tau_m."""
    angle = p["order"] * motion.gear(i).r_tot * motion.theta[i] + p["phase"]
    return motion.at(i, motor=-p["amplitude"] * ca.sin(angle))


EFFECT = Effect(
    id="torque_ripple",
    formula="A sin(k r_tot theta + phi) added to the motor's torque, not included in tau_m",
    description="Cogging and commutation ripple of the motor.",
    plain="has a motor whose torque ripples by ±{amplitude}, {order} times per turn of the rotor",
    signature=(
        "A ripple of the motor residual, periodic in the rotor angle, with the same"
        " amplitude at all speeds and loads."
    ),
    law=law,
    parameters=(
        Parameter(
            "amplitude", "Nm", 0.1, 50.0, neutral=0.0, meaning="A, at the harmonic-drive output"
        ),
        phase(),
        searched(
            "order",
            "1",
            0.5,
            48.0,
            "k, per rotor turn",
            default=1.0,
            above=0.0,
            integer=True,
            draw=(1, 3),
        ),
    ),
    sides=("motor",),
    regime="rotor_angle",
    needs_motion=True,
    confusions=(
        Confusion(
            "transmission_error",
            "there is no joint torque sensor and both have the same spatial frequency",
            "a joint torque sensor, or motion under different loads: ripple does not grow with the"
            " load",
        ),
    ),
)
