"""What a counterbalance does beyond a spring: its torque is no straight line over the angle."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from elastic_arm.effects.model import Confusion, Effect
from elastic_arm.effects.motion import Contribution, SymbolicMotion
from elastic_arm.effects.parameters import Parameter

ORDERS = (2, 3, 4, 5)  # with a joint spring beside it a gas spring on a crank is met to some 0.1 % over 2 rad


def law(motion: SymbolicMotion, i: int, p: Mapping[str, Any]) -> Contribution:
    """A polynomial of the joint angle in rad on the link."""
    powers = ca.vertcat(*(motion.q[i] ** k for k in ORDERS))
    return motion.at(i, link=ca.dot(p["torque"], powers))


EFFECT = Effect(
    id="counterbalance",
    formula="c_2 q^2 + c_3 q^3 + c_4 q^4 + c_5 q^5 on the link, q in rad: what a joint spring lacks",
    description="A counterbalance on a crank, a gas spring: beside a joint spring, the bend of its torque over the "
    "angle.",
    signature="The link residual is one curve over the joint's own angle, whatever the speed and the other joints.",
    law=law,
    parameters=(
        Parameter(
            "torque",
            "Nm",
            -2e4,
            2e4,
            neutral=0.0,
            size=len(ORDERS),
            example=(-100.0, 100.0),
            meaning="c_2 to c_5, coefficients of a polynomial of q in rad",
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
