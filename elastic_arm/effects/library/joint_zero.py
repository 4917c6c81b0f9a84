"""A joint whose zero is not where the description has it."""

import casadi as ca

from elastic_arm.effects.law import Confusion, Contribution, Effect, Numbers, SymbolicMotion, signed


def law(motion: SymbolicMotion, i: int, p: Numbers) -> Contribution:
    """Return the left side of (1) at the angles of the description, less that at those read.

    The former are q_i and theta_i less the offset.
    """
    read = motion.x
    n = motion.n
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
        "both encoders of a joint = the description's angle + offset; the arm beyond"
        " it is rotated by -offset"
    ),
    description=(
        "The zero of the joint differs from the description: recalibration, an"
        " exchanged motor or encoder."
    ),
    plain="has a zero that differs by {offset} from the description",
    signature=(
        "Weight and inertia of all bodies that the joint moves act at a wrong angle,"
        " also on joints before it; the two encoders agree."
    ),
    law=law,
    parameters=(signed("offset", "rad", 0.5, "recorded - described", draw=(0.02, 0.1)),),
    sides=("link", "motor"),
    regime="position",
    confusions=(
        Confusion(
            "link_inertia_mismatch",
            "on the last joint, or while the joints beyond it do not move: a rotated link"
            " is equivalent to one with another centre of mass",
            "motion of the joints beyond: a zero rotates all of them, a centre of mass does not",
        ),
        Confusion(
            "base_tilt",
            "on a horizontal first joint: rotating the base is equivalent to rotating the joint",
            "only a spirit level: no motion separates them",
        ),
    ),
)
