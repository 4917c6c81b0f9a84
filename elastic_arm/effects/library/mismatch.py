"""Wrong numbers of a transmission: the torque that the nominal number makes, times what it is
off."""

from collections.abc import Callable
from typing import Any

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    Parameter,
    SymbolicMotion,
    ratio,
)


def scaled(
    number: Parameter,
    side: str,
    torque: Callable[[SymbolicMotion, int], ca.SX],
    of: str = "",
    **words: Any,
) -> Effect:
    """Return (ratio - 1) times a torque of the nominal transmission."""

    def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
        if side == "drive":
            motion.gear(i)
        return motion.at(i, **{side: (p[number.name] - 1.0) * torque(motion, i)})

    named = of or number.name
    return Effect(
        law=law, parameters=(number,), sides=(side,), model_parameter=True, number=named, **words
    )


ONLY_DRIVE = "only the drive equation is available"

EFFECTS = (
    scaled(
        ratio("stiffness", 0.5, 2.0, "true / nominal K", above=0.0),
        "drive",
        lambda motion, i: motion.K[i] * motion.deflection[i],
        id="stiffness_mismatch",
        formula="(ratio - 1) K (theta - q)",
        description="The stiffness of the drive differs from the nominal one.",
        plain="has a drive {stiffness} times as stiff as described",
        signature="The drive residual is a straight line over the deflection.",
        regime="load",
        confusions=(
            Confusion(
                "joint_torque_gain",
                ONLY_DRIVE,
                "the link or motor equation, in which a gain is also visible",
            ),
            Confusion(
                "nonlinear_stiffness",
                "the load covers a narrow range",
                "motion under light and heavy load",
            ),
        ),
    ),
    scaled(
        ratio("damping", 0.1, 10.0, "true / nominal D", least=0.0),
        "drive",
        lambda motion, i: motion.D[i] * motion.deflection_rate[i],
        id="damping_mismatch",
        formula="(ratio - 1) D (theta' - q')",
        description="The damping of the drive differs from the nominal one.",
        plain="has a drive with {damping} times the described damping",
        signature=(
            "The drive residual follows the rate of deflection: small in slow motion,"
            " largest where the drive rings."
        ),
        regime="frequency",
        confusions=(
            Confusion(
                "time_delay",
                f"{ONLY_DRIVE}: a delay of tau_J acts there as dD = -K delay",
                "the link or motor equation, in which a delay is also visible",
            ),
            Confusion(
                "hysteresis",
                "the deflection always changes at the same speed",
                "the same motion at a lower speed",
            ),
        ),
    ),
    scaled(
        ratio("inertia", 0.5, 2.0, "true / nominal B_ii", above=0.0),
        "motor",
        lambda motion, i: motion.motor_inertia(i) * motion.ddtheta[i],
        "rotor_inertia",
        id="rotor_inertia_mismatch",
        formula="(ratio - 1) B_ii theta''",
        description=(
            "The inertia on the motor side differs; rotor, wave generator and spline act"
            " together in B."
        ),
        plain="has {inertia} times the described inertia on its motor side",
        signature="The motor residual follows the acceleration of the motor.",
        regime="acceleration",
        needs_motion=True,
        confusions=(
            Confusion(
                "motor_torque_gain",
                "neither gravity nor load acts on the joint, as on a vertical first axis",
                "motion in which other joints or gravity load this one",
            ),
            Confusion(
                "inertia_coupling",
                "the link moves like the motor",
                "motion with large deflection: fast enough for link and motor accelerations"
                " to differ",
            ),
        ),
    ),
)
