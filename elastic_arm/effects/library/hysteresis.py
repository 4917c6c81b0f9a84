"""A drive that remembers which way it was wound."""

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SymbolicMotion,
    amount,
    searched,
)


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """H z added to tau_J, with the Bouc-Wen state z of the deflection."""
    z = p["z"]
    rate = motion.deflection_rate[i]
    z_rate = (rate - ca.fabs(rate) * z / 2 - rate * ca.fabs(z) / 2) / p["width"]
    return motion.at(i, drive=p["torque"] * z, rates={"z": z_rate})


EFFECT = Effect(
    id="hysteresis",
    formula="H z added to tau_J, z' = (d' - abs(d') z/2 - d' abs(z)/2)/w_h, d = theta - q",
    description=(
        "Micro-slip in the drive: loading and unloading follow different curves, at any speed."
    ),
    plain="has a drive whose torque deviates by {torque} from the mean in loading and unloading",
    signature=(
        "Joint torque over deflection is a loop of constant area; the residual"
        " alternates between +H and -H with the direction of loading and changes over"
        " a deflection of about the width."
    ),
    law=law,
    parameters=(
        amount("torque", "Nm", 0.1, 50.0, "H, half the loop's height"),
        searched("width", "rad", 2e-06, 0.002, "w_h", above=0.0, draw=(3e-05, 0.0003)),
    ),
    sides=("drive",),
    regime="velocity_reversal",
    states=("z",),
    confusions=(
        Confusion(
            "damping_mismatch",
            "the deflection always changes at the same speed",
            "slower motion: the loop of hysteresis keeps its height, that of damping shrinks",
        ),
        Confusion(
            "backlash",
            "the deflection stays within about the width",
            "motion with larger deflection in both directions",
        ),
    ),
)
