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


ONLY_DRIVE = "only the drive equation can be used"

EFFECTS = (
    scaled(
        ratio("stiffness", 0.5, 2.0, "true / nominal K", above=0.0),
        "drive",
        lambda motion, i: motion.K[i] * motion.deflection[i],
        id="stiffness_mismatch",
        formula="(ratio - 1) K (theta - q)",
        description="The drive's stiffness differs from the nominal one.",
        plain="has a drive {stiffness} times as stiff as described",
        signature="The drive residual is a straight line over the deflection.",
        regime="load",
        confusions=(
            Confusion(
                "joint_torque_gain",
                ONLY_DRIVE,
                "the link or motor equation: a gain shows there too",
            ),
            Confusion(
                "nonlinear_stiffness",
                "the load covers a narrow range",
                "motion with light and heavy load",
            ),
        ),
    ),
    scaled(
        ratio("damping", 0.1, 10.0, "true / nominal D", least=0.0),
        "drive",
        lambda motion, i: motion.D[i] * motion.deflection_rate[i],
        id="damping_mismatch",
        formula="(ratio - 1) D (theta' - q')",
        description="The drive's damping differs from the nominal one.",
        plain="has a drive with {damping} times the described damping",
        signature=(
            "The drive residual follows the rate of deflection: small on slow motion, largest where"
            " it rings."
        ),
        regime="frequency",
        confusions=(
            Confusion(
                "time_delay",
                f"{ONLY_DRIVE}: a delay of tau_J acts there as dD = -K delay",
                "the link or motor equation: a delay shows there too",
            ),
            Confusion("hysteresis", "the drive is wound at one speed", "the same motion slower"),
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
            "The inertia on the motor side differs: rotor, wave generator and spline act together"
            " in B."
        ),
        plain="has {inertia} times the described inertia on its motor side",
        signature="The motor residual follows the motor's acceleration.",
        regime="acceleration",
        needs_motion=True,
        confusions=(
            Confusion(
                "motor_torque_gain",
                "no gravity or load acts on the joint, as on a vertical first axis",
                "motion in which other joints or gravity load this one",
            ),
            Confusion(
                "inertia_coupling",
                "the link moves as the motor does",
                "motion that winds the drive: fast enough for link and motor accelerations to"
                " differ",
            ),
        ),
    ),
)
