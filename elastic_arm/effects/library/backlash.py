"""Play in the drive."""

import casadi as ca

from elastic_arm.effects.law import (
    Confusion,
    Contribution,
    Effect,
    Numbers,
    SymbolicMotion,
    searched,
)

# a load of so much less than the play is worth decides at which end of it a drive lies; numerical
SHARP = 20.0


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """-K times the part of the deflection that the play takes up.

    Where the load is known, its sign gives the end of the play. What encoders read of it has their
    noise, which the residual holds, too (errors in variables).
    """
    gap = p["half_gap"]
    d = motion.deflection[i]
    if motion.wound is not None:
        d = ca.if_else(motion.loaded > 0.0, SHARP * motion.wound[i], d)
    return motion.at(i, drive=-motion.K[i] * ca.fmax(-gap, ca.fmin(gap, d)))


EFFECT = Effect(
    id="backlash",
    formula="d replaced by sign(d) max(abs(d) - b, 0) in K d; D acts throughout",
    description="Play: within the gap the drive transmits only damping.",
    plain="has {half_gap} of play to either side in its drive",
    signature=(
        "Joint torque over deflection is flat in the middle; where the load changes"
        " sign, the residual steps from +K b to -K b and the link rings."
    ),
    law=law,
    # A loaded drive lies at one end of its play, and is wound beyond it.
    parameters=(
        searched(
            "half_gap", "rad", 1e-06, 0.002, "b", neutral=0.0, least=0.0, bounded_by="deflection"
        ),
    ),
    sides=("drive",),
    regime="load",
    confusions=(
        Confusion(
            "encoder_offset",
            "the load of the joint always has the same sign",
            "motion in which the joint torque changes sign",
        ),
    ),
)
