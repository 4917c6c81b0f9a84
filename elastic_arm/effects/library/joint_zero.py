"""A joint whose zero is not where the description has it."""

import casadi as ca

from elastic_arm.effects.law import Confusion, Contribution, Effect, Numbers, SymbolicMotion, signed


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """The left side of (1) at the angles of the description, q_i and theta_i less the offset,
    instead of those read."""
    read, n = motion.x, motion.n
    described = ca.SX(read)
    for k in (i, n + i) if motion.robot.elastic else (i,):
        described[k] -= p["offset"]
    left_side = motion.equations.left_side
    return motion.everywhere(
        left_side(described, motion.dx, motion.ddx) - left_side(read, motion.dx, motion.ddx)
    )


EFFECT = Effect(
    id="joint_zero",
    formula=(
        "both encoders of a joint = the description's angle + offset; the arm beyond it is turned"
        " by -offset"
    ),
    description=(
        "The joint's zero differs from the description's: calibrated anew, a motor or encoder"
        " exchanged."
    ),
    plain="has its zero {offset} from where it is described",
    signature=(
        "Weight and inertia of all that hangs on the joint are felt at an angle that is off, also"
        " on joints before it; the two encoders agree."
    ),
    law=law,
    parameters=(signed("offset", "rad", 0.5, "recorded - described", draw=(0.02, 0.1)),),
    sides=("link", "motor"),
    regime="position",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "on the last joint, or while the joints beyond it do not move: a turned link "
            "is one with another centre of mass",
            "motion of the joints beyond: a zero turns all of them, a centre of mass does not",
        ),
        Confusion(
            "base_tilt",
            "on a first joint that is horizontal: turning the base is turning the joint",
            "only a level: no motion separates them",
        ),
    ),
)
