"""A counterbalance whose torque is no straight line over the angle."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter

ORDERS = 5  # a gas spring on a crank is met to some 0.1 % over 2 rad


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """A polynomial of the joint angle in rad on the link.

    Parameters
    ----------
    motion, i
        Symbols of the motion, and index of the joint.
    p
        `torque` (Nm), the coefficients of q^0 to q^4.
    """
    powers = ca.vertcat(*(motion.q[i] ** k for k in range(ORDERS)))
    return motion.at(i, link=ca.dot(p["torque"], powers))


EFFECT = Effect(
    id="counterbalance",
    formula="c_0 + c_1 q + c_2 q^2 + c_3 q^3 + c_4 q^4 on the link, q in rad",
    description="A counterbalance on a crank, a gas spring: a torque that is a curve over the joint angle.",
    signature="The link residual is one curve over the joint's own angle, whatever the speed and the other joints.",
    law=law,
    parameters=(
        Parameter(
            "torque",
            "Nm",
            -2e4,
            2e4,
            neutral=0.0,
            size=ORDERS,
            example=(-100.0, 100.0),
            meaning="c_0 to c_4, coefficients of a polynomial of q in rad",
        ),
    ),
    sides=("link",),
    regime="position",
    confusions=(
        Confusion(
            "joint_spring",
            "the joint turns through a small angle, over which any curve is straight",
            "motion over a wide range of the joint",
        ),
        Confusion(
            "link_inertia_mismatch",
            "the joints above hardly move: gravity is then a function of the joint's own angle too",
            "motion of all joints over a wide range: gravity follows the angles of the others, a counterbalance does "
            "not",
        ),
    ),
)
