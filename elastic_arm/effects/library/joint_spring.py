"""Springs from one link to the next, linear and not."""

import casadi as ca

from elastic_arm.effects.law import Confusion, Effect, amount, searched, signed

# with a joint spring beside it a gas spring on a crank is met to some 0.1 % over 2 rad
ORDERS = 2, 3, 4, 5
SMALL = "the joint turns through a small angle, over which any curve is nearly straight"
STILL = "the joints before it hardly move: gravity then also depends only on the joint's own angle"
WIDE = "motion over a wide range of the joint"
OWN = (
    "motion of all joints over a wide range: gravity depends on the other angles, a spring does not"
)

SPRING = Effect(
    "joint_spring",
    formula="k (q - q_0) on the link",
    description="A spring from one link to the next: a counterbalance, a dress pack, a hose.",
    plain="carries a spring of {stiffness}",
    signature=(
        "The link residual is a straight line over the joint angle, independent of"
        " speed and other joints."
    ),
    law=lambda motion, i, p: motion.at(i, link=p["stiffness"] * (motion.q[i] - p["rest"])),
    parameters=(
        amount("stiffness", "Nm/rad", 1.0, 2e4, "k"),
        searched("rest", "rad", -3.2, 3.2, "q_0, angle of the relaxed spring", draw=(-1.0, 1.0)),
    ),
    sides=("link",),
    regime="position",
    confusions=(
        Confusion("counterbalance", SMALL, WIDE),
        Confusion("link_inertia_mismatch", STILL, OWN),
    ),
)
COUNTERBALANCE = Effect(
    "counterbalance",
    formula=(
        "c_2 q^2 + c_3 q^3 + c_4 q^4 + c_5 q^5 on the link, q in rad: nonlinear part"
        " beyond a joint spring"
    ),
    description=(
        "A counterbalance on a crank, a gas spring: the nonlinear part of its torque"
        " over the angle, in addition to a joint spring."
    ),
    plain="carries a counterbalance with a nonlinear torque of {torque} per rad², rad³, …",
    signature=(
        "The link residual is a single curve over the joint's own angle, independent"
        " of speed and other joints."
    ),
    law=lambda motion, i, p: motion.at(
        i, link=ca.dot(p["torque"], ca.vertcat(*(motion.q[i] ** k for k in ORDERS)))
    ),
    parameters=(signed("torque", "Nm", 2e4, "c_2 to c_5", size=len(ORDERS)),),
    sides=("link",),
    regime="position",
    confusions=(
        Confusion("joint_spring", SMALL, WIDE),
        Confusion("link_inertia_mismatch", STILL, OWN),
    ),
)

EFFECTS = (SPRING, COUNTERBALANCE)
